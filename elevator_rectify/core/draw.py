"""Pictures for people: detections, grid and verdict drawn on the input, as in the paper's figures."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from elevator_rectify.core.types import Array, GridFit, Image

GREEN, RED, AMBER, BLACK, WHITE = (60, 220, 60), (50, 50, 235), (40, 170, 250), (0, 0, 0), (255, 255, 255)


def as_colour(image: Image) -> Image:
    """Return a BGR copy of a grey or BGR image."""
    return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()


def draw_overlay(image: Image, centres_px: Array, fit: GridFit) -> Image:
    """Return the image with detections as green diamonds, grid centres as red crosses, and the status in a line."""
    canvas = as_colour(image)
    size = max(8, round(0.018 * max(canvas.shape[:2])))
    thickness = max(1, size // 8)
    for x, y in _drawable(fit.grid_px.reshape(-1, 2)):
        cv2.drawMarker(canvas, (x, y), RED, cv2.MARKER_CROSS, size, thickness)
    for x, y in _drawable(centres_px):
        cv2.drawMarker(canvas, (x, y), GREEN, cv2.MARKER_DIAMOND, size, thickness)
    if fit.ok:
        text = f"ok  {fit.rows} x {fit.columns}  confidence {fit.confidence:.2f}  rms {fit.rms_px:.1f} px"
    else:
        text = f"{fit.status}: {fit.reason}"
    return caption(canvas, [text], GREEN if fit.ok else AMBER)


def _drawable(points: Array) -> Sequence[tuple[int, int]]:
    """Return the rounded points that lie near enough to an image to be drawn."""
    near = points[(np.abs(np.nan_to_num(points, nan=1e9)) < 3e4).all(axis=1)]
    return [(int(x), int(y)) for x, y in near.round()]


def caption(canvas: Image, lines: Sequence[str], colour: tuple[int, int, int] = WHITE) -> Image:
    """Write lines of text, with a dark outline, into the lower left corner, in place; return the canvas."""
    scale = max(0.4, canvas.shape[0] / 1000.0)
    step = round(34 * scale)
    for number, line in enumerate(reversed(list(lines))):
        at = (6, canvas.shape[0] - 8 - number * step)
        for tint, width in ((BLACK, 3), (colour, 1)):
            cv2.putText(
                canvas, line, at, cv2.FONT_HERSHEY_SIMPLEX, scale, tint, max(1, round(width * scale * 1.4)), cv2.LINE_AA
            )
    return canvas
