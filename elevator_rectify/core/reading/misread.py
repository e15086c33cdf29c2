"""How printed labels are read and misread: what a reading says of the floor that is printed there."""

from __future__ import annotations

from functools import cache, lru_cache

import numpy as np

from elevator_rectify.core.reading.places import PanelPlaces
from elevator_rectify.core.types import Array, IntArray

LOWEST, HIGHEST = -9, 130
# Pairs of digits that look alike, and how much likelier they are exchanged than others.
_ALIKE = {"17": 4, "38": 4, "56": 3, "68": 4, "08": 3, "06": 2, "35": 2, "89": 2, "14": 2, "27": 2, "49": 2, "39": 2}
_LETTERS = str.maketrans({"I": "1", "L": "1", "|": "1", "O": "0", "Q": "0", "S": "5", "Z": "2", "B": "8", "G": "6"})
# Shares of the errors: one digit exchanged, one lost, one too many, anything else.
_EXCHANGED, _LOST, _ADDED, _ANYTHING = 0.7, 0.12, 0.08, 0.1
# A label is right with this probability where scores say nothing, or at the score's bounds where they do.
_RIGHT, _LEAST_RIGHT, _MOST_RIGHT = 0.9, 0.05, 0.97
# Of letters and controls, at score 0 and 1: there are so many of them, and they are seldom taken for numbers.
_RIGHT_OTHER = (0.92, 0.99)
# Of a label that has its own probability what is left is that the printer, or the annotator, erred.
_READ_RIGHT = 0.99
# What says that nothing can be read says so of every label alike: the reader expects a label about so much more seldom.
_UNREAD = 0.005
_LABELS, _OTHER_AS_NUMBER, _LOOK_ALIKE = 40.0, 0.002, 0.3
_FLOOR_AS_OTHER = 0.02


def looks_like(text: str) -> str:
    """Return the digits that a text looks like ('I2' is '12'), '' where it looks like no number."""
    digits = text.translate(_LETTERS)
    return digits if digits.isdigit() and any(c.isdigit() for c in text) else ""


@cache
def confusion() -> Array:
    """Return (numbers, numbers) the probability of a number (first axis) being read as another, where it is misread.

    Both axes count from LOWEST to HIGHEST.
    """
    names = [str(n) for n in range(LOWEST, HIGHEST + 1)]
    index = {name: k for k, name in enumerate(names)}
    table = np.full((len(names), len(names)), _ANYTHING / len(names))
    for k, name in enumerate(names):
        digits = name.lstrip("-")
        sign = name[: len(name) - len(digits)]
        exchanged = {
            sign + digits[:at] + d + digits[at + 1 :]: _likeness(digits[at], d)
            for at in range(len(digits))
            for d in "0123456789"
            if d != digits[at]
        }
        lost = {sign + digits[:at] + digits[at + 1 :]: 1.0 for at in range(len(digits)) if len(digits) > 1}
        added = {sign + digits[:at] + d + digits[at:]: 1.0 for at in range(len(digits) + 1) for d in "0123456789"}
        for share, reads in ((_EXCHANGED, exchanged), (_LOST, lost), (_ADDED, added)):
            known = {index[read]: weight for read, weight in reads.items() if read in index and read != name}
            for place, weight in known.items():
                table[k, place] += share * weight / sum(known.values())
    np.fill_diagonal(table, 0.0)
    return np.asarray(table / table.sum(axis=1, keepdims=True))


def _likeness(one: str, other: str) -> float:
    return float(_ALIKE.get(min(one, other) + max(one, other), 1))


@lru_cache(maxsize=1024)
def is_number(label: str) -> bool:
    """Tell whether a label is the number of a floor that buildings have."""
    body = label.removeprefix("-")
    return body.isascii() and body.isdigit() and len(body) < 4 and LOWEST <= int(label) <= HIGHEST


def reader_qualities(score: Array) -> Array:
    """Return (Q, K) how probably each label is right, by hypothesis: whatever its score is, or just by that."""
    return np.array([np.full(len(score), _RIGHT), np.clip(score, _LEAST_RIGHT, _MOST_RIGHT)])


