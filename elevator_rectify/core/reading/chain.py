"""Floors follow each other: a hidden Markov model over the places of a panel, in several orders at once.

A place holds a floor, something else (a letter, a control), or nothing; floors rise along the order. The state is the
last floor so far, or that there was none. Forward-backward (Rabiner 1989) gives the probability of each floor at each
place, and the evidence for the order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from elevator_rectify.core.reading.orders import Order
from elevator_rectify.core.types import Array, BoolArray, IntArray

# From one floor to the next: 871, 39, 12 and 12 of 934; 13 is left out on 24 of 34 panels.
_STEPS = np.array([0.0, 0.932, 0.042, 0.013])
_FARTHER, _FALLOFF, _BACKWARDS = 0.012, 0.7, 1e-3
_NO_13 = 0.7
# A button that is no floor: after the first floor, and before it.
OTHER, OTHER_BEFORE = 0.08, 0.6
# The lowest number on a panel.
_FIRST = {-1: 0.06, 0: 0.04, 1: 0.4, 2: 0.3, 3: 0.05}
# Places after which probabilities are scaled, so that none is lost.
_SCALED = 4
_TINY = 1e-300


@dataclass(frozen=True)
class Emissions:
    """What the readings say of K places: floor (..., K, S) likelihood of each floor, other (..., K) of something else,
    or nothing where none was detected; filled (..., K) whether there is a button."""

    floor: Array
    other: Array
    filled: BoolArray


@dataclass(frozen=True)
class Posterior:
    """By hypothesis: floor (H, K, S) and other (H, K), probabilities; evidence (H,) log likelihood."""

    floor: Array
    other: Array
    evidence: Array


@lru_cache(maxsize=64)
def step_table(low: int, high: int, jump: int = 1) -> Array:
    """Return the probabilities (S + 1, S) of the next floor after each of S floors, low to high, and after none.

    jump: the usual step; others fall off from there.
    """
    numbers = np.arange(low, high + 1)
    ahead = numbers[None, :] - numbers[:, None] - jump + 1
    step = np.where(ahead > 0, _STEPS[np.clip(ahead, 0, len(_STEPS) - 1)], _BACKWARDS / len(numbers))
    beyond = np.clip(ahead - len(_STEPS), 0, 60)
    step = np.where(ahead < len(_STEPS), step, _FARTHER * (1.0 - _FALLOFF) * _FALLOFF**beyond)
    if jump == 1 and {12, 14} <= set(numbers.tolist()):
        at = int(np.flatnonzero(numbers == 12)[0])
        step[at, at + 1], step[at, at + 2] = (1.0 - _NO_13) * 0.96, _NO_13 * 0.96
    first = np.array([_FIRST.get(int(n), 0.0) for n in numbers])
    return np.vstack([step, first + (1.0 - first.sum()) / len(numbers)])


class _Moves:
    """From state to state: the probabilities of going on to a floor, by order, and where an order starts a new line."""

    def __init__(self, numbers: IntArray, orders: Sequence[Order]) -> None:
        low, high = int(numbers[0]), int(numbers[-1])
        self.usual = step_table(low, high)
        jumping = [(h, order) for h, order in enumerate(orders) if order.jump > 1]
        tables = {order.jump: step_table(low, high, order.jump) for _, order in jumping}
        self.special: dict[int, list[tuple[int, Array]]] = {}
        for h, order in jumping:
            for k in np.flatnonzero(order.starts).tolist():
                self.special.setdefault(k, []).append((h, tables[order.jump]))

    def on(self, last: Array, k: int) -> Array:
        """Return (H, S) from (H, S + 1): the floors at place k, given the last ones."""
        new = last @ self.usual
        for h, table in self.special.get(k, ()):
            new[h] = last[h] @ table
        return np.asarray(new)

    def back(self, floor: Array, k: int) -> Array:
        """Return (H, S + 1) from (H, S): the likelihoods of the last floors, given those of the floors at place k."""
        old = floor @ self.usual.T
        for h, table in self.special.get(k, ()):
            old[h] = table @ floor[h]
        return np.asarray(old)


def forward_backward(given: Emissions, numbers: IntArray, orders: Sequence[Order]) -> Posterior:
    """Return the posteriors of H hypotheses: the emissions (H, K, ...) are in the order of each."""
    moves = _Moves(numbers, orders)
    go, stay = _shares(given)
    emit = np.ascontiguousarray(np.swapaxes(given.floor, 0, 1))
    scale = np.maximum(emit.max(axis=2), stay.max(axis=2)) + _TINY
    emit, stay = emit / scale[..., None], stay / scale[..., None]
    came, before, evidence = _forward(emit, go, stay, moves)
    floor, other = _backward(came, before, emit, go, stay, moves)
    total = floor.sum(axis=2) + other + _TINY
    return Posterior(
        np.swapaxes(floor / total[..., None], 0, 1), (other / total).T, evidence + np.log(scale).sum(axis=0)
    )


def _shares(given: Emissions) -> tuple[Array, Array]:
    """Return (K, H, S + 1) the shares of going on to a floor, and of staying with something else as it is read."""
    filled = given.filled.T[..., None]
    states = np.append(np.full(given.floor.shape[-1], OTHER), OTHER_BEFORE)
    # An empty cell does not choose between a floor and something else: its own probability of a button does.
    return np.where(filled, 1.0 - states, 1.0), np.where(filled, states, 1.0) * given.other.T[..., None]


def _forward(emit: Array, go: Array, stay: Array, moves: _Moves) -> tuple[Array, Array, Array]:
    """Return what comes to the floors of each place (K, H, S), the states before it (K, H, S + 1), and the evidence."""
    K, H, S = emit.shape
    came, before, evidence = np.empty((K, H, S)), np.empty((K, H, S + 1)), np.zeros(H)
    last = np.zeros((H, S + 1))
    last[:, S] = 1.0
    for k in range(K):
        before[k] = last
        np.multiply(moves.on(last * go[k], k), emit[k], out=came[k])
        last = last * stay[k]
        last[:, :S] += came[k]
        if k % _SCALED == 0 or k == K - 1:
            scale = last.sum(axis=1) + _TINY
            last = last / scale[:, None]
            evidence += np.log(scale)
    return came, before, evidence


def _backward(came: Array, before: Array, emit: Array, go: Array, stay: Array, moves: _Moves) -> tuple[Array, Array]:
    """Return, up to a factor by place and hypothesis, the probabilities of floors (K, H, S) and others (K, H)."""
    K, H, S = emit.shape
    floor, other, behind = np.empty((K, H, S)), np.empty((K, H)), np.ones((H, S + 1))
    for k in range(K - 1, -1, -1):
        kept = stay[k] * behind
        np.multiply(came[k], behind[:, :S], out=floor[k])
        other[k] = np.einsum("hs,hs->h", before[k], kept)
        behind = moves.back(behind[:, :S] * emit[k], k) * go[k] + kept
        if k % _SCALED == 0:
            behind = behind / (behind.max(axis=1) + _TINY)[:, None]
    return floor, other
