"""Between two looks of the detector the boxes follow the picture: optical flow of their centres, checked both ways."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from elevator_rectify.core.config import NetworkConfig
from elevator_rectify.core.detector.detect import DEFAULT_NETWORK, detect_buttons
from elevator_rectify.core.types import Array, BoolArray, Detection, Image

# Flow that does not lead back to within this share of the box's size, and at most so many pixels, is lost.
_BACK_SHARE, _BACK_PX = 0.1, 2.0
# Where more is lost, or fewer boxes are left, the detector looks anew.
_KEPT_SHARE, _FEWEST = 0.8, 4
_WINDOW_PX, _LEVELS = 21, 3
# The similarity of the boxes' centres may change their size by this much from one look to the next.
_LEAST_SCALE, _MOST_SCALE = 0.7, 1.4


@dataclass(frozen=True)
class Found:
    """Buttons found in a grey picture (height, width), when the detector last looked, and the picture's own stamp."""

    detections: tuple[Detection, ...]
    grey: Image
    looked_ns: int
    stamp_ns: int


def find_or_follow(image: Image, stamp_ns: int, last: Found | None, config: NetworkConfig = DEFAULT_NETWORK) -> Found:
    """Return the buttons of a picture: by the detector at keyframes, between them by following the last ones."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    if last is not None and 0 <= stamp_ns - last.looked_ns < 1e9 * config.keyframe_s and stamp_ns > last.stamp_ns:
        moved = followed(last, grey)
        if moved is not None:
            return Found(moved, grey, last.looked_ns, stamp_ns)
    return Found(tuple(detect_buttons(image, config)), grey, stamp_ns, stamp_ns)


def followed(last: Found, grey: Image) -> tuple[Detection, ...] | None:
    """Return the boxes where they are in the new picture, None where too many are lost."""
    if len(last.detections) < _FEWEST or last.grey.shape != grey.shape:
        return None
    before = np.array([[d.x_px, d.y_px] for d in last.detections], dtype=float)
    now, kept = _flow(last.grey, grey, before, last.detections)
    if kept.sum() < max(_FEWEST, _KEPT_SHARE * len(kept)):
        return None
    scale = _scale(before[kept], now[kept])
    if not _LEAST_SCALE < scale < _MOST_SCALE:
        return None
    return tuple(
        replace(d, x_px=float(x), y_px=float(y), width_px=d.width_px * scale, height_px=d.height_px * scale)
        for d, (x, y), k in zip(last.detections, now, kept, strict=True)
        if k
    )


def _flow(before: Image, after: Image, points: Array, detections: Sequence[Detection]) -> tuple[Array, BoolArray]:
    """Return where the points (N, 2) are in the second picture, and which came back when followed in reverse."""
    options = {"winSize": (_WINDOW_PX, _WINDOW_PX), "maxLevel": _LEVELS}
    start = points.astype(np.float32)
    now, forward, _ = cv2.calcOpticalFlowPyrLK(before, after, start, None, **options)
    back, reverse, _ = cv2.calcOpticalFlowPyrLK(after, before, now, None, **options)
    size = np.array([np.sqrt(max(d.width_px * d.height_px, 1.0)) for d in detections])
    off = np.linalg.norm(back - points, axis=1)
    kept = (forward.ravel() > 0) & (reverse.ravel() > 0) & (off < np.minimum(_BACK_SHARE * size, _BACK_PX))
    return now, np.asarray(kept)


def _scale(before: Array, now: Array) -> float:
    """Return how much larger the points' spread is."""
    spread = [np.sqrt(((p - p.mean(axis=0)) ** 2).sum(axis=1).mean()) for p in (before, now)]
    return float(spread[1] / max(float(spread[0]), 1e-6))
