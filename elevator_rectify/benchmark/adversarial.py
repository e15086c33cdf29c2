"""Sets of detections that lie: boxes that are not the picture's, and lattices that are no panels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.negatives import boxed, curves, overlapping
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.pictures import Pictured, pictured
from elevator_rectify.core import Config, fit_panel
from elevator_rectify.core.geometry.rotations import rotation, rotation_angle_rad
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.types import Array, Detection
from elevator_rectify.render.scene import Scene, paper_camera

Rng = np.random.Generator
_CONFIG = Config()
_LEVELS = ("easy", "medium", "hard")
# Accepted, and off by more than this: in rotation, or sideways on any button, in pitches of the picture.
_WRONG_DEG, _GRAVE_DEG, _WRONG_PITCH = 5.0, 10.0, 0.35
_OTHER = 1_000_000
# Of a normal variable, for the bounds of a share (Wilson).
_95 = 1.96


def _moved(scene: Scene, change: Callable[[Detection], Detection]) -> list[Detection]:
    return [change(d) for d in scene.detections]


def _letterboxed(given: Pictured, rng: Rng) -> list[Detection]:
    """Boxes of a square network input: 80 px of border above."""
    return _moved(given.scene, lambda d: replace(d, y_px=d.y_px + 80.0))


def _squeezed(given: Pictured, rng: Rng) -> list[Detection]:
    """Boxes of an input that was squeezed to a square."""
    return _moved(given.scene, lambda d: replace(d, x_px=d.x_px * 0.75, width_px=d.width_px * 0.75))


def _cropped(given: Pictured, rng: Rng) -> list[Detection]:
    """Boxes in the coordinates of a region of interest."""
    x, y = rng.uniform(40, 140, 2)
    return _moved(given.scene, lambda d: replace(d, x_px=d.x_px - x, y_px=d.y_px - y))


def _mirrored(given: Pictured, rng: Rng) -> list[Detection]:
    """Boxes of the mirrored picture."""
    return _moved(given.scene, lambda d: replace(d, x_px=639.0 - d.x_px))


def _shifted(given: Pictured, rng: Rng) -> list[Detection]:
    """All boxes 60 px off."""
    angle = rng.uniform(0, 2 * np.pi)
    x, y = 60.0 * np.array([np.cos(angle), np.sin(angle)])
    return _moved(given.scene, lambda d: replace(d, x_px=d.x_px + x, y_px=d.y_px + y))


def _corner(given: Pictured, rng: Rng) -> list[Detection]:
    """The upper left corners for the centres."""
    return _moved(given.scene, lambda d: replace(d, x_px=d.x_px - d.width_px / 2, y_px=d.y_px - d.height_px / 2))


def _frame_before(given: Pictured, rng: Rng) -> list[Detection]:
    """Boxes of the frame before: the camera has turned by two to six degrees since."""
    camera, axis = given.scene.camera, rng.normal(0, 1, 3)
    R = rotation(axis / np.linalg.norm(axis) * np.deg2rad(rng.uniform(2, 6)))
    rays = np.column_stack([camera.rays(given.scene.centres_px), np.ones(len(given.scene.detections))]) @ R.T
    places = camera.project(rays)
    return [replace(d, x_px=float(x), y_px=float(y)) for d, (x, y) in zip(given.scene.detections, places, strict=True)]


def _another_panel(given: Pictured, rng: Rng) -> list[Detection]:
    """Boxes of another panel."""
    other = pictured("medium", 7, int(rng.integers(_OTHER)), picture=False)
    return list(other.scene.detections)


def _third_left(given: Pictured, rng: Rng) -> list[Detection]:
    """A third of the boxes: what is left is right, but may fit other lattices, too."""
    keep = rng.permutation(len(given.scene.detections))[: max(6, len(given.scene.detections) // 3)]
    return [given.scene.detections[k] for k in sorted(keep)]


PICTURED: dict[str, Callable[[Pictured, Rng], list[Detection]]] = {
    "letterboxed": _letterboxed,
    "squeezed": _squeezed,
    "cropped": _cropped,
    "mirrored": _mirrored,
    "off by 60 px": _shifted,
    "corner for centre": _corner,
    "frame before": _frame_before,
    "another panel": _another_panel,
    "a third left": _third_left,
}


def _grid(rng: Rng, rows: tuple[int, int] = (3, 8), columns: tuple[int, int] = (2, 6)) -> Array:
    """Return the places (M, 2) of a lattice, in pitches."""
    r, c = int(rng.integers(*rows)), int(rng.integers(*columns))
    return np.asarray(np.stack(np.meshgrid(np.arange(c), np.arange(r)), axis=-1).reshape(-1, 2), dtype=np.float64)


def _placed(points: Array, rng: Rng) -> Array:
    """Return points in pitches as pixels of a frontal view, with a detector's noise."""
    points = (points - points.mean(axis=0)) * rng.uniform(35, 55)
    return np.asarray(points + np.array([320.0, 240.0]) + rng.normal(0, 1.0, points.shape))


