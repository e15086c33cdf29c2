"""A hand, an arm or a person before the panel: is the button that is asked for given only where it is?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.pictures import pictured
from elevator_rectify.core import Config, GridFit, ScaleConfig, TargetConfig, find_button, fit_panel
from elevator_rectify.core.reading.hidden import SeenLabels, hidden_labels, seen_labels, unless_hidden, unless_respaced
from elevator_rectify.core.types import BoolArray, Image
from elevator_rectify.render.scene import Scene

_LEVELS = ("easy", "medium", "hard")
# It covers this share of the buttons, or more.
_COVERED = 0.3
_TRIES, _SKIN = 200, ((120, 150, 190), (60, 75, 110), (45, 45, 48), (200, 205, 215))
# A place is right within this share of the pitch.
_RIGHT_PITCH = 0.3


@dataclass(frozen=True)
class Asked:
    """One question: of a button under the hand or not; seen before: whether the panel was seen without it; the status,
    and whether the button that was given is where it is."""

    covered: bool
    seen_before: bool
    status: str
    right: bool


def with_hand(image: Image, scene: Scene, rng: np.random.Generator) -> tuple[Image, BoolArray]:
    """Return the picture with a hand and an arm before a third of the buttons, and which (M,) it covers."""
    centre, extent = scene.pixels.mean(axis=0), np.ptp(scene.pixels, axis=0)
    covered, under = image, np.zeros(len(scene.pixels), dtype=bool)
    for _ in range(_TRIES):
        tip = centre + rng.uniform(-0.5, 0.5, 2) * extent
        way = rng.normal(0.0, 1.0, 2)
        end = tip + 2000.0 * way / np.linalg.norm(way)
        mask = np.zeros(image.shape[:2], np.uint8)
        width = int(rng.uniform(0.25, 0.7) * extent.max())
        points = [tuple(int(v) for v in p) for p in (tip, end)]
        cv2.line(mask, *points, 255, max(2, width), cv2.LINE_AA)
        at = scene.pixels.round().astype(int)
        inside = ((at >= 0) & (at < [image.shape[1], image.shape[0]])).all(axis=1)
        under = inside & (mask[at[:, 1] * inside, at[:, 0] * inside] > 0)
        if _COVERED <= under.mean() < 1.0:
            soft = cv2.GaussianBlur(mask, (0, 0), 2.0)[..., None] / 255.0
            covered = image * (1.0 - soft) + soft * np.array(_SKIN[rng.integers(len(_SKIN))])
            return np.asarray(covered.astype(np.uint8)), under
    return covered, np.zeros_like(under)


def run_hand(task: tuple[int, int]) -> list[Asked]:
    """Ask for a covered button and for one that is not, with and without a frame before: (seed, number)."""
    seed, number = task
    given = pictured(_LEVELS[number % 3], seed, number, held_out=True)
    scene, rng = given.scene, np.random.default_rng([seed, number, 13])
    covered, under = with_hand(given.image, scene, rng)
    if not under.any():
        return []
    config = Config(
        scale=ScaleConfig(column_pitch_m=float(scene.panel.pitch_m[0])), target=TargetConfig(max_lateral_std_m=0.01)
    )
    left = [d for d, k in zip(scene.detections, scene.button, strict=True) if k < 0 or not under[k]]
    before = fit_panel(scene.detections, scene.camera, config, image=given.image)
    seen = seen_labels(before) if before.ok else None
    tracked = fit_panel(left, scene.camera, config, before if before.ok else None, covered)
    cold = fit_panel(left, scene.camera, config, image=covered)
    chosen = [int(rng.choice(np.flatnonzero(which))) for which in (under, ~under)]
    return [
        asked
        for k, is_covered in zip(chosen, (True, False), strict=True)
        for asked in (
            _asked(scene, tracked, config, k, seen, is_covered),
            _asked(scene, cold, config, k, None, is_covered),
        )
    ]


def _asked(scene: Scene, fit: GridFit, config: Config, k: int, seen: SeenLabels | None, covered: bool) -> Asked:
    label = scene.panel.buttons[k].label
    fit = unless_respaced(fit, seen) if fit.ok else fit
    choice = find_button(fit, label, config.target)
    if seen is not None and fit.ok:
        known = seen_labels(fit, seen)
        choice = unless_hidden(choice, label, hidden_labels(known, fit, scene.camera))
    right = False
    if choice.button is not None:
        true = scene.R_camera_panel @ scene.panel.placed_m[k] + scene.t_camera_panel
        off = (choice.button.point - true) @ scene.R_camera_panel[:, :2]
        right = bool(np.linalg.norm(off) < _RIGHT_PITCH * scene.panel.pitch_m[0])
    return Asked(covered, seen is not None, choice.status, right)


def hands_table(number: int, seed: int, figures: Figures) -> str:
    """Return the table of a number of pictures, two questions each, with and without a frame before."""
    several = parallel(run_hand, [(seed, n) for n in range(number)], "hands")
    found = [asked for one in several for asked in one]
    lines = [f"{'a hand before a third of the buttons':<40}{'asked':>7}{'right':>8}{'wrong':>7}  refused as"]
    lines += list(_lines(found, figures))
    return "\n".join(lines)


def _lines(found: list[Asked], figures: Figures) -> Iterator[str]:
    for covered in (True, False):
        for before in (True, False):
            of_kind = [a for a in found if a.covered == covered and a.seen_before == before]
            given = [a for a in of_kind if a.status == "found"]
            wrong = sum(not a.right for a in given)
            refused = Counter(a.status for a in of_kind if a.status != "found").most_common(5)
            name = f"{'under it' if covered else 'beside it'}, {'seen before' if before else 'first frame'}"
            figures.share(f"hand, {name}, wrong-", wrong, len(of_kind))
            said = ", ".join(f"{status} {count}" for status, count in refused)
            share = sum(a.right for a in given) / max(1, len(of_kind))
            yield f"{name:<40}{len(of_kind):>7}{share:>8.3f}{wrong:>7}  {said}"
