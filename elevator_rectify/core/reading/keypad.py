"""Digit keypads of destination dispatch: buttons that are digits to be entered, not floors."""

from __future__ import annotations

import numpy as np

from elevator_rectify.core.reading.places import PanelPlaces

# A keypad shows a 0 and at least so many of the digits 1 to 9, and no other number.
_FEWEST_DIGITS = 6
# What is printed beside the 0, as it is printed.
_SIGNS = ("*", "#")


def is_keypad(places: PanelPlaces) -> bool:
    """Tell whether the labels are those of a telephone's keypad: 1 2 3 above 4 5 6 above 7 8 9, the 0 below them."""
    rows: dict[int, float] = {}
    for k, label in enumerate(places.label):
        if label.lstrip("-").isdigit():
            if not label.isdigit() or len(label) > 1 or int(label) in rows:
                return False
            rows[int(label)] = float(places.panel[k, 1])
    digits = [d for d in rows if d > 0]
    if 0 not in rows or len(digits) < _FEWEST_DIGITS:
        return False
    # Floors are numbered upwards, and a ground floor 0 is below 1; a keypad's digits go downwards.
    lines = [[rows[d] for d in digits if (d - 1) // 3 == line] for line in range(3)]
    if not all(lines):
        return False
    middle = [float(np.mean(line)) for line in lines]
    return middle[0] < middle[1] < middle[2] < rows[0]


def signs(places: PanelPlaces) -> tuple[str, ...]:
    """Return the labels with the keypad's signs as they are printed: '#' stops no elevator there."""
    return tuple(
        read.strip() if read.strip() in _SIGNS else label for label, read in zip(places.label, places.read, strict=True)
    )
