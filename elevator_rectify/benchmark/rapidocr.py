"""RapidOCR beside our own reader: it reads texts of all kinds (`pip install rapidocr==3.10.0 onnxruntime`)."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from elevator_rectify.core.reading.reader import MARGIN, quadrangle_patch
from elevator_rectify.core.types import Array, Image

# It takes rims for characters: it sees the button's box, and its middle.
_VIEWS = (1.0, 0.66)


def installed() -> bool:
    """Tell whether it can be asked."""
    return importlib.util.find_spec("rapidocr") is not None


@cache
def _engine() -> Any:
    one_thread = {"Global.log_level": "error", "EngineConfig.onnxruntime.intra_op_num_threads": 1}
    return importlib.import_module("rapidocr").RapidOCR(params=one_thread)


def read_by_rapidocr(image: Image, corners_px: Sequence[Array]) -> list[tuple[str, float]]:
    """Return text and score of the picture's quadrangles (4, 2), clockwise from the upper left: the surer of two views;
    '' where it reads nothing, and for NaN."""
    blank = ("", 0.0)
    return [_surer(quadrangle_patch(image, c)) if np.isfinite(c).all() else blank for c in corners_px]


def _surer(patch: Image) -> tuple[str, float]:
    said: list[tuple[str, float]] = []
    for share in _VIEWS:
        answer = _engine()(_middle(patch, share / MARGIN), use_det=False, use_cls=False, use_rec=True)
        said += [(t.strip(), float(score)) for t, score in zip(answer.txts or (), answer.scores or (), strict=True)]
    return max((s for s in said if s[0]), key=lambda s: s[1], default=("", 0.0))


def _middle(patch: Image, share: float) -> Image:
    """Return the middle of a square patch, of so much of its side, in colour."""
    edge = round(0.5 * (1.0 - share) * patch.shape[0])
    part = patch[edge : patch.shape[0] - edge, edge : patch.shape[1] - edge]
    return np.ascontiguousarray(part if part.ndim == 3 else np.repeat(part[..., None], 3, axis=2))