def _corner_of_walls(rng: Rng) -> Array:
    """A lattice over an inside corner: its right half recedes. With the boxes' sizes (M, 4)."""
    points = _grid(rng, (3, 6), (4, 7))
    beyond = points[:, 0] > points[:, 0].max() / 2
    angle = np.deg2rad(rng.uniform(40, 80))
    fold = points[:, 0] - points[:, 0].max() / 2
    depth = np.where(beyond, 8.0 - np.sin(angle) * fold, 8.0)
    x = np.where(beyond, points[:, 0].max() / 2 + np.cos(angle) * fold, points[:, 0])
    seen = np.column_stack([x - x.mean(), points[:, 1] - points[:, 1].mean()]) / depth[:, None]
    at = seen * 320 + np.array([320.0, 240.0]) + rng.normal(0, 1.0, points.shape)
    size = 0.6 * 320 / depth[:, None] * np.column_stack([np.where(beyond, np.cos(angle), 1.0), np.ones(len(at))])
    return np.column_stack([at, size * np.exp(rng.normal(0, 0.06, at.shape))])


def _sheared(rng: Rng) -> Array:
    points = _grid(rng)
    return _placed(points + np.outer(points[:, 1], [rng.uniform(0.2, 0.45) * rng.choice([-1, 1]), 0.0]), rng)


def _trapezoid(rng: Rng) -> Array:
    points = _grid(rng, (4, 8), (3, 6))
    narrow = 1.0 - rng.uniform(0.08, 0.15) * points[:, 1]
    middle = points[:, 0].mean()
    return _placed(np.column_stack([middle + (points[:, 0] - middle) * np.maximum(narrow, 0.2), points[:, 1]]), rng)


def _text_lines(rng: Rng) -> Array:
    lines = []
    for row in range(int(rng.integers(3, 7))):
        width = np.cumsum(rng.uniform(0.4, 1.1, int(rng.integers(4, 9))))
        lines.append(np.column_stack([width, np.full(len(width), 1.3 * row)]))
    return _placed(np.concatenate(lines), rng)


def _rings(rng: Rng) -> Array:
    number = int(rng.integers(8, 13))
    angle = 2 * np.pi * np.arange(number) / number
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    return _placed(np.concatenate([2.0 * ring, 3.2 * ring]), rng)


def _stairs(rng: Rng) -> Array:
    points = _grid(rng, (3, 6), (3, 6))
    return _placed(points + np.outer(points[:, 0], [0.0, rng.uniform(0.35, 0.65)]), rng)


def _keyboard(rng: Rng) -> Array:
    rows = [np.column_stack([np.arange(10) + o, np.full(10, r)]) for r, o in enumerate((0.0, 0.3, 0.55, 1.05))]
    return _placed(np.concatenate(rows), rng)


def _shelf(rng: Rng) -> Array:
    rows = [np.column_stack([np.sort(rng.uniform(0, 6, 6)), np.full(6, 1.6 * r)]) for r in range(4)]
    return _placed(np.concatenate(rows), rng)


def _hexagonal(rng: Rng) -> Array:
    points = _grid(rng, (4, 7), (3, 6))
    return _placed(points * [1.0, np.sqrt(3) / 2] + np.column_stack([0.5 * (points[:, 1] % 2), 0 * points[:, 1]]), rng)


UNPICTURED: dict[str, Callable[[Rng], Array]] = {
    "corner of two walls": _corner_of_walls,
    "sheared": _sheared,
    "trapezoid": _trapezoid,
    "lines of text": _text_lines,
    "rings": _rings,
    "stairs": _stairs,
    "keyboard": _keyboard,
    "shelf": _shelf,
    "hexagonal": _hexagonal,
    "curves": curves,
    "two lattices": overlapping,
}


@dataclass(frozen=True)
class Outcome:
    """One set: accepted, accepted and wrong, and wrong by more than ten degrees."""

    accepted: bool
    wrong: bool
    grave: bool


