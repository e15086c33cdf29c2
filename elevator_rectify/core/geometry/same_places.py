"""The same labelled places on a panel in two frames, whose lattices may begin at another row or column."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from elevator_rectify.core.types import Array, FitResult, IntArray

# Places of two frames are the same within so many pitches; so large a share of the panel must be the same.
_SAME_PITCH, _SAME_SHARE = 0.3, 0.6
# A panel that moved by more than this share of a pitch may be seen from another row or column on.
_STAYED = 0.5
# Shifts that differ by less, in pitches, pair the same places.
_SAME_SHIFT = 0.1


class Labelled(Protocol):
    """Places (K, 2) on a panel in column pitches, with their labels, '' where unknown."""

    @property
    def places(self) -> Array:
        """Return the places (K, 2)."""

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the labels (K,)."""


def same_places(before: Labelled, now: Labelled) -> IntArray:
    """Return pairs (P, 2) of indices of the same places; none where it is not surely the same panel.

    The lattice may have another origin in another frame: the shift is the one that makes most places and labels agree.
    """
    none = np.zeros((0, 2), dtype=np.int64)
    if not len(before.places) or not len(now.places):
        return none
    pairs = max(
        (_pairs(before, now, shift) for shift in _shifts(before, now)), key=lambda p: _agreement(before, now, p)
    )
    enough = len(pairs) >= _SAME_SHARE * min(len(before.places), len(now.places))
    return pairs if enough and _agreement(before, now, pairs) > 0 else none


def _shifts(before: Labelled, now: Labelled) -> list[Array]:
    """Return the shifts (2,) that bring equal labels together, of much the same ones the first; none is the first."""
    shifts = {(0.0, 0.0): np.zeros(2)}
    for i, label in enumerate(before.labels):
        for j, other in enumerate(now.labels):
            if label and other == label:
                shift = now.places[j] - before.places[i]
                y, x = np.round(shift / _SAME_SHIFT)
                shifts.setdefault((float(y), float(x)), shift)
    return list(shifts.values())


def _pairs(before: Labelled, now: Labelled, shift: Array) -> IntArray:
    apart = np.linalg.norm(before.places[:, None] + shift - now.places[None], axis=-1)
    return mutually_nearest(apart, _SAME_PITCH)


def mutually_nearest(apart: Array, within: float) -> IntArray:
    """Return pairs (P, 2) of a row and a column of distances (M, N), M and N not 0, each the other's least, below a
    limit."""
    nearest = apart.argmin(axis=1)
    row = np.arange(len(nearest))
    kept = np.flatnonzero((apart.argmin(axis=0)[nearest] == row) & (apart[row, nearest] < within))
    return np.column_stack([kept, nearest[kept]])


def _agreement(before: Labelled, now: Labelled, pairs: IntArray) -> int:
    """Count places that agree, and labels, for and against."""
    labels = [(before.labels[i], now.labels[j]) for i, j in pairs]
    return len(pairs) + sum(2 if a == b else -2 for a, b in labels if a and b)


def stayed(fit: FitResult, last: FitResult) -> bool:
    """Tell whether two accepted fits show the same cells of the same panel, one just after the other."""
    if not (fit.ok and last.ok) or fit.metric != last.metric or (fit.rows, fit.columns) != (last.rows, last.columns):
        return False
    moved = float(np.linalg.norm(fit.t_camera_panel - last.t_camera_panel))
    return moved < _STAYED * float(fit.pitch.min())
