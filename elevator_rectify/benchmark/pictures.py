"""Rendered pictures of random panels, and what the picture adds to the boxes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.synthetic import (
    CHI2_3,
    RIGHT_CELLS,
    SUCCESS_DEG,
    Trial,
    calibration_error,
    judged,
    record,
)
from elevator_rectify.core.config import Config
from elevator_rectify.core.pipeline import fit_panel
from elevator_rectify.core.types import Array, FitResult, Image
from elevator_rectify.render.few import few_scene
from elevator_rectify.render.levels import LEVELS, random_scene
from elevator_rectify.render.looks import SCATTER_SHARE, dressed, random_taking
from elevator_rectify.render.photograph import photograph
from elevator_rectify.render.scene import Scene

_CONFIG = Config()
_AWAY_M = 0.5
# A place that the picture shows belongs to the button within this share of the pitch.
_NEAR_PITCH = 0.15
_OTHER = 1_000_000


@dataclass(frozen=True)
class Pictured:
    """A scene and its picture (an empty one where it was not asked for)."""

    scene: Scene
    image: Image


def pictured(level: str, seed: int, number: int, held_out: bool = False, picture: bool = True) -> Pictured:
    """Draw a scene of a level in a random look and photograph it; the same arguments give the same picture."""
    rng = np.random.default_rng([seed, number, 7])
    # Of real panels some are made well, and some are not; lenses bend what is left of it.
    low, high = (0.002, 0.012) if level == "wild" else (SCATTER_SHARE, SCATTER_SHARE)
    scatter = low * (high / low) ** ((number % 8) / 7.0)
    scene = random_scene(LEVELS[level], seed, number, dress=lambda panel: dressed(panel, rng, held_out, scatter))
    image: Image = photograph(scene, rng, random_taking(rng)) if picture else np.zeros((0, 0, 3), np.uint8)
    return Pictured(scene, image)


def few_pictured(shape: str, buttons: int, seed: int, number: int, held_out: bool = False) -> tuple[Scene, Image]:
    """Draw an external panel of a few buttons and photograph it; the same arguments give the same picture."""
    rng = np.random.default_rng([seed, number, buttons])
    scene = few_scene(buttons, shape, rng, held_out)
    return scene, photograph(scene, rng, random_taking(rng))


@dataclass(frozen=True)
class PictureTrial:
    """One scene, fitted to its boxes and to its picture.

    lateral_mm: (M,) errors of the buttons' places across the panel's normal, as if 0.5 m away; found, wrong, missed:
    buttons without a detection that the picture showed, places shown where no button is, and all that there were.
    """

    boxes: Trial
    picture: Trial
    lateral_mm: Array
    found: int
    wrong: int
    missed: int


def run_picture(task: tuple[str, int, int, bool]) -> PictureTrial:
    """Fit one scene: (level, seed, number, held-out look)."""
    level, seed, number, held_out = task
    given = pictured(level, seed, number, held_out)
    scene, fits = given.scene, []
    for image in (None, given.image):
        start = time.perf_counter()
        fit = fit_panel(scene.detections, scene.camera, _CONFIG, image=image)
        fits.append(judged(scene, fit, 1e3 * (time.perf_counter() - start)))
    return PictureTrial(fits[0], fits[1], lateral_mm(scene, fit), *undetected(scene, fit))


def lateral_mm(scene: Scene, fit: FitResult) -> Array:
    """Return the errors (M,) of the detected buttons' places across the panel's normal, scaled to 0.5 m."""
    if not fit.ok:
        return np.zeros(0)
    on = (fit.cells[:, 0] >= 0) & (scene.button >= 0)
    at = scene.panel.placed_m[scene.button[on]] @ scene.R_camera_panel.T + scene.t_camera_panel
    found = fit.grid_points[fit.cells[on, 0], fit.cells[on, 1]] * scene.panel.pitch_m[0] / fit.pitch[0]
    across = (found - at) @ scene.R_camera_panel[:, :2]
    return np.asarray(1e3 * np.linalg.norm(across, axis=1) * _AWAY_M / at[:, 2])


def undetected(scene: Scene, fit: FitResult) -> tuple[int, int, int]:
    """Return how many buttons without detection were shown, how many shown ones are none, and how many there are."""
    inside = ((scene.pixels > 4) & (scene.pixels < [scene.camera.width - 5, scene.camera.height - 5])).all(axis=1)
    gone = np.setdiff1d(np.flatnonzero(inside), scene.button)
    if not fit.ok or fit.measurement is None:
        return 0, 0, len(gone)
    empty = np.ones((fit.rows, fit.columns), dtype=bool)
    empty[tuple(fit.cells[fit.cells[:, 0] >= 0].T)] = False
    shown = fit.measurement.centre_px[empty & np.isfinite(fit.measurement.correlation)]
    steps = np.linalg.norm(np.diff(fit.grid_px, axis=1), axis=-1)
    limit = _NEAR_PITCH * float(np.median(steps))
    near = (np.linalg.norm(shown[:, None] - scene.pixels, axis=-1) < limit).any(axis=1)
    return int(near.sum()), int((~near).sum()), len(gone)


HEADER = (
    f"{'level':<8}{'':<9}{'success':>8}{'cells':>7}{'med deg':>8}{'/oracle':>8}{'p95 acc':>8}{'accept':>8}"
    f"{'gross %':>8}{'cover':>7}{'ece':>7}{'med ms':>8}"
)


def picture_table(levels: list[str], trials: int, seed: int, yardstick: float, figures: Figures) -> str:
    """Return the table of held-out looks: boxes only, with picture, and the oracle of the boxes' centres."""
    lines = [HEADER]
    for level in levels:
        results = parallel(run_picture, [(level, seed, n, True) for n in range(trials)], f"{level} pictures")
        oracle = np.array([t.boxes.oracle_deg for t in results])
        lines.append(_row(level, "boxes", [t.boxes for t in results]))
        lines.append(_row(level, "picture", [t.picture for t in results]))
        lines.append(
            f"{level:<8}{'oracle':<9}{np.mean(oracle < SUCCESS_DEG):>8.3f}{1.0:>7.3f}{np.median(oracle):>8.2f}"
        )
        record(figures, f"{level} boxes", [t.boxes for t in results])
        record(figures, f"{level} picture", [t.picture for t in results])
        lateral = np.concatenate([t.lateral_mm for t in results])
        found, wrong, missed = (sum(getattr(t, name) for t in results) for name in ("found", "wrong", "missed"))
        figures.median(f"{level} picture lateral mm-", lateral)
        figures.share(f"{level} picture missed buttons found+", found, missed)
        figures.share(f"{level} picture buttons shown are real+", found, found + wrong)
        lines.append(
            f"{'':<8}lateral error 0.5 m away: median {np.median(lateral):.2f}, p95 {np.percentile(lateral, 95):.2f} "
            f"mm; buttons missed by the detector: {found} of {missed} shown, {wrong} wrong"
        )
    lines.append(f"looks and ways of taking pictures held out; yardstick {yardstick:.2f} ms")
    return "\n".join(lines)


