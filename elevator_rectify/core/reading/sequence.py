"""What a panel's labels say of each other: the probability of every floor at every place, over all likely orders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elevator_rectify.core.reading.chain import Emissions, Posterior, forward_backward
from elevator_rectify.core.reading.misread import HIGHEST, LOWEST, emissions_of, is_number, reader_qualities
from elevator_rectify.core.reading.orders import likely_orders
from elevator_rectify.core.reading.places import PanelPlaces
from elevator_rectify.core.types import Array, IntArray

# No order at all: every label for itself; floors and others are as frequent as on panels.
_NO_ORDER = 0.05
_FLOOR_SHARE = 0.7
# Numbers beyond the read and the unread ones that are considered; a reading further off the others is an error.
_BEYOND, _BELOW = 3, 10
_FARTHEST, _FARTHEST_SHARE = 10, 1.5


@dataclass(frozen=True)
class Floors:
    """Probabilities by place: floor (K, S) of each of `numbers` (S,), other (K,) that it holds something else (or,
    where nothing was detected, nothing)."""

    numbers: IntArray
    floor: Array
    other: Array


def floors_of(places: PanelPlaces, present: Array) -> Floors:
    """Return the probabilities of the floors; present (K,): that there is a button, 1 where one was detected.

    The reader may have been better or worse, and its scores may mean something or not: hypotheses, as the orders are.
    """
    number, numbers = _numbers(places)
    orders = likely_orders(places, number)
    read = Emissions(*emissions_of(places, present, reader_qualities(places.score), numbers), places.filled)
    readers, index = len(read.floor), np.array([order.index for order in orders])
    found = forward_backward(_in_order(read, index), numbers, orders * readers)
    alone = _each_alone(read)
    usual = [*[order.prior for order in orders] * readers, *[_NO_ORDER] * readers]
    weight = _normalised(np.log(usual) + np.append(found.evidence, alone.evidence))
    # Back from each order's own sequence to the places.
    every, back = np.arange(len(found.floor))[:, None], np.tile(np.argsort(index, axis=1), (readers, 1))
    floors = np.concatenate([found.floor[every, back], alone.floor])
    others = np.concatenate([found.other[every, back], alone.other])
    return Floors(numbers, np.einsum("h,hks->ks", weight, floors), weight @ others)


def _in_order(read: Emissions, index: IntArray) -> Emissions:
    """Return the emissions (Q, K) of each reader in every order (H, K), as (Q H, K) hypotheses."""
    shape = (len(read.floor) * len(index), index.shape[1])
    return Emissions(
        read.floor[:, index].reshape(*shape, read.floor.shape[-1]),
        read.other[:, index].reshape(shape),
        np.tile(read.filled[index], (len(read.floor), 1)),
    )


def _numbers(places: PanelPlaces) -> tuple[Array, IntArray]:
    """Return the numbers (K,) as read, NaN for none, and those (S,) that are considered, without a gap."""
    number = np.array([float(text) if is_number(text) else np.nan for text in places.label])
    unread = sum(not text for text, filled in zip(places.label, places.filled, strict=True) if filled)
    considered = _considered(number, unread)
    number[(number < considered[0]) | (number > considered[-1])] = np.nan
    return number, considered


def _considered(number: Array, unread: int) -> IntArray:
    """Return the numbers that are considered: from below the lowest to above the highest that is read."""
    read = np.sort(number[np.isfinite(number)])
    if not len(read):
        return np.arange(-1, unread + _BEYOND)
    middle = read[(len(read) - 1) // 2]
    near = read[np.abs(read - middle) <= _FARTHEST + _FARTHEST_SHARE * len(number)].astype(int)
    low, high = min(near[0], 1) - 2, near[-1] + _BEYOND + unread
    # Panels of high floors only are parts of larger ones.
    low = near[0] - _BELOW - unread if near[0] > _BELOW + len(number) else low
    return np.arange(max(LOWEST, low), min(HIGHEST, high) + 1)


def _each_alone(given: Emissions) -> Posterior:
    """Return the same of places that say nothing of each other, by each reader."""
    share = np.where(given.filled, _FLOOR_SHARE, 1.0) / given.floor.shape[-1]
    floor, other = share[:, None] * given.floor, np.where(given.filled, 1.0 - _FLOOR_SHARE, 1.0) * given.other
    total = floor.sum(axis=-1) + other
    return Posterior(floor / total[..., None], other / total, np.log(total).sum(axis=-1))


def _normalised(log_weight: Array) -> Array:
    weight = np.exp(log_weight - log_weight.max())
    return np.asarray(weight / weight.sum())