def run_pictured(task: tuple[str, int, int]) -> Outcome:
    """Fit lying boxes in a sharp picture: (kind, seed, number)."""
    kind, seed, number = task
    given = pictured(_LEVELS[number % 3], seed, number, held_out=True)
    rng = np.random.default_rng([seed, number, len(kind)])
    fit = fit_panel(PICTURED[kind](given, rng), given.scene.camera, _CONFIG, image=given.image)
    return judged_against(fit, given.scene)


def judged_against(fit: GridFit, scene: Scene) -> Outcome:
    """Compare a fit with what is in the picture: every detected cell must be a button's."""
    if not fit.ok:
        return Outcome(False, False, False)
    turned = float(np.rad2deg(rotation_angle_rad(fit.R_camera_panel.T @ scene.R_camera_panel)))
    cells = np.unique(fit.cells[fit.cells[:, 0] >= 0], axis=0)
    at = fit.grid_px[cells[:, 0], cells[:, 1]]
    nearest = np.linalg.norm(at[:, None] - scene.pixels, axis=-1).min(axis=1)
    steps = np.linalg.norm(np.diff(fit.grid_px, axis=1), axis=-1)
    off = float(np.median(nearest)) / float(np.median(steps))
    return Outcome(True, turned > _WRONG_DEG or off > _WRONG_PITCH, turned > _GRAVE_DEG)


def run_unpictured(task: tuple[str, int, int]) -> Outcome:
    """Fit the centres of a set that is no panel: (kind, seed, number)."""
    detections = _no_panel(*task)
    return _facing(np.array([[d.x_px, d.y_px] for d in detections]))


def run_boxed(task: tuple[str, int, int]) -> Outcome:
    """Fit the boxes of a set that is no panel: (kind, seed, number)."""
    return _facing(_no_panel(*task))


def _no_panel(kind: str, seed: int, number: int) -> list[Detection]:
    rng = np.random.default_rng([seed, number, len(kind)])
    points = UNPICTURED[kind](rng)
    return boxed(points, rng) if points.shape[1] == 2 else [Detection(x, y, w, h) for x, y, w, h in points.tolist()]


def _facing(detections: Array | list[Detection]) -> Outcome:
    """Without truth an accepted fit that does not face the camera, as the set was drawn, is wrong."""
    fit = fit_panel(detections, paper_camera(), _CONFIG)
    turned = float(np.rad2deg(np.arccos(min(1.0, abs(fit.R_camera_panel[2, 2]))))) if fit.ok else 0.0
    return Outcome(fit.ok, fit.ok and turned > 2.0 * _WRONG_DEG, fit.ok and turned > 2.0 * _GRAVE_DEG)


def wilson(hits: int, number: int) -> tuple[float, float]:
    """Return the 95 % bounds of a share (Wilson 1927)."""
    if not number:
        return 0.0, 1.0
    p, z2 = hits / number, _95**2 / number
    middle, spread = p + z2 / 2, _95 * np.sqrt(p * (1 - p) / number + z2 / (4 * number))
    return float(max(0.0, (middle - spread) / (1 + z2))), float(min(1.0, (middle + spread) / (1 + z2)))


HEADER = f"{'':<22}{'sets':>6}{'accepted %':>11}{'wrong %':>9}{'95 % bounds':>14}{'by 10 deg':>11}"


def adversarial_table(sets: int, seed: int, figures: Figures) -> str:
    """Return the table of `sets` sets in all."""
    each = max(1, sets // (len(PICTURED) + 2 * len(UNPICTURED)))
    lines = ["boxes that are not the picture's, with the picture", HEADER]
    lines += [_line(kind, "", run_pictured, each, seed, figures) for kind in PICTURED]
    for title, run in (("centres", run_unpictured), ("boxes", run_boxed)):
        lines += [
            "",
            f"lattices that are no panels, from the {title} alone; wrong: not facing the camera, as they do",
            HEADER,
        ]
        lines += [_line(kind, f"{title} ", run, each, seed, figures) for kind in UNPICTURED]
    return "\n".join(lines)


def _line(
    kind: str, of: str, run: Callable[[tuple[str, int, int]], Outcome], each: int, seed: int, figures: Figures
) -> str:
    results = parallel(run, [(kind, seed, k) for k in range(each)], kind)
    accepted, wrong, grave = (sum(getattr(r, part) for r in results) for part in ("accepted", "wrong", "grave"))
    figures.share(f"adversarial, {of}{kind}, wrong-", wrong, each)
    low, high = wilson(wrong, each)
    bounds = f"{100 * low:.1f} to {100 * high:.1f}"
    return f"{kind:<22}{each:>6}{100 * accepted / each:>11.1f}{100 * wrong / each:>9.2f}{bounds:>14}{grave:>11}"
