"""Patches of buttons to learn reading from: cut out of labelled pictures, and drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from elevator_rectify.core.reading.reader import MARGIN, SHARPEST
from elevator_rectify.train.augment import random_light

Image = NDArray[Any]
_LETTERS = tuple("B G L M P R S LG UG PH GF LL CP K C D E A U MZ RF".split())  # noqa: SIM905


def cut_patch(image: Image, box_px: NDArray[Any], side: int, rng: np.random.Generator | None = None) -> Image:
    """Return the box (4,) with its margin as a square patch; with rng shifted, scaled, turned and sheared a little."""
    centre, size = (box_px[:2] + box_px[2:]) / 2.0, np.maximum(box_px[2:] - box_px[:2], 2.0) * MARGIN
    A = np.diag(size / side)
    if rng is not None:
        centre = centre + rng.normal(0, 0.05, 2) * size / MARGIN
        A = A @ _random_linear(rng)
    M = np.column_stack([A, centre - A @ np.array([side / 2, side / 2])])
    corners = M @ np.array([[0, side, side, 0], [0, 0, side, side], [1, 1, 1, 1]])
    low = np.clip(corners.min(axis=1) - 4, 0, [image.shape[1] - 2, image.shape[0] - 2]).astype(int)
    high = np.clip(corners.max(axis=1) + 5, low + 1, [image.shape[1], image.shape[0]]).astype(int)
    part, M[:, 2] = image[low[1] : high[1], low[0] : high[0]], M[:, 2] - low
    # Shrinking averages; growing interpolates.
    factor = max(1.0, float(size.min()) / side)
    if factor > SHARPEST:
        part = cv2.GaussianBlur(part, (0, 0), 0.4 * factor)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(part, M, (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE))


def _random_linear(rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a turn, shear and scale (2, 2); now and then the box is of the cap, not the plate, or the reverse."""
    turn, shear = np.radians(rng.normal(0, 5)), rng.normal(0, 0.06)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    scale = np.exp(rng.normal(0.02, 0.09, 2))
    if rng.random() < 0.25:
        scale = scale * np.exp(rng.uniform(-0.3, 0.4))
    return np.asarray(rotation @ np.array([[1.0, shear], [0.0, 1.0]]) @ np.diag(scale))


def spoilt_patch(patch: Image, rng: np.random.Generator) -> Image:
    """Return the patch in another light, and often at a lower resolution."""
    side = patch.shape[0]
    if rng.random() < 0.35:
        small = int(np.exp(rng.uniform(np.log(14), np.log(side))))
        patch = cv2.resize(cv2.resize(patch, (small, small), interpolation=cv2.INTER_AREA), (side, side))
    return random_light(patch, rng)


def with_lamp(patch: Image, rng: np.random.Generator) -> Image:
    """Return the patch of a button without print with a lamp, on or off, that is no 0."""
    side = patch.shape[0]
    at = side / 2 + rng.normal(0, 0.12, 2) * side
    radius = np.exp(rng.uniform(np.log(0.02), np.log(0.09))) * side
    y, x = np.mgrid[0:side, 0:side]
    inside = np.clip(radius + 0.5 - np.hypot(x - at[0], y - at[1]), 0.0, 1.0)[..., None]
    colour = rng.integers(0, 256, 3) if rng.random() < 0.5 else _ink(patch.mean(axis=(0, 1)), rng)
    glow = cv2.GaussianBlur(inside, (0, 0), 1.0 + radius)[..., None] * rng.uniform(0, 120) * (rng.random() < 0.5)
    lit = patch * (1.0 - inside) + colour * inside + glow
    return np.asarray(np.clip(lit, 0, 255).astype(np.uint8))


def font_files() -> list[Path]:
    """Return the fonts of the machine (Debian's fonts-dejavu-core, -liberation, -freefont-ttf, -lato, ...)."""
    found = Path("/usr/share/fonts").rglob("*.ttf")
    return sorted(p for p in found if "Symbol" not in p.name and "Emoji" not in p.name)


def random_text(rng: np.random.Generator) -> str:
    """Return a floor as panels print them: mostly numbers, the two-digit ones evenly."""
    kind = rng.random()
    if kind < 0.62:
        return str(rng.integers(0, 70))
    if kind < 0.70:
        return f"-{rng.integers(1, 6)}"
    if kind < 0.78:
        return "*" + str(rng.choice(["1", "G", "L", "P", "2", "0"]))
    if kind < 0.9:
        return str(rng.choice(_LETTERS))
    if kind < 0.97:
        return str(rng.choice(["B", "P", "L", "M", "LG", "G"])) + str(rng.integers(1, 8))
    return str(rng.integers(1, 20)) + str(rng.choice(["A", "B", "M", "R"]))


