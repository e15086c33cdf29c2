"""Error curves as pictures: the share of trials below each error."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from elevator_rectify.core.types import Image

_SIZE, _BORDER, _LIMIT_DEG = (720, 480), 60, 10.0
_COLOURS = ((200, 80, 30), (40, 150, 40), (40, 60, 220), (150, 40, 150), (90, 90, 90))
_GREY, _BLACK = (215, 215, 215), (40, 40, 40)


def error_curves(errors_deg: dict[str, list[float]], title: str) -> Image:
    """Return a picture with one cumulative curve per name, errors from 0 to 10 degrees."""
    canvas = np.full((_SIZE[1], _SIZE[0], 3), 255, np.uint8)
    _axes(canvas, title)
    limits = np.linspace(0.0, _LIMIT_DEG, 200)
    for k, (name, values) in enumerate(errors_deg.items()):
        share = (np.asarray(values)[None] <= limits[:, None]).mean(axis=1)
        points = np.array([_at(x, y) for x, y in zip(limits, share, strict=True)], dtype=np.int32)
        colour = _COLOURS[k % len(_COLOURS)]
        cv2.polylines(canvas, [points], False, colour, 2, cv2.LINE_AA)
        _write(canvas, name, (_SIZE[0] - 240, _SIZE[1] - _BORDER - 20 - 22 * k), colour)
    return canvas


def _at(x: float, y: float) -> tuple[int, int]:
    """Return the pixel of an error in degrees and a share."""
    width, height = _SIZE[0] - 2 * _BORDER, _SIZE[1] - 2 * _BORDER
    return round(_BORDER + width * x / _LIMIT_DEG), round(_SIZE[1] - _BORDER - height * y)


def _axes(canvas: Image, title: str) -> None:
    for step in range(11):
        for ends in (((step, 0.0), (step, 1.0)), ((0.0, step / 10), (_LIMIT_DEG, step / 10))):
            cv2.line(canvas, _at(*ends[0]), _at(*ends[1]), _GREY, 1)
    for step in range(0, 11, 2):
        _write(canvas, str(step), (_at(step, 0)[0] - 5, _SIZE[1] - _BORDER + 20), _BLACK)
        _write(canvas, f"{step / 10:.1f}", (18, _at(0, step / 10)[1] + 5), _BLACK)
    _write(canvas, f"{title}: share of trials below the rotation error in degrees", (_BORDER, 30), _BLACK)


def _write(canvas: Image, text: str, at: tuple[int, int], colour: tuple[int, int, int]) -> None:
    cv2.putText(canvas, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)


def write_curves(folder: Path, level: str, errors_deg: dict[str, list[float]]) -> Path:
    """Write the level's picture; return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"errors_{level}.png"
    cv2.imwrite(str(path), error_curves(errors_deg, level))
    return path
