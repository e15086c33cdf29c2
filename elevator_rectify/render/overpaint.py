"""Lamps and fingers painted over pictures of real panels, and the same panel taken once more."""

from __future__ import annotations

import cv2
import numpy as np

from elevator_rectify.core.types import Array, Image

# White, amber, blue, red, green, orange lamps (BGR).
_LAMPS = ((255, 255, 255), (60, 170, 255), (255, 120, 40), (40, 40, 255), (70, 255, 70), (30, 120, 255))
# Skin, gloves, grippers (BGR).
_FINGERS = (
    (140, 165, 215),
    (95, 120, 170),
    (60, 75, 110),
    (40, 40, 42),
    (150, 150, 152),
    (70, 90, 60),
    (210, 210, 212),
)
_FRACTION = 8
# What differs from its surroundings by so many grey values, at least over this share, is the print.
_PRINT, _LEAST_PRINT = 10.0, 0.04


def with_lamp(image: Image, box_px: Array, rng: np.random.Generator) -> Image:
    """Return the picture with the lamp of the button in the box (4,) xmin, ymin, xmax, ymax lit.

    A ring, the print or the whole cap, of any colour and brightness, with its glow.
    """
    middle, half = (box_px[:2] + box_px[2:]) / 2, (box_px[2:] - box_px[:2]) / 2
    lit = (_ring, _print, _cap)[rng.integers(3)](image, middle, half, rng)
    colour = np.array(_LAMPS[rng.integers(len(_LAMPS))], np.float32)
    strength = float(rng.uniform(0.45, 1.0))
    glow = cv2.GaussianBlur(lit, (0, 0), max(0.5, 0.15 * float(half.min())))
    work = image.astype(np.float32)
    work = work * (1 - strength * lit[..., None]) + strength * lit[..., None] * np.maximum(colour, 0.6 * work)
    work += 0.2 * strength * glow[..., None] * colour
    return _grey_values(work)


def _grey_values(work: Image) -> Image:
    return np.asarray(np.clip(work, 0, 255).astype(np.uint8))


def _shape(image: Image, middle: Array, half: Array, share: float, thick: int, square: bool) -> Image:
    """Return (height, width) float32, 1 on the outline of a shape of that share of the box, or on all of it (-1)."""
    canvas = np.zeros(image.shape[:2], np.float32)
    centre, sides = (tuple(int(v) for v in np.round(_FRACTION * a)) for a in (middle, share * half))
    if square:
        corners = [tuple(c + s * d for c, d in zip(centre, sides, strict=True)) for s in (-1, 1)]
        cv2.rectangle(canvas, *corners, 1.0, thick, cv2.LINE_AA, 3)
    else:
        cv2.ellipse(canvas, centre, (max(1, sides[0]), max(1, sides[1])), 0, 0, 360, 1.0, thick, cv2.LINE_AA, 3)
    return canvas


def _ring(image: Image, middle: Array, half: Array, rng: np.random.Generator) -> Image:
    thick = max(1, round(0.24 * float(half.min())))
    return _shape(image, middle, half, float(rng.uniform(0.7, 0.95)), thick, bool(rng.random() < 0.5))


def _cap(image: Image, middle: Array, half: Array, rng: np.random.Generator) -> Image:
    return _shape(image, middle, half, float(rng.uniform(0.6, 0.95)), -1, bool(rng.random() < 0.5))


def _print(image: Image, middle: Array, half: Array, rng: np.random.Generator) -> Image:
    """Return what is printed on the button, or a character where nothing is."""
    inside = _shape(image, middle, half, 0.55, -1, True)
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)
    if (inside > 0).sum() > 8:
        off = np.abs(grey - np.median(grey[inside > 0]))
        lit = np.clip((off - _PRINT) / 30.0, 0.0, 1.0) * inside
        if lit.sum() > _LEAST_PRINT * 4 * np.prod(half):
            return np.asarray(lit)
    canvas = np.zeros(image.shape[:2], np.uint8)
    origin = (int(middle[0] - 0.35 * half[0]), int(middle[1] + 0.35 * half[1]))
    thick = max(1, int(0.1 * half.min()))
    cv2.putText(canvas, "8", origin, 0, float(half[1]) / 22, 255, thick, cv2.LINE_AA)
    return canvas.astype(np.float32) / 255


