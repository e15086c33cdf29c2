"""Robust statistics of few values, where NumPy's are slow."""

from __future__ import annotations

import numpy as np

from elevator_rectify.core.types import Array


def median(values: Array) -> Array:
    """Return the median over the first axis: of some dozen, sorting is several times as fast as np.median."""
    ordered, half = np.sort(values, axis=0), len(values) // 2
    middle = ordered[half] if len(values) % 2 else (ordered[half - 1] + ordered[half]) * values.dtype.type(0.5)
    return np.asarray(middle)
