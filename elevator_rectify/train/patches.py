"""Patches of buttons to learn reading from: cut out of labelled pictures, and drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from elevator_rectify.train.augment import random_light

Image = NDArray[Any]
# A patch shows so much more than the box, as the reader sees it.
MARGIN = 1.15
_LETTERS = tuple("B G L M P R S LG UG PH GF LL CP K C D E A U MZ RF".split())  # noqa: SIM905


def cut_patch(image: Image, box_px: NDArray[Any], side: int, rng: np.random.Generator | None = None) -> Image:
    """Return the box (4,) with its margin as a square patch; with rng shifted, scaled, turned and sheared a little."""
    centre, size = (box_px[:2] + box_px[2:]) / 2.0, np.maximum(box_px[2:] - box_px[:2], 2.0) * MARGIN
    A = np.diag(size / side)
    if rng is not None:
        centre = centre + rng.normal(0, 0.04, 2) * size
        turn, shear = np.radians(rng.normal(0, 5)), rng.normal(0, 0.06)
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        A = A @ rotation @ np.array([[1.0, shear], [0.0, 1.0]]) @ np.diag(np.exp(rng.normal(0.02, 0.09, 2)))
    M = np.column_stack([A, centre - A @ np.array([side / 2, side / 2])])
    # Shrinking averages; growing interpolates.
    factor = max(1.0, float(size.min()) / side)
    source = cv2.GaussianBlur(image, (0, 0), 0.4 * factor) if factor > 1.6 else image
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(source, M, (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE))


def spoilt_patch(patch: Image, rng: np.random.Generator) -> Image:
    """Return the patch in another light, and often at a lower resolution."""
    side = patch.shape[0]
    if rng.random() < 0.35:
        small = int(rng.integers(10, side))
        patch = cv2.resize(cv2.resize(patch, (small, small), interpolation=cv2.INTER_AREA), (side, side))
    return random_light(patch, rng)


def normalised(patch: Image) -> NDArray[np.float32]:
    """Return the patch in grey with mean 0 and standard deviation 1."""
    grey = cv2.cvtColor(patch, cv2.COLOR_BGR2GRAY).astype(np.float32)
    return np.asarray((grey - grey.mean()) / (grey.std() + 4.0), dtype=np.float32)


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

    big = 96
    back, cap = rng.integers(0, 256, 3), rng.integers(0, 256, 3)
    ink = cap.astype(int) + rng.choice([-1, 1]) * rng.integers(60, 200, 3)
    picture = Pillow.new("RGB", (big, big), tuple(int(v) for v in back))
    draw = ImageDraw.Draw(picture)
    inset = rng.uniform(0.0, 0.14, 4) * big
    outline = tuple(int(v) for v in rng.integers(0, 256, 3))
    shape = (inset[0], inset[1], big - inset[2], big - inset[3])
    width = int(rng.integers(0, 7))
    fill = tuple(int(v) for v in cap)
    if rng.random() < 0.5:
        draw.ellipse(shape, fill=fill, outline=outline, width=width)
    else:
        draw.rounded_rectangle(shape, radius=float(rng.uniform(0, 24)), fill=fill, outline=outline, width=width)
    font = ImageFont.truetype(str(fonts[rng.integers(len(fonts))]), int(rng.uniform(0.28, 0.62) * big))
    x0, y0, x1, y1 = draw.textbbox((0, 0), text, font=font)
    fit = min(1.0, 0.8 * big / max(1.0, x1 - x0))
    if fit < 1.0:
        font = ImageFont.truetype(str(font.path), max(10, int(font.size * fit)))
        x0, y0, x1, y1 = draw.textbbox((0, 0), text, font=font)
    at = (big - np.array([x1 + x0, y1 + y0])) / 2 + rng.normal(0, 4, 2)
    draw.text((float(at[0]), float(at[1])), text, font=font, fill=tuple(int(v) for v in np.clip(ink, 0, 255)))
    image = np.asarray(picture)[..., ::-1].copy()
    if rng.random() < 0.3:
        image = image + _gradient(big, rng)[..., None]
    return cut_patch(np.clip(image, 0, 255).astype(np.uint8), np.array([7.0, 7.0, big - 7.0, big - 7.0]), side, rng)


def _gradient(size: int, rng: np.random.Generator) -> Image:
    y, x = np.mgrid[0:size, 0:size] / size - 0.5
    direction = rng.normal(0, 90, 2)
    return np.asarray(direction[0] * x + direction[1] * y)
