"""Pictures of a plate with its buttons, drawn flat at high resolution."""

from __future__ import annotations

import cv2
import numpy as np

from elevator_rectify.core.types import Array, Image
from elevator_rectify.render.panel import Button, Look, Panel

PLATE_PX_PER_M = 5000.0
WALL_PX_PER_M = 700.0
WALL_M = 1.4


def draw_plate(panel: Panel, rng: np.random.Generator) -> Image:
    """Return the plate as a BGR uint8 image of PLATE_PX_PER_M pixels a metre."""
    x0, y0, x1, y1 = panel.plate_m
    width, height = round((x1 - x0) * PLATE_PX_PER_M), round((y1 - y0) * PLATE_PX_PER_M)
    plate = np.empty((height, width, 3), np.float32)
    plate[:] = panel.look.plate
    if panel.look.brushed:
        grain = cv2.GaussianBlur(rng.normal(0, 1, (height, width)).astype(np.float32), (0, 0), 40, sigmaY=0.6)
        plate += (grain / grain.std() * 5.0)[..., None]
    canvas = np.clip(plate, 0, 255).astype(np.uint8)
    _screws(canvas, panel.look)
    if panel.display_m:
        _display(canvas, panel, str(rng.integers(1, 9)))
    for number, button in enumerate(panel.buttons):
        centre = (round((button.x_m - x0) * PLATE_PX_PER_M), round((button.y_m - y0) * PLATE_PX_PER_M))
        radius = 0.5 * panel.look.button_share * min(panel.pitch_m) * PLATE_PX_PER_M
        _button(canvas, button, centre, round(radius), panel.look, number in panel.lit)
    return canvas


def _disc(canvas: Image, centre: tuple[int, int], radius: int, colour: tuple[float, ...], round_shape: bool) -> None:
    """Fill a circle or a rounded square."""
    if round_shape:
        cv2.circle(canvas, centre, radius, colour, -1, cv2.LINE_AA)
        return
    corner, (x, y) = max(2, radius // 4), centre
    cv2.rectangle(canvas, (x - radius + corner, y - radius), (x + radius - corner, y + radius), colour, -1)
    cv2.rectangle(canvas, (x - radius, y - radius + corner), (x + radius, y + radius - corner), colour, -1)
    for sx in (-1, 1):
        for sy in (-1, 1):
            cv2.circle(
                canvas, (x + sx * (radius - corner), y + sy * (radius - corner)), corner, colour, -1, cv2.LINE_AA
            )


def _button(canvas: Image, button: Button, centre: tuple[int, int], radius: int, look: Look, lit: bool) -> None:
    """Draw shadow, rim, a bevelled face, a lamp where lit, and the label."""
    x, y = centre
    shadow = tuple(0.6 * c for c in look.plate)
    _disc(canvas, (x + radius // 12, y + radius // 8), round(1.14 * radius), shadow, look.round)
    _disc(canvas, centre, round(1.1 * radius), look.lamp if lit else look.rim, look.round)
    for step in range(8):
        light = 1.12 - 0.03 * step
        shade = tuple(float(min(255.0, light * c)) for c in look.face)
        _disc(
            canvas, (x - (7 - step) // 3, y - (7 - step) // 3), round(radius * (1.0 - 0.012 * step)), shade, look.round
        )
    ink = look.lamp if lit else look.ink
    scale = radius / (26.0 if len(button.label) < 2 else 36.0)
    thickness = max(2, round(radius / 11))
    (width, height), _ = cv2.getTextSize(button.label, cv2.FONT_HERSHEY_DUPLEX, scale, thickness)
    cv2.putText(
        canvas,
        button.label,
        (x - width // 2, y + height // 2),
        cv2.FONT_HERSHEY_DUPLEX,
        scale,
        ink,
        thickness,
        cv2.LINE_AA,
    )


def _display(canvas: Image, panel: Panel, text: str) -> None:
    """Draw the floor display."""
    assert panel.display_m is not None
    origin = np.array(panel.plate_m[:2] * 2)
    x0, y0, x1, y1 = ((np.array(panel.display_m) - origin) * PLATE_PX_PER_M).round().astype(int).tolist()
    cv2.rectangle(canvas, (x0, y0), (x1, y1), (16, 16, 18), -1)
    cv2.rectangle(canvas, (x0, y0), (x1, y1), (90, 90, 92), 6)
    scale = (y1 - y0) / 42.0
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, scale, 14)
    at = ((x0 + x1 - width) // 2, (y0 + y1 + height) // 2)
    cv2.putText(canvas, text, at, cv2.FONT_HERSHEY_DUPLEX, scale, (40, 60, 240), 14, cv2.LINE_AA)


def _screws(canvas: Image, look: Look) -> None:
    """Draw a screw in each corner of the plate."""
    height, width = canvas.shape[:2]
    inset = round(0.009 * PLATE_PX_PER_M)
    for x in (inset, width - inset):
        for y in (inset, height - inset):
            cv2.circle(canvas, (x, y), inset // 3, tuple(0.7 * c for c in look.plate), -1, cv2.LINE_AA)
            cv2.line(
                canvas, (x - inset // 4, y), (x + inset // 4, y), tuple(0.4 * c for c in look.plate), 4, cv2.LINE_AA
            )


def draw_wall(look: Look, rng: np.random.Generator) -> Image:
    """Return the wall around the plate: WALL_M to each side of the panel's origin, with seams, a rail and stains."""
    size = round(2 * WALL_M * WALL_PX_PER_M)
    wall = np.empty((size, size, 3), np.float32)
    wall[:] = look.wall
    for sigma, strength in ((120.0, 14.0), (8.0, 4.0), (1.0, 3.0)):
        coarse = cv2.resize(
            rng.normal(0, 1, (256, 256)).astype(np.float32), (size, size), interpolation=cv2.INTER_CUBIC
        )
        stain = cv2.GaussianBlur(
            coarse if sigma > 4 else rng.normal(0, 1, (size, size)).astype(np.float32), (0, 0), min(sigma, 24.0)
        )
        wall += (stain / stain.std() * strength)[..., None]
    canvas = np.clip(wall, 0, 255).astype(np.uint8)
    for seam in rng.uniform(0.05, 0.95, 3):
        at = round(seam * size)
        cv2.line(canvas, (at, 0), (at, size), tuple(0.55 * c for c in look.wall), 4, cv2.LINE_AA)
    rail = round(size * rng.uniform(0.72, 0.8))
    cv2.rectangle(canvas, (0, rail), (size, rail + 34), tuple(min(255.0, 1.3 * c) for c in look.wall), -1)
    cv2.rectangle(canvas, (0, rail + 34), (size, rail + 46), tuple(0.5 * c for c in look.wall), -1)
    return canvas


def pixel_map(origin_m: tuple[float, float], px_per_m: float) -> Array:
    """Return the (3, 3) map from texture pixels to panel coordinates in metres."""
    return np.array([[1 / px_per_m, 0.0, origin_m[0]], [0.0, 1 / px_per_m, origin_m[1]], [0.0, 0.0, 1.0]])