def with_finger(image: Image, box_px: Array, rng: np.random.Generator, off: float | None = None) -> Image:
    """Return the picture with a finger or gripper whose tip is so many sizes off the box's middle, random for None."""
    middle, size = (box_px[:2] + box_px[2:]) / 2, float((box_px[2:] - box_px[:2]).mean())
    away = rng.uniform(0.0, 0.9) if off is None else off
    side, along = rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi)
    tip = middle + away * size * np.array([np.cos(side), np.sin(side)])
    end = tip + 3.0 * max(image.shape[:2]) * np.array([np.cos(along), np.sin(along)])
    width = size * float(rng.uniform(0.7, 2.0))
    canvas = np.zeros(image.shape[:2], np.uint8)
    points = [tuple(int(v) for v in np.clip(np.round(_FRACTION * p), -30000, 30000)) for p in (tip, end)]
    cv2.line(canvas, *points, 255, max(1, int(width)), cv2.LINE_AA, 3)
    mask = cv2.GaussianBlur(canvas, (0, 0), max(0.5, 0.04 * size)).astype(np.float32)[..., None] / 255
    y, x = np.mgrid[0 : image.shape[0], 0 : image.shape[1]].astype(np.float32)
    across = ((x - tip[0]) * -np.sin(along) + (y - tip[1]) * np.cos(along)) / width
    shade = 0.75 + 0.35 * np.cos(2.2 * np.clip(across, -0.7, 0.7)) + 0.1 * np.clip(across, -1, 1)
    skin = np.array(_FINGERS[rng.integers(len(_FINGERS))], np.float32) * float(rng.uniform(0.6, 1.15))
    shadow = cv2.GaussianBlur(canvas, (0, 0), 0.35 * size + 1).astype(np.float32)[..., None] / 255
    work = image.astype(np.float32) * (1 - float(rng.uniform(0.1, 0.5)) * shadow)
    work = work * (1 - mask) + mask * skin * shade[..., None]
    return _grey_values(work)


def taken_again(image: Image, rng: np.random.Generator, moved_px: float = 3.0) -> tuple[Image, Array]:
    """Return the picture as another frame shows it, and the map (3, 3) to it from the first.

    The camera moved a little; exposure, light, white balance, noise and compression are new, and a reflection may be
    elsewhere.
    """
    height, width = image.shape[:2]
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    H = cv2.getPerspectiveTransform(corners, (corners + rng.normal(0, moved_px, (4, 2))).astype(np.float32))
    moved = cv2.warpPerspective(image, H, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    work = moved.astype(np.float32)
    x, y = np.meshgrid(np.linspace(-1, 1, width, dtype=np.float32), np.linspace(-1, 1, height, dtype=np.float32))
    towards = rng.uniform(0, 2 * np.pi)
    work *= (rng.uniform(0.75, 1.3) * (1 + 0.08 * (np.cos(towards) * x + np.sin(towards) * y)))[..., None]
    if rng.random() < 0.6:
        spot, radius = rng.uniform(-0.7, 0.7, 2), rng.uniform(0.05, 0.4)
        work += (rng.uniform(5, 50) * np.exp(-((x - spot[0]) ** 2 + (y - spot[1]) ** 2) / radius**2))[..., None]
    work *= rng.normal(1, 0.02, 3).astype(np.float32)
    work += rng.normal(0, rng.uniform(1, 4), work.shape)
    out = _grey_values(work)
    _, data = cv2.imencode(".jpg", out, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(70, 95))])
    return cv2.imdecode(data, cv2.IMREAD_COLOR), H
