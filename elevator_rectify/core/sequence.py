"""Floors follow each other: a hidden Markov model over the cells of a panel, in every usual order of numbering.

A cell holds a floor, something else (a letter, a control), or nothing; floors rise along the order. Forward-backward
(Rabiner 1989) gives the probability of each floor at each cell, averaged over the orders by their evidence.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from elevator_rectify.core.misread import HIGHEST, LOWEST, confusion, looks_like
from elevator_rectify.core.types import Array, BoolArray, IntArray

# How often panels are numbered so, of 401: row by row from below, left to right; by columns; from the right; downwards.
_ORDERS = {
    "rows up": 0.88,
    "columns up": 0.04,
    "rows up from the right": 0.02,
    "columns up from the right": 0.01,
    "rows down": 0.012,
    "columns down": 0.008,
}
# From one row to the next, floors jump by more on few: cut-outs of larger panels, rows of odd or of even floors.
_JUMPS = (2, 3, 4, 5, 6, 7)
_JUMP_SHARE = 0.06
# No order at all: every label for itself.
_NO_ORDER = 0.03
# From one floor to the next: 871, 39, 12 and 12 of 934; 13 is left out on 24 of 34 panels.
_STEPS = np.array([0.0, 0.932, 0.042, 0.013])
_FARTHER, _BACKWARDS = 0.012, 1e-4
_NO_13 = 0.7
# Something else instead of a floor: after a floor, after something else, before the first floor.
_OTHER = (0.04, 0.4, 0.6)
# The lowest number on a panel.
_FIRST = {-1: 0.06, 0: 0.04, 1: 0.4, 2: 0.3, 3: 0.05}
# A label is read right with this probability at score 0 and 1.
_RIGHT = (0.55, 0.93)
_RIGHT_OTHER = (0.9, 0.99)
_LABELS = 40.0
_LOOK_ALIKE = 0.3
# Numbers beyond the read ones that are considered.
_BEYOND = 3
_MOST_STATES = 80
_TINY = 1e-300
# Labels change seldom from frame to frame: so many results are kept, of scores that differ by less than this.
_KEPT, _SCORE_STEP = 16, 0.1


@dataclass(frozen=True)
class Reads:
    """What is known of K cells, row by row.

    label: canonical, '' for unread; score: (K,) of the reading; filled: (K,) whether there is a button; present: (K,)
    the probability that there is one, where none was detected.
    """

    label: tuple[str, ...]
    score: Array
    filled: BoolArray
    present: Array


@dataclass(frozen=True)
class Floors:
    """Probabilities by cell: floor (K, S) of each of `numbers` (S,), other (K,) that it holds something else (or, where
    nothing was detected, nothing); right (K,) that a reading which is no number is right."""

    numbers: IntArray
    floor: Array
    other: Array
    right: Array


def floors_of(reads: Reads, rows: int, columns: int) -> Floors:
    """Return the probabilities of the floors at every cell of a grid."""
    score = np.round(np.nan_to_num(reads.score) / _SCORE_STEP) * _SCORE_STEP
    return _floors(
        reads.label, score.tobytes(), reads.filled.tobytes(), reads.present.round(3).tobytes(), rows, columns
    )


@lru_cache(maxsize=_KEPT)
def _floors(label: tuple[str, ...], score: bytes, filled: bytes, present: bytes, rows: int, columns: int) -> Floors:
    """Return the same, of arrays as bytes, which can be kept."""
    reads = Reads(label, np.frombuffer(score), np.frombuffer(filled, dtype=bool), np.frombuffer(present))
    numbers = _numbers(reads)
    emit, emit_other = _emissions(reads, numbers)
    names = [*_ORDERS, *(["rows up"] * len(_JUMPS) if columns > 1 else [])]
    order = np.array([_order(name, rows, columns) for name in names])
    jumps = np.array([1] * len(_ORDERS) + list(_JUMPS)[: len(names) - len(_ORDERS)])
    prior = np.array([_ORDERS[name] for name in names])
    prior[len(_ORDERS) :] = _JUMP_SHARE / len(_JUMPS)
    changes = np.array(
        [(np.arange(rows * columns) % (rows if n.startswith("columns") else columns)) == 0 for n in names]
    )
    steps = _Steps(numbers, jumps, changes & (jumps > 1)[:, None])
    floor, other, evidence = _forward_backward(emit[order], emit_other[order], reads.filled[order], steps)
    weight = np.append(np.log(prior) + evidence, np.log(_NO_ORDER))
    alone, alone_other, alone_evidence = _each_alone(emit, emit_other, reads.filled)
    weight[-1] += alone_evidence
    weight = np.exp(weight - weight.max())
    weight /= weight.sum()
    total, total_other = weight[-1] * alone, weight[-1] * alone_other
    for w, places, f, o in zip(weight, order, floor, other, strict=False):
        total[places] += w * f
        total_other[places] += w * o
    return Floors(numbers, total, total_other, right_alone("", reads.score))


def right_alone(label: str, score: Array) -> Array:
    """Return the probability that a label, read with these scores, is right, whatever the others are."""
    low, high = _RIGHT if label and _is_number(label) else _RIGHT_OTHER
    return np.asarray(low + (high - low) * np.clip(np.nan_to_num(score), 0.0, 1.0))


def _numbers(reads: Reads) -> IntArray:
    """Return the numbers that are considered: from below the lowest to above the highest that is read."""
    read = sorted(int(label) for label in reads.label if _is_number(label)) or [1]
    low, high = max(LOWEST, min(read[0], 1) - 2), min(HIGHEST, read[-1] + _BEYOND)
    if high - low >= _MOST_STATES:
        # A reading far off all others is an error.
        high = min(high, low + _MOST_STATES)
    return np.arange(low, high + 1)


def _is_number(label: str) -> bool:
    body = label[1:] if label.startswith("-") else label
    return body.isascii() and body.isdigit() and LOWEST <= int(body[:4]) * (-1 if label[0] == "-" else 1) <= HIGHEST


def _emissions(reads: Reads, numbers: IntArray) -> tuple[Array, Array]:
    """Return the probability (K, S) of each cell's reading for every floor, and (K,) for something else."""
    K, at = len(reads.label), numbers - LOWEST
    emit, other = np.ones((K, len(numbers))), np.ones(K)
    emit[~reads.filled] = reads.present[~reads.filled, None]
    other[~reads.filled] = 1.0 - reads.present[~reads.filled]
    right = right_alone("1", reads.score)
    for k, label in enumerate(reads.label):
        if not label or not reads.filled[k]:
            continue
        wrong = 1.0 - right[k]
        if _is_number(label):
            emit[k] = wrong * confusion()[at, int(label) - LOWEST]
            emit[k][numbers == int(label)] = right[k]
            other[k] = wrong / len(confusion())
            continue
        alike = looks_like(label)
        emit[k] = 0.02 * wrong / _LABELS
        if alike and _is_number(alike):
            emit[k][numbers == int(alike)] = _LOOK_ALIKE * wrong
        other[k] = right[k] / _LABELS
    return emit, other


