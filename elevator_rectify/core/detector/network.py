"""The detector's network: from a picture to a heat map of centres and the distances to the four sides.

CenterNet's heat map (Zhou et al., "Objects as Points") with FCOS's distances (Tian et al.), half a million weights at
most, trained by train/detector on real panels (docs/models.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from elevator_rectify.core.types import Array, Image

WEIGHTS = Path(__file__).with_name("detector.onnx")
# Pixels of the network's input per cell of its output, and the multiple that its input's sides must be.
STRIDE, _MULTIPLE = 4, 32
# Grey around a picture that is no multiple.
_FILL = (114.0, 114.0, 114.0)


@dataclass(frozen=True)
class HeatMap:
    """heat: (2, h, w) probability of a button's centre, and of another thing's; boxes_px: (4, h, w) in the picture."""

    heat: NDArray[np.float32]
    boxes_px: NDArray[np.float32]


@cache
def _network(path: Path) -> Any:
    return cv2.dnn.readNetFromONNX(str(path))


def heat_map(image: Image, scale: float, weights: Path = WEIGHTS) -> HeatMap:
    """Run the network on the picture (height, width[, 3]) uint8, resized by `scale`."""
    colour = image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    height, width = (max(1, round(scale * side)) for side in colour.shape[:2])
    shrunk = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    small = cv2.resize(colour, (width, height), interpolation=shrunk)
    right, bottom = (-side % _MULTIPLE for side in (width, height))
    padded = cv2.copyMakeBorder(small, 0, bottom, 0, right, cv2.BORDER_CONSTANT, value=_FILL)
    network = _network(weights)
    network.setInput(cv2.dnn.blobFromImage(padded, 1.0 / 255.0, swapRB=True))
    out = network.forward()[0]
    heat = 1.0 / (1.0 + np.exp(-np.clip(out[:2], -30.0, 30.0)))
    return HeatMap(heat.astype(np.float32), (_boxes(out[2:]) / scale).astype(np.float32))


def _boxes(distances: Array) -> Array:
    """Return (4, h, w) xmin, ymin, xmax, ymax in the network's input of ln distances over the stride (4, h, w)."""
    h, w = distances.shape[1:]
    reach = np.exp(np.clip(distances, -3.0, 5.0)) * STRIDE
    x = (np.arange(w, dtype=np.float32) + 0.5) * STRIDE
    y = ((np.arange(h, dtype=np.float32) + 0.5) * STRIDE)[:, None]
    return np.stack([x - reach[0], y - reach[1], x + reach[2], y + reach[3]])
