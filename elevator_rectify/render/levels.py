"""Random panels and viewpoints of four levels of difficulty, for benchmarks and calibration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.types import Array
from elevator_rectify.render.panel import PITCH_M, Button, Look, Panel, framed
from elevator_rectify.render.scene import DetectorModel, Scene, Viewpoint, make_scene, paper_camera

SIZES = ((5, 2), (7, 2), (6, 3), (5, 3), (8, 4), (10, 5), (3, 3), (2, 4))
_MIN_TRUE = 6
_MIN_DISTANCE_PX = 10.0


@dataclass(frozen=True)
class Level:
    """Upper ends of what a trial draws uniformly (tilt, shares), and probabilities of irregular panels."""

    tilt_deg: float
    roll_deg: float
    sigma_px: float
    missed: float = 0.0
    false: float = 0.0
    duplicates: float = 0.0
    half_row: float = 0.0
    absent: float = 0.0
    gap: float = 0.0
    column_gap: float = 0.0
    absent_share: float = 0.125
    # The noise is drawn between sigma_px over this and sigma_px.
    sigma_spread: float = 1.0
    # Any size between two and ten rows, two and six columns, instead of SIZES.
    any_size: bool = False
    # Standard deviation of ln(row pitch / column pitch).
    log_aspect_std: float = 0.2
    clutter: float = 0.0


LEVELS = {
    "easy": Level(30, 5, 1.0),
    "medium": Level(45, 10, 1.5, 0.2, 0.1, 0.0, 0.3, 0.3),
    "hard": Level(60, 20, 2.0, 0.35, 0.2, 0.05, 0.4, 0.4),
    "extreme": Level(60, 20, 3.0, 0.4, 0.3, 0.1, 0.4, 0.4),
    "gaps": Level(45, 10, 1.5, 0.2, 0.1, 0.0, 0.0, 0.3, gap=1.0),
    # As panels really hang, and as good detectors see them; for calibration.
    "wild": Level(45, 10, 2.5, 0.3, 0.5, 0.05, 0.3, 0.5, 0.4, 0.15, 0.35, 10.0, True, 0.35, 0.4),
}


def random_panel(level: Level, rng: np.random.Generator) -> Panel:
    """Draw a panel: size, pitch ratio, absent cells, half-pitch last row, a block beyond a gap of no whole pitch."""
    rows, columns = SIZES[rng.integers(len(SIZES))]
    if level.any_size:
        rows, columns = int(rng.integers(2, 11)), int(rng.integers(2, 7))
    row_pitch = PITCH_M * float(np.exp(rng.normal(0.0, level.log_aspect_std)))
    half, absent = rng.random() < level.half_row, rng.random() < level.absent
    gap = float(rng.uniform(0.25, 0.75)) if rng.random() < level.gap else 0.0
    gap_row = int(rng.integers(max(1, rows - 3), rows)) if gap else rows
    aside = float(rng.uniform(0.25, 0.75)) if level.column_gap and rng.random() < level.column_gap else 0.0
    gap_column = int(rng.integers(1, columns)) if aside else columns
    buttons: list[Button] = []
    for r in range(rows):
        last = half and r == rows - 1
        for c in range(columns - 1 if last else columns):
            x = c + (0.5 if last else 0.0) + (aside if c >= gap_column else 0.0)
            y = r + (gap if r >= gap_row else 0.0)
            block = int(last) + 2 * int(r >= gap_row) + 4 * int(c >= gap_column)
            buttons.append(Button(x * PITCH_M, y * row_pitch, r, c, block))
    if absent:
        most = max(1, int(len(buttons) * level.absent_share))
        gone = rng.choice(len(buttons), int(rng.integers(0, most + 1)), replace=False)
        buttons = [b for k, b in enumerate(buttons) if k not in gone]
    return framed(_numbered(buttons), (PITCH_M, row_pitch), Look())


def _numbered(buttons: list[Button]) -> tuple[Button, ...]:
    """Return the buttons with floors row by row from below, as most panels have them; absent ones leave no gap."""
    upwards = sorted(range(len(buttons)), key=lambda k: (-buttons[k].row, buttons[k].column))
    floor = {k: n + 1 for n, k in enumerate(upwards)}
    return tuple(replace(button, label=str(floor[k])) for k, button in enumerate(buttons))


def random_view(level: Level, rng: np.random.Generator) -> Viewpoint:
    """Draw a viewpoint."""
    return Viewpoint(
        tilt_rad=float(np.deg2rad(rng.uniform(0, level.tilt_deg))),
        tilt_axis_rad=float(rng.uniform(0, 2 * np.pi)),
        roll_rad=float(np.deg2rad(rng.uniform(-level.roll_deg, level.roll_deg))),
        fill=float(rng.uniform(0.4, 0.9)),
        offset=(float(rng.uniform(-0.12, 0.12)), float(rng.uniform(-0.12, 0.12))),
    )


def random_scene(
    level: Level, seed: int, trial: int, camera: Camera | None = None, dress: Callable[[Panel], Panel] = lambda p: p
) -> Scene:
    """Draw trial `trial`; the same arguments give the same scene. dress: gives the panel its look.

    Panels with fewer than six true detections, or with neighbours closer than 10 px, are drawn again.
    """
    rng = np.random.default_rng([seed, trial])
    camera = camera or paper_camera()
    scale = camera.width / 640.0
    while True:
        panel, view = dress(random_panel(level, rng)), random_view(level, rng)
        missed, false = rng.uniform(0, level.missed), rng.uniform(0, level.false)
        sigma_px = level.sigma_px
        if level.sigma_spread > 1.0:
            sigma_px *= float(np.exp(-rng.uniform(0.0, np.log(level.sigma_spread))))
        detector = DetectorModel(sigma_px * scale, missed, false, level.duplicates, level.clutter)
        scene = make_scene(panel, camera, view, detector, rng)
        if (scene.button >= 0).sum() >= _MIN_TRUE and closest(scene.pixels) >= _MIN_DISTANCE_PX * scale:
            return scene


def closest(points: Array) -> float:
    """Return the smallest distance between two points; 0 where one is not finite."""
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    return float(np.nan_to_num(distance, nan=0.0).min())
