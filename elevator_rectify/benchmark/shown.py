"""Buttons removed from rendered panels: which of them are inferred from the picture."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count
from pathlib import Path

import cv2
import numpy as np

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.pictures import Pictured, pictured
from elevator_rectify.core.config import Config
from elevator_rectify.core.pipeline import fit_panel
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.types import BoolArray, IntArray
from elevator_rectify.core.view.draw import draw_overlay, draw_rectified
from elevator_rectify.core.view.warp import rectify_image
from elevator_rectify.render.scene import Scene

_CONFIG = Config()
_REMOVED = 0.2
# An inferred button is one that is there where it is nearer than this share of the pitch.
_NEAR_PITCH = 0.15
# A button nearer to the border is cut by it.
_BORDER_PX = 5


@dataclass(frozen=True)
class Shown:
    """One panel: whether the fit was accepted, how many buttons of its grid were removed or missed, of them inferred,
    and inferred where there is none; of the inferred ones, the errors of their places in pitches."""

    accepted: bool
    gone: int
    right: int
    wrong: int
    errors: tuple[float, ...]


def _drawn(level: str, seed: int, number: int) -> tuple[Pictured, BoolArray, GridFit]:
    """Return a rendered panel, which of its detections are kept, and the fit of those with the picture."""
    given = pictured(level, seed, number, held_out=True)
    scene = given.scene
    keep = np.random.default_rng([seed, number, 13]).random(len(scene.detections)) >= _REMOVED
    left = [d for d, k in zip(scene.detections, keep, strict=True) if k]
    return given, keep, fit_panel(left, scene.camera, _CONFIG, image=given.image)


def run_shown(task: tuple[str, int, int]) -> Shown:
    """Remove a fifth of the detections of one rendered panel, and fit with the picture: (level, seed, number)."""
    given, keep, fit = _drawn(*task)
    scene = given.scene
    gone = _gone(scene, scene.button[keep])
    if not fit.ok:
        return Shown(False, len(gone), 0, 0, ())
    inferred = np.array([b.image_px for b in fit.buttons if b.state == "inferred"]).reshape(-1, 2)
    steps = np.linalg.norm(np.diff(fit.grid_px, axis=1), axis=-1)
    away = np.linalg.norm(inferred[:, None] - scene.pixels, axis=-1) / float(np.median(steps))
    near = away < _NEAR_PITCH
    right = near[:, gone].any(axis=0)
    errors = away[:, gone].min(axis=0)[right] if len(inferred) else np.zeros(0)
    return Shown(True, len(gone), int(right.sum()), int((~near.any(axis=1)).sum()), tuple(errors.tolist()))


def _gone(scene: Scene, detected: IntArray) -> IntArray:
    """Return the buttons that are in the picture, but not detected."""
    size = np.array([scene.camera.width, scene.camera.height])
    inside = ((scene.pixels > _BORDER_PX - 1) & (scene.pixels < size - _BORDER_PX)).all(axis=1)
    return np.setdiff1d(np.flatnonzero(inside), detected)


def shown_table(levels: list[str], trials: int, seed: int, figures: Figures) -> str:
    """Return the table of buttons that the picture shows and no detection does."""
    lines = [f"{'with picture':<13}{'accepted':>9}{'removed':>9}{'recall':>8}{'precision':>11}{'false a panel':>15}"]
    lines[0] += f"{'median distance, pitch':>24}"
    for level in levels:
        results = parallel(run_shown, [(level, seed, n) for n in range(trials)], f"{level} with picture")
        judged = [r for r in results if r.accepted]
        gone, right, wrong = (sum(getattr(r, name) for r in judged) for name in ("gone", "right", "wrong"))
        figures.share(f"{level} removed buttons found with picture+", right, gone)
        figures.share(f"{level} inferred buttons real with picture+", right, right + wrong)
        lines.append(
            f"{level:<13}{len(judged) / len(results):>9.3f}{gone:>9}{right / max(1, gone):>8.3f}"
            f"{right / max(1, right + wrong):>11.3f}{wrong / max(1, len(judged)):>15.3f}"
            f"{np.median([e for r in judged for e in r.errors]):>24.4f}"
        )
    return "\n".join(lines)


def write_example(path: Path, level: str, seed: int) -> None:
    """Write the first panel of several rows with its labels and inferred buttons: the input, and the rectified view."""
    drawn = (_drawn(level, seed, number) for number in count())
    given, keep, fit = next(
        d for d in drawn if d[2].ok and d[2].rows > 3 and any(b.state == "inferred" for b in d[2].buttons)
    )
    kept = np.array([[d.x_px, d.y_px] for d in given.scene.detections])[keep]
    overlay = draw_overlay(given.image, kept, fit, None, fit.buttons)
    view = draw_rectified(rectify_image(given.image, given.scene.camera, fit), fit.buttons)
    height = overlay.shape[0]
    view = cv2.resize(view, (round(view.shape[1] * height / view.shape[0]), height), interpolation=cv2.INTER_AREA)
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.hstack([overlay, view]), [cv2.IMWRITE_JPEG_QUALITY, 85])
