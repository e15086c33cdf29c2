"""Time of one fit by the number of detections: from scratch, and given the fit of the frame before."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cache

import numpy as np

from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.synthetic import yardstick_ms
from elevator_rectify.core.attempts import best_attempt
from elevator_rectify.core.compiled import COMPILED
from elevator_rectify.core.config import Config, with_values
from elevator_rectify.core.detections import usable_detections
from elevator_rectify.core.picture.measured import measure
from elevator_rectify.core.pipeline import fit_panel, sigma_px
from elevator_rectify.core.warm_up import warm_up
from elevator_rectify.render.levels import LEVELS, closest, random_view
from elevator_rectify.render.looks import dressed, random_taking
from elevator_rectify.render.panel import PITCH_M, regular_panel
from elevator_rectify.render.photograph import photograph
from elevator_rectify.render.scene import DetectorModel, Scene, make_scene, paper_camera

SIZES = {10: (5, 2), 30: (10, 3), 60: (12, 5), 200: (20, 10)}
_LEVEL = LEVELS["medium"]
_FALSE = 0.05
# Warps whose median is the yardstick of one draw.
_REPEATS = 15
# 200 buttons fit into a picture where they are half as far apart.
_MANY, _CLOSER, _CLOSEST_PX = 200, 0.5, 6.0


@dataclass(frozen=True)
class Times:
    """Yardsticks of a fit from scratch and of one that tracks it (NaN where the first was refused)."""

    scratch: float
    tracked: float
    accepted: bool


def timed(task: tuple[str, bool, int, int, int]) -> Times:
    """Time one draw: (method, with a picture, detections, seed, number).

    The yardstick is taken beside it: machines that others work on are faster and slower from one minute to the next.
    """
    method, with_picture, size, seed, number = task
    _warmed_up()
    config, rng = with_values(Config(), {"method": method}), np.random.default_rng([seed, number, size])
    first, second = _frames(size, rng)
    image = photograph(first, rng, random_taking(rng)) if with_picture else None
    yardstick_s = 1e-3 * yardstick_ms(_REPEATS)
    start = time.perf_counter()
    fit = fit_panel(first.detections, first.camera, config, image=image)
    middle = time.perf_counter()
    fit_panel(second.detections, second.camera, config, previous=fit, image=image)
    end = time.perf_counter()
    tracked = (end - middle) / yardstick_s if fit.ok else float("nan")
    return Times((middle - start) / yardstick_s, tracked, fit.ok)


@cache
def _warmed_up() -> None:
    """Load what the first fit would, once in every process."""
    warm_up(Config())


def _frames(size: int, rng: np.random.Generator) -> tuple[Scene, Scene]:
    """Return two looks at one panel from one viewpoint of the medium level, the detector's noise drawn anew."""
    rows, columns = SIZES[size]
    pitch_m = PITCH_M * float(np.exp(rng.normal(0.0, 0.2))) * (_CLOSER if size == _MANY else 1.0)
    panel = dressed(regular_panel(rows, columns, pitch_m), rng, held_out=True)
    detector = DetectorModel(_LEVEL.sigma_px, false=_FALSE)
    while True:
        view = random_view(_LEVEL, rng)
        first, second = (make_scene(panel, paper_camera(), view, detector, rng) for _ in range(2))
        if closest(first.pixels) >= (_CLOSEST_PX if size == _MANY else 10.0):
            return first, second


def measurement_line(seed: int, yardstick: float, trials: int = 20) -> str:
    """Return the time that measuring 30 buttons in a 640 x 480 picture adds to a fit, in yardsticks."""
    config, camera, times = Config(), paper_camera(), []
    for number in range(trials):
        rng = np.random.default_rng([seed, number, 30])
        panel = dressed(regular_panel(10, 3), rng, held_out=True)
        scene = make_scene(panel, camera, random_view(_LEVEL, rng), DetectorModel(_LEVEL.sigma_px), rng)
        image = photograph(scene, rng, random_taking(rng))
        usable = usable_detections(scene.detections, camera, config.input)
        sigma = sigma_px(usable, camera, config) / camera.focal_px
        fit = best_attempt(usable, camera, sigma, config).fit
        if fit is None:
            continue
        for _ in range(3):
            start = time.perf_counter()
            measure(fit.best, usable.rays, usable.sizes_px, sigma, image, camera, config)
            times.append(1e3 * (time.perf_counter() - start) / yardstick)
    return f"measuring 30 buttons adds {np.median(times):.1f} yardsticks, p95 {np.percentile(times, 95):.1f}"


def timing_table(method: str, trials: int, seed: int) -> str:
    """Return the table of times in yardsticks: of fits to boxes, and to boxes and picture."""
    by = "compiled with numba" if COMPILED else "NumPy alone"
    head = f"{by:<20}{'N':>4}{'scratch med':>13}{'p95':>7}{'tracked med':>13}{'p95':>7}{'accept':>8}   in yardsticks"
    return "\n".join([head, *(_line(method, p, n, trials, seed) for p in (False, True) for n in SIZES)])


def _line(method: str, with_picture: bool, size: int, trials: int, seed: int) -> str:
    name = "boxes and picture" if with_picture else "boxes"
    tasks = [(method, with_picture, size, seed, n) for n in range(trials)]
    results = parallel(timed, tasks, f"{name}, {size}", workers=1)
    scratch = np.array([t.scratch for t in results])
    # Where the first one was refused, nothing is tracked.
    tracked = np.array([t.tracked for t in results if t.accepted] or [np.nan])
    accepted = np.mean([t.accepted for t in results])
    return (
        f"{name:<20}{size:>4}{np.median(scratch):>13.1f}{np.percentile(scratch, 95):>7.1f}"
        f"{np.median(tracked):>13.2f}{np.percentile(tracked, 95):>7.2f}{accepted:>8.2f}"
    )
