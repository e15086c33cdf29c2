"""Which empty cells hold a button that was missed: how real panels are filled, and what their labels lack."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np

from elevator_rectify.core.reading.misread import is_number
from elevator_rectify.core.reading.places import PanelPlaces
from elevator_rectify.core.types import Array, BoolArray, FitResult, IntArray

# Written by `python3 -m elevator_rectify calibrate --buttons`.
COEFFICIENTS = Path(__file__).with_name("filled.json")
# Cells are among the rows of floors, below or above them, or on panels without numbers.
_ZONES = ("floors", "below", "above", "unread")
_FLOORS, _BELOW, _ABOVE, _UNREAD = range(4)
# Of the four neighbours so many hold a button; the fewer can be at the grid's edge or corner.
_AROUND = ("four", "three inside", "three", "two at a corner", "two", "fewer")
FEATURES = (
    *(f"{zone}, {around}" for zone in _ZONES for around in _AROUND),
    "a floor is missing",
    "no floor is missing",
    "no floor is missing, among floors",
    "mirror cell",
    "mirror cell, among floors",
    "like the next row",
    "staggered",
    "empty column",
    "empty row",
    "beside close, no open",
    "beside open, no close",
    "in the row of stop, no alarm",
    "in the row of alarm, no stop",
    "first row",
    "last row",
    "first row, of floors",
    "last row, of floors",
    "last row, below",
    "full rows",
    "two columns",
    "three columns",
    "filled share",
    "unread neighbours",
)
# Evidence of the floors' order counts up to so many nats.
_NATS = 5.0


def missed(fit: FitResult, places: PanelPlaces, floor_nats: Array) -> Array:
    """Return the probability (R C,) that each cell holds a button: 1 where there is a detection, or the picture shows
    one, and of the others as panels are made.

    floor_nats (R C,): log odds that the floors' order gives for a floor there, 0 where it says nothing.
    """
    probability, empty = np.ones(places.cells), np.flatnonzero(~places.filled[: places.cells])
    if len(empty):
        terms = features(fit, places, floor_nats, empty) @ _model()[1:] + _model()[0]
        probability[empty] = 1.0 / (1.0 + np.exp(-np.clip(terms, -30.0, 30.0)))
    return probability


@cache
def _model() -> Array:
    """Return the constant and the features' coefficients."""
    table = json.loads(COEFFICIENTS.read_text())
    return np.array([table["constant"], *(table["coefficients"][name] for name in FEATURES)])


def features(fit: FitResult, places: PanelPlaces, floor_nats: Array, empty: IntArray) -> Array:
    """Return (E, F) what `missed` is computed from, in the order of FEATURES, of the cells `empty` (E,)."""
    filled = places.filled[: places.cells].reshape(fit.rows, fit.columns)
    label = np.array(places.label[: places.cells], dtype=object).reshape(filled.shape)
    row, column = np.divmod(empty, fit.columns)
    zone, around = _zone(label)[row], _around(filled, row, column)
    among, below = zone == _FLOORS, zone == _BELOW
    nats, mirror = np.clip(floor_nats[empty], -_NATS, _NATS), _mirror(filled, fit.row_staggered, row, column)
    first, last, full = row == 0, row == fit.rows - 1, np.asarray(filled.all(axis=1))
    one = np.ones(len(empty))
    columns: list[Array | BoolArray | IntArray] = [
        np.eye(len(_ZONES) * len(_AROUND))[zone * len(_AROUND) + around],
        np.maximum(nats, 0.0),
        np.minimum(nats, 0.0),
        np.minimum(nats, 0.0) * among,
        mirror,
        mirror * among,
        _like_next(filled)[row],
        fit.row_staggered[row],
        ~np.asarray(filled.any(axis=0))[column],
        ~np.asarray(filled.any(axis=1))[row],
        *_lacking(label, row, column),
        first,
        last,
        first & among,
        last & among,
        last & below,
        (full.sum() - full[row]) / max(1, fit.rows - 1),
        one * (fit.columns == 2),
        one * (fit.columns == 3),
        one * filled.mean(),
        _sum_around(filled & (label == ""), row, column),
    ]
    return np.column_stack(columns).astype(float)


def _zone(label: Array) -> IntArray:
    """Return (R,) in which of _ZONES each row is."""
    floors = np.flatnonzero([any(is_number(text) for text in row) for row in label])
    row = np.arange(len(label))
    if not len(floors):
        return np.full(len(label), _UNREAD)
    return np.where(row < floors[0], _ABOVE, np.where(row > floors[-1], _BELOW, _FLOORS))


def _around(filled: BoolArray, row: IntArray, column: IntArray) -> IntArray:
    """Return (E,) which of _AROUND the cells' neighbours are."""
    number = _sum_around(filled, row, column)
    outside = 4 - _sum_around(np.ones_like(filled), row, column)
    return np.select(
        [number == 4, (number == 3) & (outside == 0), number == 3, (number == 2) & (outside >= 2), number == 2],
        range(len(_AROUND) - 1),
        len(_AROUND) - 1,
    )


def _sum_around(filled: BoolArray, row: IntArray, column: IntArray) -> IntArray:
    """Return (E,) how many of the four neighbours of each cell are filled."""
    padded = np.zeros((filled.shape[0] + 2, filled.shape[1] + 2), dtype=np.int64)
    padded[1:-1, 1:-1] = filled
    r, c = row + 1, column + 1
    return np.asarray(padded[r - 1, c] + padded[r + 1, c] + padded[r, c - 1] + padded[r, c + 1])


def _mirror(filled: BoolArray, staggered: BoolArray, row: IntArray, column: IntArray) -> Array:
    """Return (E,) 1 where the cell on the other side of the panel's middle is filled, -1 where it is empty, 0 where it
    is the cell itself or outside."""
    other = filled.shape[1] - 1 - column - staggered[row]
    value = np.where(filled[row, np.maximum(other, 0)], 1.0, -1.0)
    return np.where((other < 0) | (other == column), 0.0, value)


def _like_next(filled: BoolArray) -> BoolArray:
    """Return (R,) True where the row above or below is filled in the same columns."""
    same = np.zeros(len(filled), dtype=bool)
    equal = (filled[1:] == filled[:-1]).all(axis=1)
    same[1:] |= equal
    same[:-1] |= equal
    return same


def _lacking(label: Array, row: IntArray, column: IntArray) -> list[BoolArray]:
    """Return (E,) four times: the cell may hold the control that the panel lacks, by the one beside or opposite."""
    lists = label.tolist()
    has = {name: any(name in line for line in lists) for name in ("open", "close", "alarm", "stop")}
    last, cells = len(lists[0]) - 1, list(zip(row.tolist(), column.tolist(), strict=True))
    found = [
        [not has["open"] and "close" in (lists[r][last - c], *lists[r][c + 1 : c + 2]) for r, c in cells],
        [not has["close"] and "open" in (lists[r][last - c], *lists[r][c - 1 : c]) for r, c in cells],
        [not has["alarm"] and "stop" in lists[r] for r, _ in cells],
        [not has["stop"] and "alarm" in lists[r] for r, _ in cells],
    ]
    return [np.array(lacking) for lacking in found]
