"""The cells of a fitted grid, row by row: what was detected and read there, and what the whole panel says of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elevator_rectify.core.filled import present
from elevator_rectify.core.labels import canonical
from elevator_rectify.core.sequence import Floors, Reads, floors_of, right_alone
from elevator_rectify.core.types import Array, BoolArray, GridFit, IntArray

# With fewer numbers read, a panel's order says nothing.
_FEWEST_NUMBERS = 3
# An empty cell where the picture was searched and showed nothing holds a button with the prior's odds over this.
_NOT_SHOWN = 30.0
# A button shown by the picture alone is one with this probability.
_SHOWN = 0.99
# Beyond the end of a staggered line there is no cell.
_NO_CELL = 0.01
_MOST_CELLS = 400
# Readers misread no more than this share of the floors.
_MISREAD_SHARE = 0.22
_CONTROLS = 0.8


@dataclass(frozen=True)
class Cells:
    """K = rows x columns cells: detection (K,) that stands for each, -1 for none; label and reading (K,); score (K,);
    present (K,) the probability of a button; floors, None where the labels have no order."""

    detection: IntArray
    label: tuple[str, ...]
    read: tuple[str, ...]
    score: Array
    present: Array
    floors: Floors | None


def cells_of(fit: GridFit) -> Cells:
    """Return the cells of a fit that has a grid."""
    number = fit.rows * fit.columns
    detection, label, read, score = _readings(fit, number)
    shown = np.zeros(number, dtype=bool)
    if fit.measurement is not None:
        shown = np.isfinite(fit.measurement.correlation).ravel()
    filled = (detection >= 0) | shown
    prior = present(filled.reshape(fit.rows, fit.columns))
    prior[~filled.reshape(prior.shape) & _beyond(fit)] = _NO_CELL
    prior = prior.ravel()
    if fit.measurement is not None:
        odds = prior / np.maximum(1.0 - prior, 1e-9) / _NOT_SHOWN
        prior = np.where(filled, prior, odds / (1.0 + odds))
    prior = np.where(shown & (detection < 0), _SHOWN, prior)
    reads = Reads(label, score, filled, prior)
    if sum(text.lstrip("-").isdigit() for text in label) < _FEWEST_NUMBERS or number > _MOST_CELLS:
        # Rows of controls have gaps in their middle more often than rows of floors.
        prior = np.where(filled, prior, prior * (_CONTROLS if any(label) else 1.0))
        return Cells(detection, label, read, score, prior, None)
    floors = floors_of(reads, fit.rows, fit.columns)
    if _contradicted(label, floors):
        return Cells(detection, label, read, score, prior, None)
    return Cells(detection, label, read, score, np.where(filled, prior, floors.floor.sum(axis=1)), floors)


def _contradicted(label: tuple[str, ...], floors: Floors) -> bool:
    """Tell whether the floors' order contradicts more of the readings than a reader misreads: then there is none."""
    place = {str(n): k for k, n in enumerate(floors.numbers)}
    numbers = [k for k, text in enumerate(label) if text.lstrip("-").isdigit()]
    right = [float(floors.floor[k, place[label[k]]]) if label[k] in place else 0.0 for k in numbers]
    return 1.0 - float(np.mean(right)) > _MISREAD_SHARE + 1.0 / len(numbers)


def _readings(fit: GridFit, number: int) -> tuple[IntArray, tuple[str, ...], tuple[str, ...], Array]:
    """Return for each cell the detection that stands for it: the best-scored one that has a label, if any has."""
    detection, score = np.full(number, -1, dtype=np.int64), np.zeros(number)
    label, read = [""] * number, [""] * number
    ranks: dict[int, tuple[bool, float, int]] = {}
    for k in np.flatnonzero(fit.cells[:, 0] >= 0).tolist():
        cell = int(fit.cells[k, 0] * fit.columns + fit.cells[k, 1])
        given = fit.detections[k] if fit.detections else None
        name = canonical(given.label) if given is not None else ""
        value = float(np.nan_to_num(given.score, nan=0.0)) if given is not None else 1.0
        rank = (bool(name), value, -k)
        if cell not in ranks or rank > ranks[cell]:
            ranks[cell] = rank
            detection[cell], score[cell], label[cell] = k, value, name
            read[cell] = given.label if given is not None else ""
    return detection, tuple(label), tuple(read), score


def _beyond(fit: GridFit) -> BoolArray:
    """Return (rows, columns) True for the last cells of staggered lines: half a pitch outside of the box."""
    last = np.zeros((fit.rows, fit.columns), dtype=bool)
    if fit.row_staggered.any() and not fit.row_staggered.all():
        last[fit.row_staggered, -1] = True
    if fit.column_staggered.any() and not fit.column_staggered.all():
        last[-1, fit.column_staggered] = True
    return last


def probability_of(cells: Cells, name: str) -> Array:
    """Return (K,) the probability that each cell's button is labelled `name`."""
    floors, read = cells.floors, np.array([label == name for label in cells.label])
    if floors is None:
        return np.where(read, right_alone(name, cells.score), 0.0)
    matches = np.array([str(n) == name for n in floors.numbers])
    if matches.any():
        return np.asarray(floors.floor[:, matches][:, 0])
    return np.where(read, floors.other * floors.right, 0.0)
