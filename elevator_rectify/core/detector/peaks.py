"""From heat maps to boxes: one box a peak, the best of those that overlap, scores that are probabilities."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from elevator_rectify.core.detector.network import HeatMap
from elevator_rectify.core.types import Array, BoolArray, IntArray

# Peaks below this heat are noise, not even doubtful.
_LEAST_HEAT = 0.08
# Boxes that overlap by more are one thing.
_SAME_IOU = 0.4
# A box with its centre inside another of so many times its area is that one's print or rim.
_INSIDE_AREA = 6.0
# Boxes are alike within this ln of their sizes, and nearby within so many sizes; so many of them support one.
_ALIKE, _NEARBY, _SUPPORTERS = 0.3, 8.0, 3


@dataclass(frozen=True)
class Boxes:
    """boxes_px: (N, 4) xmin, ymin, xmax, ymax; heat: (N,); is_button: (N,), else another thing. Best first."""

    boxes_px: Array
    heat: Array
    is_button: BoolArray


def centres_of(boxes_px: Array) -> Array:
    """Return the centres (N, 2) of boxes (N, 4), counted from the middle of the corner pixel as elsewhere; the network
    counts from its corner."""
    return np.asarray((boxes_px[:, :2] + boxes_px[:, 2:]) / 2.0 - 0.5)


def peaks(found: HeatMap) -> Boxes:
    """Return the boxes at the local maxima of both classes, of overlapping ones the best."""
    spread = np.ones((3, 3), np.uint8)
    top = np.stack([cv2.dilate(layer, spread) for layer in found.heat])
    kind, row, column = np.nonzero((found.heat >= top) & (found.heat > _LEAST_HEAT))
    heat = found.heat[kind, row, column].astype(float)
    boxes = _averaged(found, kind, row, column)
    order = np.argsort(-heat, kind="stable")
    return suppressed(Boxes(boxes[order], heat[order], kind[order] == 0))


def _averaged(found: HeatMap, kind: IntArray, row: IntArray, column: IntArray) -> Array:
    """Return the boxes (N, 4) of the peaks: the mean of the cell's and its four neighbours', weighted by their heat."""
    h, w = found.heat.shape[1:]
    total, weight = np.zeros((len(row), 4)), np.zeros((len(row), 1))
    for dy, dx in ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)):
        r, c = np.clip(row + dy, 0, h - 1), np.clip(column + dx, 0, w - 1)
        share = found.heat[kind, r, c][:, None].astype(float) ** 2
        total += share * found.boxes_px[:, r, c].T
        weight += share
    return np.asarray(total / np.maximum(weight, 1e-12))


def suppressed(given: Boxes) -> Boxes:
    """Return the boxes, best first, without those that overlap with a better one."""
    keep: list[int] = []
    for k in range(len(given.heat)):
        if not keep or not overlaps(given.boxes_px[k], given.boxes_px[keep]).any():
            keep.append(k)
    return Boxes(given.boxes_px[keep], given.heat[keep], given.is_button[keep])


def overlaps(box: Array, others: Array) -> BoolArray:
    """Return (M,) which boxes (M, 4) are the same thing as the box (4,), or hold it, or are held by it."""
    low, high = np.maximum(box[:2], others[:, :2]), np.minimum(box[2:], others[:, 2:])
    both = np.prod(np.maximum(high - low, 0.0), axis=1)
    area, areas = float(np.prod(box[2:] - box[:2])), np.prod(others[:, 2:] - others[:, :2], axis=1)
    inside = both > 0.8 * np.minimum(area, areas)
    nested = inside & (np.maximum(area, areas) < _INSIDE_AREA * np.minimum(area, areas))
    return np.asarray((both > _SAME_IOU * (area + areas - both)) | nested)


def features(found: Boxes) -> Array:
    """Return (N, P) what the probability of a button is computed from, one column being 1.

    Buttons of a panel are alike in size and near each other, and some of them are sure: a box among such is a button
    with less heat of its own than the dots of a speaker, which are alike too, but none of them sure.
    """
    if not len(found.heat):
        return np.zeros((0, FEATURES))
    own, support = log_odds(found.heat), log_odds(_support(found))
    ln_size = np.log(np.maximum(_size(found.boxes_px), 1.0))
    return np.column_stack([np.ones(len(own)), own, support, own * support / 4.0, _off_size(found, ln_size)])


FEATURES = 5


def log_odds(probability: Array) -> Array:
    """Return ln(p / (1 - p)), bounded."""
    p = np.clip(probability, 1e-4, 1.0 - 1e-4)
    return np.asarray(np.log(p / (1.0 - p)))


def _size(boxes_px: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(np.prod(boxes_px[:, 2:] - boxes_px[:, :2], axis=1), 1e-9)))


def _support(found: Boxes) -> Array:
    """Return (N,) the mean heat of the three hottest other boxes of like size nearby; 0 where there are none."""
    size = _size(found.boxes_px)
    centre = (found.boxes_px[:, :2] + found.boxes_px[:, 2:]) / 2.0
    alike = np.abs(np.log(size[:, None] / size[None])) < _ALIKE
    near = np.linalg.norm(centre[:, None] - centre[None], axis=2) < _NEARBY * size[:, None]
    heat = np.where(alike & near & found.is_button[None] & ~np.eye(len(size), dtype=bool), found.heat[None], 0.0)
    heat = np.sort(np.pad(heat, ((0, 0), (_SUPPORTERS, 0))), axis=1)[:, -_SUPPORTERS:]
    return np.asarray(heat.mean(axis=1))


def _off_size(found: Boxes, ln_size: Array) -> Array:
    """Return (N,) how far the box's size is from the usual one of the picture's sure buttons, in ln."""
    weight = np.where(found.is_button, found.heat**3, 0.0)
    if weight.sum() <= 0.0:
        return np.zeros(len(ln_size))
    order = np.argsort(ln_size)
    total = np.cumsum(weight[order])
    usual = ln_size[order][np.searchsorted(total, total[-1] / 2.0)]
    return np.asarray(np.minimum(np.abs(ln_size - usual), 2.0))


def probabilities(found: Boxes, coefficients: Array) -> Array:
    """Return (N,) the calibrated probabilities that the boxes are buttons: a logistic of their features."""
    return np.asarray(1.0 / (1.0 + np.exp(-features(found) @ coefficients)))
