"""How prints stand on the buttons, upright, turned or mirrored: a small network, asked before the reader."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from elevator_rectify.core.types import Array, Image

WEIGHTS = Path(__file__).with_name("attitude.onnx")
# Side of the network's input.
SIDE_PX = 48
# As it is and turned by one, two and three quarters counterclockwise; the same four of its mirror image.
ATTITUDES = 8


@cache
def _network(path: Path) -> Any:
    return cv2.dnn.readNetFromONNX(str(path))


def upright_nats(patches: Sequence[Image], weights: Path = WEIGHTS) -> Array:
    """Return log likelihoods (N, 8), but for a constant each, that square patches (S, S[, 3]) uint8 are upright once
    they are put each way (`put`).

    What looks the same in several ways has the same there: the network sees all of them.
    """
    given = [shrunk(patch)[0] for patch in patches]
    network = _network(weights)
    network.setInput(np.stack([put(patch, way) for patch in given for way in range(ATTITUDES)])[:, None])
    return np.array(network.forward(), dtype=float).reshape(-1, ATTITUDES)


def put(patch: Image, way: int) -> Image:
    """Return the patch (H, W[, C]) turned counterclockwise by `way` modulo 4 quarters, from 4 on its mirror image."""
    turned: Image = np.rot90(patch[:, ::-1] if way >= 4 else patch, way % 4)
    return turned


def shrunk(patch: Image) -> NDArray[np.float32]:
    """Return the patch in grey as (1, 48, 48), of mean 0 and standard deviation 1."""
    grey = patch if patch.ndim == 2 else cv2.cvtColor(patch, cv2.COLOR_BGR2GRAY)
    small = cv2.resize(grey, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA).astype(np.float32)
    return np.asarray((small - small.mean()) / (small.std() + np.float32(8.0)), dtype=np.float32)[None]