def drawn_patch(text: str, side: int, rng: np.random.Generator, fonts: list[Path]) -> Image:
    """Return a made-up button with the text on it."""
    from PIL import Image as Pillow
    from PIL import ImageDraw, ImageFont

    big = 128
    back, cap = _material(rng), _material(rng)
    picture = Pillow.new("RGB", (big, big), _colour(back))
    draw = ImageDraw.Draw(picture)
    shape = _drawn_cap(draw, big, cap, rng)
    size = int(np.exp(rng.uniform(np.log(0.24), np.log(0.66))) * (shape[3] - shape[1]))
    font = ImageFont.truetype(str(fonts[rng.integers(len(fonts))]), max(12, size))
    x0, y0, x1, y1 = draw.textbbox((0, 0), text, font=font)
    if x1 - x0 > 0.8 * (shape[2] - shape[0]):
        font = ImageFont.truetype(str(font.path), max(10, int(font.size * 0.8 * (shape[2] - shape[0]) / (x1 - x0))))
        x0, y0, x1, y1 = draw.textbbox((0, 0), text, font=font)
    middle = np.array([shape[0] + shape[2], shape[1] + shape[3]]) / 2
    at = middle - np.array([x1 + x0, y1 + y0]) / 2 + rng.normal(0, 5, 2)
    ink = _ink(cap, rng)
    draw.text((float(at[0]), float(at[1])), text, font=font, fill=_colour(ink))
    if rng.random() < 0.25:
        _drawn_braille(draw, at + np.array([x0, y1 + 3.0]), big, ink if rng.random() < 0.5 else _ink(cap, rng), rng)
    image = np.asarray(picture)[..., ::-1].copy()
    if rng.random() < 0.3:
        image = image + _gradient(big, rng)[..., None]
    return cut_patch(np.clip(image, 0, 255).astype(np.uint8), np.array([16.0, 16.0, big - 16, big - 16]), side, rng)


def _colour(bgr: NDArray[Any]) -> tuple[int, ...]:
    return tuple(int(v) for v in np.clip(bgr, 0, 255))


def _material(rng: np.random.Generator) -> NDArray[Any]:
    """Return a colour, more often of metal or plastic than bright."""
    colour = rng.integers(0, 256, 3)
    return colour if rng.random() < 0.25 else np.asarray(0.15 * colour + 0.85 * rng.integers(0, 256))


def _ink(cap: NDArray[Any], rng: np.random.Generator) -> NDArray[Any]:
    """Return a colour that stands out from the cap, grey or lit."""
    ink = cap.astype(int) + rng.choice([-1, 1]) * rng.integers(60, 200, 3)
    if rng.random() < 0.3:
        ink[rng.integers(3)] = rng.choice([0, 255])
    return np.asarray(ink if np.abs(np.clip(ink, 0, 255) - cap).max() > 45 else 255 - cap)


def _drawn_cap(draw: Any, big: int, cap: NDArray[Any], rng: np.random.Generator) -> tuple[float, ...]:
    """Draw the cap, often with rings around it; return the extent that print may take."""
    inset = rng.uniform(0.08, 0.2, 4) * big
    shape = (inset[0], inset[1], big - inset[2], big - inset[3])
    draw_shape = draw.ellipse if rng.random() < 0.55 else draw.rounded_rectangle
    for ring in range(int(rng.integers(0, 3))):
        draw_shape(shape, fill=_colour(_material(rng)))
        step = rng.uniform(0.02, 0.09 if ring else 0.13) * big
        shape = (shape[0] + step, shape[1] + step, shape[2] - step, shape[3] - step)
    draw_shape(shape, fill=_colour(cap), outline=_colour(rng.integers(0, 256, 3)), width=int(rng.integers(0, 6)))
    return shape


def _drawn_braille(draw: Any, at: NDArray[Any], big: int, ink: NDArray[Any], rng: np.random.Generator) -> None:
    """Draw some cells of braille below the print."""
    dot = rng.uniform(0.012, 0.022) * big
    for cell in range(int(rng.integers(1, 4))):
        for k in np.flatnonzero(rng.random(6) < 0.5):
            x, y = at + dot * np.array([9.0 * cell + 3.2 * (k % 2), 3.2 * (k // 2)])
            draw.ellipse((x, y, x + 2 * dot, y + 2 * dot), fill=_colour(ink))


def _gradient(size: int, rng: np.random.Generator) -> Image:
    y, x = np.mgrid[0:size, 0:size] / size - 0.5
    direction = rng.normal(0, 90, 2)
    return np.asarray(direction[0] * x + direction[1] * y)