def _order(name: str, rows: int, columns: int) -> IntArray:
    """Return the cells' indices in an order of numbering."""
    index = np.arange(rows * columns).reshape(rows, columns)
    if "up" in name:
        index = index[::-1]
    if "right" in name:
        index = index[:, ::-1]
    return (index.T if name.startswith("columns") else index).ravel()


class _Steps:
    """The probabilities of one floor after another, for several orders; some jump where a new row begins."""

    def __init__(self, numbers: IntArray, jumps: IntArray, changes: BoolArray) -> None:
        """numbers: (S,); jumps: (orders,) usual step to the next row; changes: (orders, K) where one begins."""
        gap = numbers[None, :] - numbers[:, None]
        self.step = _step_table(gap, 1)
        if 12 in numbers and 14 in numbers:
            at = int(np.flatnonzero(numbers == 12)[0])
            self.step[at, at + 1], self.step[at, at + 2] = (1.0 - _NO_13) * 0.96, _NO_13 * 0.96
        self.jump = np.array([_step_table(gap, int(j)) for j in jumps])
        self.changes = changes
        self.first = np.array([_FIRST.get(int(n), 0.0) for n in numbers])
        self.first += (1.0 - self.first.sum()) / len(numbers)

    def after(self, known: Array, k: int) -> Array:
        """Return the probabilities (orders, S) of the floor at place k, given those of the last one."""
        new = known @ self.step
        change = self.changes[:, k]
        if change.any():
            new[change] = (known[change, None] @ self.jump[change])[:, 0]
        return np.asarray(new)

    def before(self, likelihood: Array, k: int) -> Array:
        """Return the likelihoods (orders, S) of the last floor, given those of the floor at place k."""
        old = likelihood @ self.step.T
        change = self.changes[:, k]
        if change.any():
            old[change] = (self.jump[change] @ likelihood[change, :, None])[..., 0]
        return np.asarray(old)