def right_alone(label: str, score: Array) -> Array:
    """Return the probability that a label, read with these scores, is right, whatever the others are."""
    low, high = (0.55, 0.93) if label and is_number(label) else _RIGHT_OTHER
    return np.asarray(low + (high - low) * np.clip(np.nan_to_num(score), 0.0, 1.0))


def emissions_of(places: PanelPlaces, present: Array, right: Array, numbers: IntArray) -> tuple[Array, Array]:
    """Return the likelihoods (Q, K, S) of each place's reading for every floor, and (Q, K) for something else.

    present (K,), right (Q, K): the probabilities that there is a button, and that it is read right, by Q hypotheses.
    """
    filled = places.filled
    floor = np.repeat(np.where(filled, 1.0, present)[:, None], len(numbers), axis=1) * np.ones((len(right), 1, 1))
    other = np.where(filled, 1.0, 1.0 - present) * np.ones((len(right), 1))
    soft = [k for k in np.flatnonzero(filled).tolist() if places.read_at(k)]
    for k in soft:
        floor[:, k], other[:, k] = _of_readings(places.read_at(k), numbers)
    labelled = [k for k in np.flatnonzero(filled).tolist() if places.label[k] and k not in soft]
    at = [k for k in labelled if is_number(places.label[k])]
    read = np.array([int(places.label[k]) for k in at], dtype=np.int64)
    floor[:, at], other[:, at] = _of_numbers(read, right[:, at], numbers)
    texts = sorted(set(labelled) - set(at))
    floor[:, texts], other[:, texts] = _of_texts([places.label[k] for k in texts], right[:, texts], numbers)
    return floor, other


def _of_readings(readings: tuple[tuple[str, float], ...], numbers: IntArray) -> tuple[Array, Array]:
    """Return the likelihoods (1, S) and (1,) of a reading that is a distribution: those of its labels by their
    probabilities; where nothing can be read, everything is as likely as before."""
    names, p = [label for label, _ in readings], np.array([p for _, p in readings])
    kinds = np.array([is_number(name) for name in names])
    unread = _UNREAD * max(0.0, 1.0 - float(p.sum()))
    floor, other = np.full(len(numbers), unread), unread
    sure = np.full((1, len(names)), _READ_RIGHT)
    read = np.array([int(name) for name, kind in zip(names, kinds, strict=True) if kind], dtype=np.int64)
    texts = [name for name, kind in zip(names, kinds, strict=True) if not kind]
    for some, (of_floor, of_other) in (
        (kinds, _of_numbers(read, sure[:, kinds], numbers)),
        (~kinds, _of_texts(texts, sure[:, ~kinds], numbers)),
    ):
        floor, other = floor + p[some] @ of_floor[0], other + float(p[some] @ of_other[0])
    return floor[None], np.array([other])


def _of_numbers(read: IntArray, right: Array, numbers: IntArray) -> tuple[Array, Array]:
    """Return the likelihoods (Q, N, S) and (Q, N) of readings (N,) that are numbers."""
    wrong, here = 1.0 - right, read[:, None] == numbers
    misread = confusion()[numbers[None, :] - LOWEST, read[:, None] - LOWEST]
    floor = np.where(here, right[..., None], wrong[..., None] * misread)
    # A number far off all others may yet be printed there.
    apart = np.where(here.any(axis=1), 0.0, _OTHER_AS_NUMBER / _LABELS)
    return floor, wrong / len(confusion()) + apart * right


def _of_texts(read: list[str], right: Array, numbers: IntArray) -> tuple[Array, Array]:
    """Return the same of readings that are none."""
    sure = right_alone("", right)
    alike = [looks_like(text) for text in read]
    here = np.array([int(a) if is_number(a) else HIGHEST + 1 for a in alike], dtype=np.int64)[:, None] == numbers
    return (1.0 - sure)[..., None] * np.where(here, _LOOK_ALIKE, _FLOOR_AS_OTHER / _LABELS), sure / _LABELS
