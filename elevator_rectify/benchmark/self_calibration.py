"""What panels say of the camera: rendered pictures of one panel from several sides, the focal length given wrongly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.core import Camera, fit_panel
from elevator_rectify.core.self_calibration import (
    FEWEST_VIEWS,
    PanelShape,
    Sighting,
    calibrated,
    same_shape,
    shape_of_panel,
    sighting_of,
)
from elevator_rectify.core.types import FitResult
from elevator_rectify.render.levels import LEVELS, random_panel
from elevator_rectify.render.looks import dressed, random_taking
from elevator_rectify.render.photograph import photograph
from elevator_rectify.render.scene import DetectorModel, Viewpoint, make_scene

VIEWS = (3, 5, 10)
_FOCAL_PX, _MOST_OFF, _SCATTER = 420.0, 0.06, 0.003
# Views that are taken until enough show the same rows and columns.
_MOST_TAKEN = 16


@dataclass(frozen=True)
class Found:
    """One estimate: views, error of ln f and of the first coefficient, each with its standard deviation."""

    views: int
    focal: float
    focal_std: float
    k1: float
    k1_std: float
    significant: bool
    off: float


def run_panel(task: tuple[int, int]) -> list[Found]:
    """Calibrate by one panel: (seed, number); fewer estimates where fewer views show the same rows and columns."""
    rng = np.random.default_rng([*task, 91])
    off = float(rng.uniform(-_MOST_OFF, _MOST_OFF))
    given = Camera.from_matrix(_matrix(_FOCAL_PX * np.exp(off)), 640, 480)
    sightings: list[Sighting] = []
    shape: PanelShape | None = None
    for fit in _fits(given, rng):
        shape = shape or shape_of_panel(fit)
        sighting = sighting_of(fit)
        sightings += [sighting] if sighting is not None else []
        if len(sightings) == VIEWS[-1]:
            break
    if shape is None or len(sightings) < FEWEST_VIEWS:
        return []
    found = []
    for views in VIEWS:
        if views <= len(sightings):
            e = calibrated(sightings[:views], shape, given)
            error = float(np.log(e.focal_share)) + off
            found.append(Found(views, error, e.focal_std, e.k1, e.k1_std, e.significant, off))
    return found


def _matrix(focal_px: float) -> list[list[float]]:
    return [[focal_px, 0, 320], [0, focal_px, 240], [0, 0, 1]]


def _fits(given: Camera, rng: np.random.Generator) -> Iterator[FitResult]:
    """Yield the accepted fits of the first one's shape to pictures of a panel, made with another camera than given."""
    true = Camera.from_matrix(_matrix(_FOCAL_PX), 640, 480)
    panel = dressed(random_panel(LEVELS["medium"], rng), rng, True, _SCATTER)
    first: FitResult | None = None
    for _ in range(_MOST_TAKEN):
        view = Viewpoint(rng.uniform(0.1, 0.8), rng.uniform(0.0, 6.28), rng.normal(0.0, 0.05), rng.uniform(0.7, 0.9))
        scene = make_scene(panel, true, view, DetectorModel(1.0, 0.03), rng)
        image = photograph(scene, rng, random_taking(rng))
        fit = fit_panel(list(scene.detections), given, image=image)
        if fit.ok and (first is None or same_shape(first, fit)):
            first = first or fit
            yield fit


def self_calibration_table(panels: int, seed: int, figures: Figures) -> str:
    """Return the table: errors by number of views; distortion is estimated along, and there is none."""
    results = [f for r in parallel(run_panel, [(seed, n) for n in range(panels)], "self-calibration") for f in r]
    lines = [
        f"focal length given wrongly by up to {100 * _MOST_OFF:.0f} %, rendered panels in held-out looks",
        f"{'views':>5}{'panels':>8}{'off %: median':>14}{'p95':>7}{'std %':>7}{'in 2 std':>9}"
        f"{'k1: median':>12}{'p95':>7}{'in 2 std':>9}{'wrong by 3 % and more told':>28}{'by 1 % and less':>17}",
    ]
    for views in VIEWS:
        mine = [f for f in results if f.views == views]
        if not mine:
            continue
        f, s, k, ks = np.abs([[m.focal, m.focal_std, m.k1, m.k1_std] for m in mine]).T
        told = [m.significant for m in mine if abs(m.off) > 0.03]
        falsely = [m.significant for m in mine if abs(m.off) < 0.01]
        figures.median(f"self-calibration, {views} views, focal length off-", f)
        lines.append(
            f"{views:>5}{len(mine):>8}{100 * np.median(f):>14.2f}{100 * np.percentile(f, 95):>7.2f}"
            f"{100 * np.median(s):>7.2f}{np.mean(f < 2 * s):>9.2f}{np.median(k):>12.3f}{np.percentile(k, 95):>7.3f}"
            f"{np.mean(k < 2 * ks):>9.2f}{f'{sum(told)} of {len(told)}':>28}{f'{sum(falsely)} of {len(falsely)}':>17}"
        )
    return "\n".join(lines)