def _row(level: str, name: str, trials: list[Trial]) -> str:
    error, oracle = (np.array([getattr(t, f"{n}_deg") for t in trials]) for n in ("error", "oracle"))
    cells = np.array([t.cells >= RIGHT_CELLS for t in trials])
    accepted = [t for t in trials if t.accepted]
    gross = 100.0 * np.mean([not t.right for t in accepted]) if accepted else np.nan
    d2 = np.array([t.mahalanobis2 for t in accepted if t.right])
    return (
        f"{level:<8}{name:<9}{np.mean((error < SUCCESS_DEG) & cells):>8.3f}{cells.mean():>7.3f}{np.median(error):>8.2f}"
        f"{np.median(error) / np.median(oracle):>8.3f}{np.percentile([t.error_deg for t in accepted], 95):>8.2f}"
        f"{len(accepted) / len(trials):>8.3f}{gross:>8.2f}{np.mean(d2 < CHI2_3):>7.3f}"
        f"{calibration_error(trials):>7.3f}{np.median([t.milliseconds for t in trials]):>8.1f}"
    )


def _hand(image: Image, rng: np.random.Generator) -> Image:
    """Return the image with something before half of it."""
    covered, (height, width) = image.copy(), image.shape[:2]
    centre = (int(rng.uniform(0.2, 0.8) * width), int(rng.uniform(0.3, 0.9) * height))
    cv2.ellipse(covered, centre, (width // 4, height // 3), float(rng.uniform(0, 180)), 0, 360, (120, 150, 190), -1)
    return covered


def _noisy(image: Image, rng: np.random.Generator) -> Image:
    noisy: Image = np.clip(image + rng.normal(0, 40, image.shape), 0, 255).astype(np.uint8)
    return noisy


SPOILT: dict[str, Callable[[Image, np.random.Generator], Image]] = {
    "black": lambda image, rng: np.zeros_like(image),
    "saturated": lambda image, rng: np.full_like(image, 255),
    "overexposed": lambda image, rng: cv2.convertScaleAbs(image, alpha=3.0, beta=40),
    "blurred": lambda image, rng: cv2.GaussianBlur(image, (0, 0), 6.0),
    "noisy": _noisy,
    "hand": _hand,
    "shifted": lambda image, rng: np.roll(image, rng.integers(-60, 61, 2), axis=(0, 1)),
    "other": lambda image, rng: image,
}


def run_spoilt(task: tuple[str, str, int, int]) -> tuple[bool, bool, bool]:
    """Return for one spoilt picture: fit to boxes right and accepted, then accepted with picture, and right."""
    kind, level, seed, number = task
    given = pictured(level, seed, number, held_out=True)
    scene = given.scene
    image = given.image if kind != "other" else pictured(level, seed, number + _OTHER, held_out=True).image
    spoilt = SPOILT[kind](image, np.random.default_rng([seed, number, 11]))
    boxes = judged(scene, fit_panel(scene.detections, scene.camera, _CONFIG), 0.0)
    both = judged(scene, fit_panel(scene.detections, scene.camera, _CONFIG, image=spoilt), 0.0)
    right = boxes.accepted and boxes.right and boxes.cells >= RIGHT_CELLS
    return right, both.accepted, both.right and both.cells >= RIGHT_CELLS


def spoilt_table(trials: int, seed: int, figures: Figures) -> str:
    """Return how often a bad picture makes a right fit wrong, or refuses it."""
    lines = [f"{'picture':<12}{'right by boxes':>15}{'then wrong':>11}{'refused':>9}"]
    wrong = right = 0
    for kind in SPOILT:
        tasks = [(kind, ("easy", "medium", "hard")[n % 3], seed, n) for n in range(trials)]
        results = [r for r in parallel(run_spoilt, tasks, kind) if r[0]]
        made_wrong, refused = sum(a and not ok for _, a, ok in results), sum(not a for _, a, _ in results)
        lines.append(f"{kind:<12}{len(results):>15}{made_wrong:>11}{refused:>9}")
        wrong, right = wrong + made_wrong, right + len(results)
    figures.share("bad pictures right fits made wrong-", wrong, right)
    lines.append(f"right fits made wrong by a bad picture: {100.0 * wrong / max(1, right):.2f} %")
    return "\n".join(lines)
