"""External call panels and small ones: one to five buttons, near enough to see their outlines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.rotations import rotation
from elevator_rectify.core.types import Array
from elevator_rectify.render.looks import dressed
from elevator_rectify.render.outline import half_size_m
from elevator_rectify.render.panel import PITCH_M, Button, Look, Panel, framed
from elevator_rectify.render.scene import DetectorModel, Scene, detected, paper_camera

_LABELS = ("up", "down", "call", "open", "close")
_MOST_TILT_DEG, _MOST_ROLL_DEG = 45.0, 5.0
_SMALLEST_PX, _LARGEST_PX = 40.0, 120.0


def few_panel(number: int, shape: str, rng: np.random.Generator, held_out: bool = False) -> Panel:
    """Return a panel of one to five buttons of a shape ('round', 'square') in a random look.

    Up to three are in a column or a row, more in two columns.
    """
    across = rng.random() < 0.3
    step = PITCH_M * float(rng.uniform(1.0, 1.5))
    places = [(k * step, 0.0, 0, k) if across else (0.0, k * step, k, 0) for k in range(number)]
    if number > 3:
        places = [(k % 2 * step, k // 2 * step, k // 2, k % 2) for k in range(number)]
    buttons = tuple(Button(x, y, r, c, 0, _LABELS[k]) for k, (x, y, r, c) in enumerate(places))
    panel = dressed(framed(buttons, (PITCH_M, PITCH_M), Look(), display=bool(rng.random() < 0.4)), rng, held_out)
    corner = 1.0 if shape == "round" else float(rng.uniform(0.05, 0.5))
    look = replace(panel.look, shape=shape, aspect=1.0, corner_share=corner, label_beside=False)
    return replace(panel, look=look, lit=frozenset())


def few_scene(
    number: int, shape: str, rng: np.random.Generator, held_out: bool = False, camera: Camera | None = None
) -> Scene:
    """Return a scene of it: buttons of 40 to 120 px, tilted up to 45 degrees, somewhere in the image."""
    camera = camera or paper_camera()
    panel = few_panel(number, shape, rng, held_out)
    size = np.array([camera.width, camera.height], dtype=float)
    while True:
        tilt, axis = np.deg2rad(rng.uniform(0.0, _MOST_TILT_DEG)), rng.uniform(0.0, 2.0 * np.pi)
        roll = np.deg2rad(rng.uniform(-_MOST_ROLL_DEG, _MOST_ROLL_DEG))
        R = rotation(tilt * np.array([np.cos(axis), np.sin(axis), 0.0])) @ rotation(np.array([0.0, 0.0, roll]))
        pixels = rng.uniform(_SMALLEST_PX, _LARGEST_PX) * camera.width / 640.0
        depth = camera.focal_px * 2.0 * float(half_size_m(panel.look, panel.pitch_m)[1]) / pixels
        ray = np.append((size * rng.uniform(0.35, 0.65, 2) - camera.matrix[:2, 2]) / camera.focal_px, 1.0)
        t: Array = ray * depth - R @ panel.points_m.mean(axis=0)
        seen = camera.project(panel.placed_m @ R.T + t)
        margin = 0.9 * pixels
        if ((seen > margin) & (seen < size - margin)).all():
            return detected(panel, camera, R, t, DetectorModel(1.0), rng)