def _step_table(gap: IntArray, usual: int) -> Array:
    """Return the probabilities of steps; the usual one is the likeliest, the others fall off from there."""
    ahead = gap - usual + 1
    step = np.where((ahead > 0) & (ahead < len(_STEPS)), _STEPS[np.clip(ahead, 0, len(_STEPS) - 1)], 0.0)
    far = ahead >= len(_STEPS)
    step += np.where(far, _FARTHER * 0.3 * 0.7 ** np.clip(ahead - len(_STEPS), 0, 60), 0.0)
    return np.asarray(step + np.where(ahead <= 0, _BACKWARDS / len(gap), 0.0))


@dataclass(frozen=True)
class _Chain:
    """The cells in the order of each hypothesis: emissions (orders, K, S) and (orders, K), and the probabilities
    (orders, K, 3) of going on to a floor, or staying with something else, after a floor, something else, or nothing."""

    emit: Array
    emit_other: Array
    go: Array
    stay: Array
    steps: _Steps


def _forward_backward(emit: Array, emit_other: Array, filled: BoolArray, steps: _Steps) -> tuple[Array, Array, Array]:
    """Return the posteriors (orders, K, S) of floors and (orders, K) of others, and the log evidence (orders,).

    The state is the last floor so far, or that there was none, and whether the cell itself holds it.
    """
    # An empty cell does not choose between a floor and something else: its own probability of a button does.
    stay = np.where(filled[..., None], np.array(_OTHER), 1.0)
    go = np.where(filled[..., None], 1.0 - np.array(_OTHER), 1.0)
    chain = _Chain(emit, emit_other, go, stay, steps)
    ahead, ahead_other, evidence = _forward(chain)
    back, back_other = _backward(chain)
    floor, other = ahead * back, (ahead_other * back_other).sum(axis=-1)
    total = floor.sum(axis=-1) + other + _TINY
    return np.moveaxis(floor / total[..., None], 0, 1), (other / total).T, evidence


def _forward(chain: _Chain) -> tuple[Array, Array, Array]:
    """Return the probabilities, given the cells up to each, of floors (K, orders, S) and others (K, orders, S + 1), by
    the last floor (the last one: none so far), and the log evidence (orders,)."""
    orders, K, S = chain.emit.shape
    ahead, ahead_other = np.zeros((K, orders, S)), np.zeros((K, orders, S + 1))
    floor, other, evidence = np.zeros((orders, S)), np.zeros((orders, S + 1)), np.zeros(orders)
    other[:, S] = 1.0
    for k in range(K):
        g, s = chain.go[:, k], chain.stay[:, k]
        known = g[:, :1] * floor + g[:, 1:2] * other[:, :S]
        first = (g[:, 2] * other[:, S])[:, None] * chain.steps.first
        kept = np.column_stack([s[:, :1] * floor + s[:, 1:2] * other[:, :S], s[:, 2] * other[:, S]])
        floor = (chain.steps.after(known, k) + first) * chain.emit[:, k]
        other = kept * chain.emit_other[:, k, None]
        scale = floor.sum(axis=1) + other.sum(axis=1) + _TINY
        evidence += np.log(scale)
        floor, other = floor / scale[:, None], other / scale[:, None]
        ahead[k], ahead_other[k] = floor, other
    return ahead, ahead_other, evidence


def _backward(chain: _Chain) -> tuple[Array, Array]:
    """Return the likelihoods of the cells behind each, given its floor (K, orders, S) or other (K, orders, S + 1)."""
    orders, K, S = chain.emit.shape
    back, back_other = np.ones((K, orders, S)), np.ones((K, orders, S + 1))
    for k in range(K - 1, 0, -1):
        g, s = chain.go[:, k], chain.stay[:, k]
        floor, other = back[k] * chain.emit[:, k], back_other[k] * chain.emit_other[:, k, None]
        following, first = chain.steps.before(floor, k), floor @ chain.steps.first
        back[k - 1] = g[:, :1] * following + s[:, :1] * other[:, :S]
        back_other[k - 1, :, :S] = g[:, 1:2] * following + s[:, 1:2] * other[:, :S]
        back_other[k - 1, :, S] = g[:, 2] * first + s[:, 2] * other[:, S]
        scale = np.maximum(back[k - 1].max(axis=1), back_other[k - 1].max(axis=1))[:, None] + _TINY
        back[k - 1] /= scale
        back_other[k - 1] /= scale
    return back, back_other


def _each_alone(emit: Array, emit_other: Array, filled: BoolArray) -> tuple[Array, Array, float]:
    """Return the same for cells that say nothing of each other: floors and others are as frequent as on panels."""
    share = np.where(filled, 0.7, 1.0)[:, None] / emit.shape[1]
    floor, other = share * emit, np.where(filled, 0.3, 1.0) * emit_other
    total = floor.sum(axis=1) + other
    return floor / total[:, None], other / total, float(np.log(total).sum())
