"""Pictures of a plate and of the caps on it, drawn flat at high resolution."""

from __future__ import annotations

import cv2
import numpy as np

from elevator_rectify.core.types import Array, Image
from elevator_rectify.render.outline import half_size_m, outline_m
from elevator_rectify.render.panel import Button, Look, Panel

PLATE_PX_PER_M = 4000.0
# Fractional bits of OpenCV's polygons: buttons are drawn where they are, not at whole pixels.
_SHIFT = 6
_BEVEL_STEPS = 6
_HERSHEY_PX = 22.0

Colour = tuple[float, float, float]


def draw_plate(panel: Panel, rng: np.random.Generator) -> Image:
    """Return the plate as a BGR uint8 image of PLATE_PX_PER_M pixels a metre, without the caps."""
    x0, y0, x1, y1 = panel.plate_m
    width, height = round((x1 - x0) * PLATE_PX_PER_M), round((y1 - y0) * PLATE_PX_PER_M)
    canvas = np.empty((height, width, 3), np.uint8)
    canvas[:] = panel.look.plate
    if panel.look.brushed:
        grain = cv2.blur(rng.normal(0.0, 1.0, (height, width)).astype(np.float32), (129, 3))
        canvas = cv2.add(canvas, cv2.merge([grain * np.float32(5.0 / grain.std())] * 3), dtype=cv2.CV_8U)
    _screws(canvas, panel.look)
    if panel.display_m:
        _display(canvas, panel, str(rng.integers(1, 9)))
    look = panel.look
    for number, button in enumerate(panel.buttons):
        centre = centre_px(panel, number)
        shadow = shade(look.plate, 0.6)
        _fill(canvas, outline_m(look, panel.pitch_m, look.ring_share + 0.04), centre + _shadow_px(panel), shadow)
        ring = look.lamp if number in panel.lit else look.rim
        _fill(canvas, outline_m(look, panel.pitch_m, look.ring_share), centre, ring)
        if look.braille:
            _braille(canvas, panel, centre, rng)
        if look.label_beside:
            side = half_size_m(look, panel.pitch_m)[0] * (1.5 + look.ring_share) * PLATE_PX_PER_M
            _text(canvas, button.label, centre - [side, 0.0], 0.55 * _half_px(panel), look, look.ink)
    return canvas


def draw_caps(panel: Panel) -> tuple[Image, Image]:
    """Return the caps as BGR, on the plate's grid, and the mask of where they are."""
    x0, y0, x1, y1 = panel.plate_m
    size = round((y1 - y0) * PLATE_PX_PER_M), round((x1 - x0) * PLATE_PX_PER_M)
    caps, mask = np.zeros((*size, 3), np.uint8), np.zeros(size, np.uint8)
    # Around the caps their own colour: the mask's soft edge must not darken them.
    caps[:] = panel.look.face
    for number, button in enumerate(panel.buttons):
        centre = centre_px(panel, number)
        _fill(mask, outline_m(panel.look, panel.pitch_m), centre, (255, 255, 255))
        _cap(caps, panel, button, centre, number in panel.lit)
    return caps, mask


def centre_px(panel: Panel, number: int) -> Array:
    """Return where button `number` is on the plate's picture (2,); pixel centres lie at whole numbers."""
    return np.asarray((panel.placed_m[number, :2] - panel.plate_m[:2]) * PLATE_PX_PER_M - 0.5)


def shade(colour: Colour, factor: float) -> Colour:
    """Return the colour, lighter or darker."""
    b, g, r = (float(min(255.0, factor * c)) for c in colour)
    return b, g, r


def _half_px(panel: Panel) -> float:
    return float(half_size_m(panel.look, panel.pitch_m)[1]) * PLATE_PX_PER_M


def _shadow_px(panel: Panel) -> Array:
    depth = 0.06 + panel.look.height_share
    return np.array([0.7, 1.0]) * depth * _half_px(panel)


def _fill(canvas: Image, outline: Array, centre: Array, colour: Colour) -> None:
    """Fill an outline (M, 2) in metres around a centre in pixels."""
    points = ((outline * PLATE_PX_PER_M + centre) * 2**_SHIFT).round().astype(np.int32)
    cv2.fillPoly(canvas, [points], colour, cv2.LINE_AA, _SHIFT)


def _cap(canvas: Image, panel: Panel, button: Button, centre: Array, lit: bool) -> None:
    """Draw a bevelled face, and the label on it."""
    look = panel.look
    half = _half_px(panel)
    # One fill beyond the outline: what shows of it is cut by the mask.
    _fill(canvas, outline_m(look, panel.pitch_m, 0.05), centre, shade(look.face, 1.0 - 1.5 * look.bevel))
    for step in range(_BEVEL_STEPS):
        inner = 0.18 * (step + 1) / _BEVEL_STEPS
        light = 1.0 + look.bevel * (1.5 - 3.0 * (step + 1) / _BEVEL_STEPS) if step < _BEVEL_STEPS - 1 else 1.0
        at = centre - 0.04 * half * (1.0 - (step + 1) / _BEVEL_STEPS)
        _fill(canvas, outline_m(look, panel.pitch_m, -inner), at, shade(look.face, light))
    if look.gloss:
        spot = outline_m(look, panel.pitch_m, -0.55)
        _fill(canvas, spot, centre - 0.25 * half, shade(look.face, 1.0 + look.gloss))
    if not look.label_beside:
        ink = look.lamp if lit else look.ink
        if look.engraved:
            _text(canvas, button.label, centre + 0.05 * half, half, look, shade(look.face, 1.35))
        _text(canvas, button.label, centre, half, look, ink)


def _text(canvas: Image, text: str, centre: Array, half: float, look: Look, ink: Colour) -> None:
    scale = half / _HERSHEY_PX / (1.0 if len(text) < 2 else 1.4)
    thickness = max(2, round(half / 11))
    (width, height), _ = cv2.getTextSize(text, look.font, scale, thickness)
    at = (round(centre[0] - width / 2), round(centre[1] + height / 2))
    cv2.putText(canvas, text, at, look.font, scale, ink, thickness, cv2.LINE_AA)


def _braille(canvas: Image, panel: Panel, centre: Array, rng: np.random.Generator) -> None:
    """Draw raised dots to the left of the button."""
    step = 0.0025 * PLATE_PX_PER_M
    left = half_size_m(panel.look, panel.pitch_m)[0] * (1.12 + panel.look.ring_share) * PLATE_PX_PER_M
    for dot in np.flatnonzero(rng.random(6) < 0.6):
        x, y = centre + np.array([-left - step * (dot % 2), step * (dot // 2 - 1.0)])
        cv2.circle(canvas, (round(x), round(y)), round(0.3 * step), shade(panel.look.plate, 0.7), -1, cv2.LINE_AA)
        cv2.circle(canvas, (round(x - 1), round(y - 1)), round(0.2 * step), shade(panel.look.plate, 1.2), -1)


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
            cv2.circle(canvas, (x, y), inset // 3, shade(look.plate, 0.7), -1, cv2.LINE_AA)
            ends = (x - inset // 4, y), (x + inset // 4, y)
            cv2.line(canvas, *ends, shade(look.plate, 0.4), 4, cv2.LINE_AA)


def pixel_map(origin_m: tuple[float, float], px_per_m: float) -> Array:
    """Return the (3, 3) map from texture pixels to panel coordinates in metres."""
    half = 0.5 / px_per_m
    x, y = origin_m
    return np.array([[1 / px_per_m, 0.0, x + half], [0.0, 1 / px_per_m, y + half], [0.0, 0.0, 1.0]])
