"""Where boxes that the picture contradicts would belong: letterboxed, squeezed, cropped or mirrored ones do by one map.

Two boxes and two buttons that our own detector finds give a scale and an offset of each axis; of all such pairs that
map wins which puts most boxes onto buttons (Fischler and Bolles 1981, every sample of one side tried).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from elevator_rectify.core.config import NetworkConfig
from elevator_rectify.core.detector.detect import find_boxes
from elevator_rectify.core.detector.peaks import centres_of
from elevator_rectify.core.types import Array, Detection, Image

# Buttons that are as sure as this count, and a box is on one whose centre is within this share of its size.
_LIKELY_HEAT, _NEAR = 0.25, 0.3
_SMALLEST, _LARGEST = 0.2, 5.0
# So many boxes, and this share of them, must come to lie on buttons, each on one of its own.
_FEWEST, _SHARE = 5, 0.8
_SAMPLES, _MOST = 4, 30


@dataclass(frozen=True)
class Placement:
    """Where a box's centre belongs, in pixels of the picture: scale (2,) times its place plus offset (2,).

    size_px: (2,) width and height of the picture; box_px: (2,) the buttons' usual ones.
    """

    scale: Array
    offset_px: Array
    size_px: Array
    box_px: Array


def placement(image: Image, detections: Sequence[Detection], config: NetworkConfig) -> Placement | None:
    """Return the map of the boxes' centres onto the picture's buttons, None where none puts most of them there."""
    found = find_boxes(image, config)
    buttons = found.boxes_px[found.is_button & (found.heat > _LIKELY_HEAT)][:_MOST]
    given = np.array([[d.x_px, d.y_px] for d in detections if np.isfinite([d.x_px, d.y_px]).all()])
    if len(given) < _FEWEST or len(buttons) < _FEWEST:
        return None
    given = given[np.linspace(0, len(given) - 1, min(len(given), _MOST)).astype(int)]
    centres, sizes = centres_of(buttons), buttons[:, 2:] - buttons[:, :2]
    best, most = None, 0
    for scale, offset in _maps(given, centres):
        number = _on_buttons(scale, offset, given, centres, sizes)
        k = int(number.argmax()) if len(number) else 0
        if len(number) and number[k] > most:
            best, most = (scale[k], offset[k]), int(number[k])
    if best is None or most < max(_FEWEST, _SHARE * len(given)):
        return None
    scale, offset = _refined(*best, given, centres, sizes)
    return Placement(scale, offset, np.array(image.shape[1::-1], dtype=float), np.median(sizes, axis=0))


def _maps(given: Array, centres: Array) -> Iterator[tuple[Array, Array]]:
    """Yield scales (K, 2) and offsets (K, 2) that bring two of the boxes onto any two of the buttons."""
    apart = np.abs(given[:, None] - given[None]).min(axis=2)
    pairs = np.stack(np.unravel_index(np.argsort(-apart, axis=None, kind="stable"), apart.shape), axis=1)
    first, second = np.divmod(np.arange(len(centres) ** 2), len(centres))
    for i, j in pairs[pairs[:, 0] < pairs[:, 1]][:_SAMPLES]:
        if apart[i, j] < 1.0:
            continue
        scale = (centres[second] - centres[first]) / (given[j] - given[i])
        # No camera shows a panel upside down.
        usual = (np.abs(scale) > _SMALLEST).all(axis=1) & (np.abs(scale) < _LARGEST).all(axis=1) & (scale[:, 1] > 0)
        yield scale[usual], centres[first][usual] - scale[usual] * given[i]


def _on_buttons(scale: Array, offset: Array, given: Array, centres: Array, sizes: Array) -> Array:
    """Return (K,) how many buttons get a box by each of the maps."""
    placed = scale[:, None] * given[None] + offset[:, None]
    off = np.abs(placed[:, :, None] - centres[None, None]) / sizes[None, None]
    return np.asarray((off.max(axis=3) < _NEAR).any(axis=1).sum(axis=1))


def _refined(scale: Array, offset: Array, given: Array, centres: Array, sizes: Array) -> tuple[Array, Array]:
    """Return the map by least squares of the boxes that lie on buttons."""
    off = np.abs(scale * given[:, None] + offset - centres[None]) / sizes
    nearest = off.max(axis=2).argmin(axis=1)
    on = off.max(axis=2).min(axis=1) < _NEAR
    lines = [np.polyfit(given[on, axis], centres[nearest[on], axis], 1) for axis in (0, 1)]
    return np.array([line[0] for line in lines]), np.array([line[1] for line in lines])
