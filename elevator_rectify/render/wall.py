"""The wall around the plate: seams and a rail that are not the panel's."""

from __future__ import annotations

import cv2
import numpy as np

from elevator_rectify.core.types import Image
from elevator_rectify.render.panel import Look
from elevator_rectify.render.texture import shade

WALL_PX_PER_M = 400.0
WALL_M = 1.4


def draw_wall(look: Look, rng: np.random.Generator) -> Image:
    """Return the wall as BGR, WALL_M to each side of the panel's origin, with seams, a rail and stains."""
    size = round(2 * WALL_M * WALL_PX_PER_M)
    stain = np.zeros((size, size), np.float32)
    for cells, strength in ((24, 14.0), (160, 4.0), (size, 3.0)):
        coarse = rng.normal(0.0, strength, (cells, cells)).astype(np.float32)
        stain += cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC)
    canvas: Image = np.clip(stain[..., None] + np.array(look.wall), 0, 255).astype(np.uint8)
    for seam in rng.uniform(0.05, 0.95, 3):
        at = round(seam * size)
        cv2.line(canvas, (at, 0), (at, size), shade(look.wall, 0.55), 2, cv2.LINE_AA)
    rail = round(size * rng.uniform(0.72, 0.8))
    cv2.rectangle(canvas, (0, rail), (size, rail + 20), shade(look.wall, 1.3), -1)
    cv2.rectangle(canvas, (0, rail + 20), (size, rail + 26), shade(look.wall, 0.5), -1)
    return canvas
