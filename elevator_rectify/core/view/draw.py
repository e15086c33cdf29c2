"""Pictures for people: detections, grid and verdict drawn on the input, as in the paper's figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from elevator_rectify.core.types import Array, Button, FitResult, Image
from elevator_rectify.core.view.warp import Rectification

GREEN, RED, AMBER, BLACK, WHITE = (60, 220, 60), (50, 50, 235), (40, 170, 250), (0, 0, 0), (255, 255, 255)
YELLOW = (60, 250, 250)


def as_colour(image: Image) -> Image:
    """Return a BGR copy of a grey or BGR image."""
    return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()


def draw_overlay(
    image: Image, centres_px: Array, fit: FitResult, target: Button | None = None, buttons: Sequence[Button] = ()
) -> Image:
    """Return the image with detections as green diamonds, grid centres as red crosses, and the status in a line.

    target: the button that is to be pressed, drawn as a circle with its label. buttons: their labels are written,
    corrected and inferred ones in amber; around buttons without detection there is a dashed circle, and around those
    whose lamp is lit a yellow one.
    """
    canvas = as_colour(image)
    size, thickness = _stroke(canvas)
    for x, y in _drawable(fit.grid_px.reshape(-1, 2)):
        cv2.drawMarker(canvas, (x, y), RED, cv2.MARKER_CROSS, size, thickness)
    for x, y in _drawable(centres_px):
        cv2.drawMarker(canvas, (x, y), GREEN, cv2.MARKER_DIAMOND, size, thickness)
    _draw_buttons(canvas, buttons, target, size, thickness)
    if fit.ok:
        text = f"ok  {fit.rows} x {fit.columns}  confidence {fit.confidence:.2f}  rms {fit.rms_px:.1f} px"
    else:
        text = f"{fit.status}: {fit.reason}"
    return caption(canvas, [text], GREEN if fit.ok else AMBER)


def draw_rectified(view: Rectification, buttons: Sequence[Button], target: Button | None = None) -> Image:
    """Return the rectified view with the buttons' labels, inferred buttons and the target as in `draw_overlay`."""
    canvas = as_colour(view.image)
    size, thickness = _stroke(canvas)
    at = [_in_view(button, view) for button in buttons]
    _draw_buttons(canvas, at, None if target is None else _in_view(target, view), size, thickness)
    return canvas


def _stroke(canvas: Image) -> tuple[int, int]:
    """Return size and thickness of marks, in pixels."""
    size = max(8, round(0.018 * max(canvas.shape[:2])))
    return size, max(1, size // 8)


def _in_view(button: Button, view: Rectification) -> Button:
    """Return the button with its place in the rectified view instead of the input."""
    return replace(button, image_px=view.camera.project((view.R_rectified_camera @ button.point)[None])[0])


def _draw_buttons(canvas: Image, buttons: Sequence[Button], target: Button | None, size: int, thickness: int) -> None:
    """Draw all buttons, and a circle around the target with its label."""
    for button in buttons:
        _draw_button(canvas, button, size, thickness)
    for x, y in _drawable(target.image_px[None]) if target is not None else ():
        cv2.circle(canvas, (x, y), 2 * size, AMBER, 2 * thickness, cv2.LINE_AA)
        cv2.putText(canvas, _ascii(target), (x + 2 * size, y), cv2.FONT_HERSHEY_SIMPLEX, size / 16.0, AMBER, thickness)


def _draw_button(canvas: Image, button: Button, size: int, thickness: int) -> None:
    """Write a button's label beside it; draw a circle around a lit one, dash it around one that was not detected."""
    if button.state == "empty":
        return
    for x, y in _drawable(button.image_px[None]):
        if button.state == "inferred":
            for start in range(0, 360, 45):
                cv2.ellipse(canvas, (x, y), (size, size), 0, start, start + 25, AMBER, thickness, cv2.LINE_AA)
        if button.lit == "yes":
            cv2.circle(canvas, (x, y), size, YELLOW, thickness, cv2.LINE_AA)
        colour = WHITE if button.label_source in ("read", "taught") else AMBER
        at = (x + size // 2, y - size // 2)
        outlined_text(canvas, _ascii(button), at, size / 28.0, colour)


def _ascii(button: Button | None) -> str:
    """Return the label as OpenCV's fonts can draw it."""
    return "" if button is None else button.label.encode("ascii", "replace").decode()


def _drawable(points: Array) -> Sequence[tuple[int, int]]:
    """Return the rounded points that lie near enough to an image to be drawn."""
    near = points[(np.abs(np.nan_to_num(points, nan=1e9)) < 3e4).all(axis=1)]
    return [(int(x), int(y)) for x, y in near.round()]


def caption(canvas: Image, lines: Sequence[str], colour: tuple[int, int, int] = WHITE) -> Image:
    """Write lines of text, with a dark outline, into the lower left corner, in place; return the canvas."""
    scale = max(0.5, canvas.shape[0] / 900.0)
    step = round(34 * scale)
    for number, line in enumerate(reversed(list(lines))):
        outlined_text(canvas, line, (6, canvas.shape[0] - 8 - number * step), scale, colour)
    return canvas


def outlined_text(canvas: Image, text: str, at: tuple[int, int], scale: float, colour: tuple[int, int, int]) -> Image:
    """Write the text with a dark outline as wide as its strokes, in place; return the canvas.

    The outline is the same text shifted: OpenCV 5 draws thick strokes much wider than OpenCV 4.
    """
    font, width = cv2.FONT_HERSHEY_SIMPLEX, max(1, round(1.5 * scale))
    for dx in (-width, 0, width):
        for dy in (-width, 0, width):
            cv2.putText(canvas, text, (at[0] + dx, at[1] + dy), font, scale, BLACK, width, cv2.LINE_AA)
    cv2.putText(canvas, text, at, font, scale, colour, width, cv2.LINE_AA)
    return canvas
