"""How printed floors are misread: the probability of one number being read as another, and look-alikes of digits."""

from __future__ import annotations

from functools import cache

import numpy as np

from elevator_rectify.core.types import Array

LOWEST, HIGHEST = -9, 130
# Pairs of digits that look alike, and how much likelier they are exchanged than others.
_ALIKE = {"17": 4, "38": 4, "56": 3, "68": 4, "08": 3, "06": 2, "35": 2, "89": 2, "14": 2, "27": 2, "49": 2, "39": 2}
_LETTERS = str.maketrans({"I": "1", "L": "1", "|": "1", "O": "0", "Q": "0", "S": "5", "Z": "2", "B": "8", "G": "6"})
# Shares of the errors: one digit exchanged, one lost, one too many, anything else.
_EXCHANGED, _LOST, _ADDED, _ANYTHING = 0.7, 0.12, 0.08, 0.1


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
