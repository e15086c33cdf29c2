"""Which cells of a grid hold a button although none was detected: how panels are usually filled."""

from __future__ import annotations

import numpy as np

from elevator_rectify.core.types import Array, BoolArray

# Of the empty cells of real panels with a tenth of their buttons removed, how many had held one: cells with four and
# three filled neighbours, ends of rows and columns, corners, others.
_FOUR, _THREE, _END, _CORNER, _OTHER = 0.97, 0.92, 0.905, 0.22, 0.2


def present(filled: BoolArray) -> Array:
    """Return the probability (rows, columns) that an empty cell holds a button, 1 for the others.

    filled: (rows, columns) where buttons were detected.
    """
    rows, columns = filled.shape
    padded = np.pad(filled, 1)
    around = np.stack([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]]).sum(axis=0)
    r, c = np.indices(filled.shape)
    edges = (r == 0).astype(int) + (r == rows - 1) + (c == 0) + (c == columns - 1)
    prior = np.full(filled.shape, _OTHER)
    prior[around == 4], prior[(around == 3) & (edges == 0)] = _FOUR, _THREE
    prior[(edges == 1) & (around == 3)] = _END
    prior[edges >= 2] = _CORNER
    return np.where(filled, 1.0, prior)
