"""In which order a panel's floors may be numbered: by rows (there, or there and back), columns or diagonals, and how
far they jump between."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from elevator_rectify.core.reading.places import PanelPlaces
from elevator_rectify.core.types import Array, BoolArray, IntArray

# How often panels are numbered so, of 401: row by row from below, left to right; by columns; from the right; downwards.
# The signs: of the lines, and along each; the first line is the upper or left one.
_BY_ROWS = {(-1, 1): 0.88, (-1, -1): 0.02, (1, 1): 0.012}
_BY_COLUMNS = {(1, -1): 0.04, (-1, -1): 0.01, (1, 1): 0.008}
# Row by row, every second one from the right.
_THERE_AND_BACK = 0.003
# Along diagonals, on brick layouts only.
_BY_DIAGONALS = 0.005
# From one line to the next, floors jump on few: cut-outs of larger panels, decades, rows of odd or of even floors.
_JUMP_SHARE = 0.06
_FARTHEST_JUMP = 20
# Log likelihood that two readings gain which are as far apart as their places in the order.
_PAIR_NATS = 2.5
# So many pairs that all agree with the usual order leave no other.
_SURE_PAIRS = 4
_FOLLOWED, _HOPELESS_NATS = 3, 12.0


@dataclass(frozen=True)
class Order:
    """Places in the order of their floors: index (K,); starts (K,) True where a new line begins; jump: the usual step
    from one line to the next; prior: how usual it is."""

    index: IntArray
    starts: BoolArray
    jump: int
    prior: float


def likely_orders(places: PanelPlaces, number: Array) -> list[Order]:
    """Return the orders that the readings support most; number (K,): as read, NaN for none."""
    found: list[tuple[Order, float]] = []
    for order in _orders(places):
        further, lines = _pairs(order, number, places.filled)
        if not found and len(further) >= _SURE_PAIRS and not further.any():
            return [order]
        found += _supported(order, further, lines)
    found.sort(key=lambda supported: -supported[1])
    return [order for order, support in found[:_FOLLOWED] if support > found[0][1] - _HOPELESS_NATS]


def _orders(places: PanelPlaces) -> Iterator[Order]:
    """Yield the orders, the most usual one first."""
    (row, column), (down, along) = places.line.T, places.at.T
    for (a, b), prior in _BY_ROWS.items():
        yield _sorted(a * row, b * along, prior)
    for (a, b), prior in _BY_COLUMNS.items():
        yield _sorted(a * column, b * down, prior)
    second = np.unique(row, return_inverse=True)[1] % 2 == 1
    for turned in (second, ~second):
        yield _sorted(-row, np.where(turned, -along, along), _THERE_AND_BACK)
    cells = along[: places.cells] % 1.0
    if cells.any() and not cells.all():
        for lean in (-0.5, 0.5):
            for a, b in product((-1, 1), (-1, 1)):
                yield _sorted(a * (along + lean * down), b * row, _BY_DIAGONALS)


def _sorted(line: Array, along: Array, prior: float) -> Order:
    index = np.lexsort((along, line))
    starts = np.ones(len(index), dtype=bool)
    starts[1:] = line[index[1:]] != line[index[:-1]]
    return Order(index, starts, 1, prior)


def _supported(order: Order, further: Array, lines: Array) -> list[tuple[Order, float]]:
    """Return the order as it is, and with the jumps between its lines that several pairs of readings show, each with
    its log prior and support; further, lines (P,): of the pairs."""
    jumps = Counter((further[lines > 0] / lines[lines > 0]).tolist()).most_common(2)
    often = [int(j) for j, count in jumps if count > 1 and 0 < j < _FARTHEST_JUMP and j == int(j)]
    share = order.prior * _JUMP_SHARE / max(1, len(often))
    orders = [order, *(Order(order.index, order.starts, 1 + j, share) for j in often)]
    return [(o, math.log(o.prior) + _PAIR_NATS * _agreeing(further - lines * (o.jump - 1))) for o in orders]


def _pairs(order: Order, number: Array, filled: BoolArray) -> tuple[Array, Array]:
    """Return of successive readings (P,) how much further apart they are than their places, and (P,) the new lines
    between them."""
    kept = filled[order.index]
    read = number[order.index][kept]
    at = np.flatnonzero(np.isfinite(read))
    read, line = read[at], np.cumsum(order.starts)[kept][at]
    return read[1:] - read[:-1] - at[1:] + at[:-1], line[1:] - line[:-1]


def _agreeing(further: Array) -> float:
    """Return how many pairs of readings are as far apart as their places; those one further count half."""
    return float(np.count_nonzero(further == 0) + 0.5 * np.count_nonzero(further == 1))
