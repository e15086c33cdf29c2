"""Label plates beside their buttons: detectors box both, and both are read.

Raised characters stand immediately to the left of their button (ADA Standards 407.4.7.1.2, ASME A17.1): where
neighbours in a row are read alike, two by two, the left ones are plates, and what they say is the right ones' label.
Where the left ones are read and the right ones show nothing to read, it is not known which of them to press.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from elevator_rectify.core.reading.places import PanelPlaces
from elevator_rectify.core.types import Detection

# What such a plate is called.
PLATE = "plate"
# So many pairs, and so large a share of all that is read, make a panel with plates; so near in lines are neighbours.
_FEWEST_PAIRS, _LEAST_SHARE, _SAME_ROW, _NEXT = 3, 0.3, 0.35, 1.35
# Two are read alike where they say the same with this probability; of the plates that are read, so many are.
_ALIKE, _MOST_ALIKE = 0.2, 0.6
# A label that may go on with a letter ('2' as '2R', of the rear door) is another one's.
_LONGER = 0.1
# A print is surely read with this probability, and a button shows none where no label has so much; of so large a share
# of the neighbours in two columns the left one is read and the right one is not.
_PRINTED, _BLANK, _MOSTLY = 0.9, 0.5, 0.75
# A button is no farther from its plate than so many of their widths.
_BESIDE = 2.0
# Whatever is read may be anything else with this probability; labels below the other are not told.
_ANYTHING, _TOLD = 0.02, 1e-3

Readings = tuple[tuple[str, float], ...]


def without_plates(places: PanelPlaces) -> PanelPlaces:
    """Return the places with the plates named as such, and what both say as the reading of the button."""
    neighbours = _neighbours(places)
    alike = [(left, right) for left, right in neighbours if _read_alike(places, left, right)]
    pairs = _of_alike_columns(places, neighbours, alike)
    read = sum(label != "" for label in places.label)
    if len(pairs) < _FEWEST_PAIRS or 2 * len(pairs) < _LEAST_SHARE * read:
        return places
    # All in these columns are plates, also those that were misread.
    columns = _columns(places, pairs)
    label, score = list(places.label), places.score.copy()
    readings = list(places.readings) or [()] * len(label)
    for left, right in neighbours:
        if _columns_of(places, (left, right)) not in columns:
            continue
        if not label[right]:
            label[right], score[right] = label[left], score[left]
        elif label[right] == label[left]:
            score[right] = 1.0 - (1.0 - score[left]) * (1.0 - score[right])
        if places.readings:
            readings[right] = _both(readings[left], readings[right])
        label[left], readings[left] = PLATE, ((PLATE, 1.0),)
    return replace(places, label=tuple(label), score=score, readings=tuple(readings))


def _of_alike_columns(
    places: PanelPlaces, neighbours: list[tuple[int, int]], alike: list[tuple[int, int]]
) -> list[tuple[int, int]]:
    """Return the pairs that are read alike in columns where most are: two floors may be misread as one."""
    read = [pair for pair in neighbours if min(_likeliest(places, k) for k in pair) >= _BLANK]
    total, same = (Counter(_columns_of(places, pair) for pair in some) for some in (read, alike))
    return [pair for pair in alike if same[_columns_of(places, pair)] >= _MOST_ALIKE * total[_columns_of(places, pair)]]


def _columns_of(places: PanelPlaces, pair: tuple[int, int]) -> tuple[int, int]:
    return _column(places, pair[0]), _column(places, pair[1])


def _likeliest(places: PanelPlaces, k: int) -> float:
    """Return the probability of what is most likely printed at place k."""
    return max((p for _, p in _read(places, k)), default=0.0)


def blank_beside(places: PanelPlaces, detections: Sequence[Detection]) -> dict[int, int]:
    """Return, for each place that may be a plate, the place of the button without print beside it, -1 where none was
    detected.

    In their two columns nearly all the left ones are read and hardly any of the right ones, and hardly anywhere on the
    panel are neighbours both read. Only what was read as a distribution counts: other detectors leave out labels that
    are there.
    """
    columns: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for left, right in _neighbours(places):
        if places.label[left] != PLATE and _near(*(detections[places.detection[k]] for k in (left, right))):
            columns.setdefault(_columns_of(places, (left, right)), []).append((left, right))
    printed = [max((p for _, p in places.read_at(k)), default=0.0) for k in range(len(places.label))]
    telling = {at: sum(_tells(printed, pair) for pair in pairs) for at, pairs in columns.items()}
    against = sum(min(printed[left], printed[right]) >= _PRINTED for pairs in columns.values() for left, right in pairs)
    plates = [at for at, pairs in columns.items() if telling[at] >= _MOSTLY * len(pairs)]
    number = sum(telling[at] for at in plates)
    if number < _FEWEST_PAIRS or against > (1.0 - _MOSTLY) * number:
        return {}
    left_columns = {left for left, _ in plates}
    alone = {k: -1 for k in range(len(printed)) if _column(places, k) in left_columns}
    return alone | {left: right for at in plates for left, right in columns[at]}


def without_printed_plates(places: PanelPlaces, detections: Sequence[Detection]) -> PanelPlaces:
    """Return the places with what may be the plates of buttons without print named as such, and their labels as those
    of the buttons."""
    label, score, readings = list(places.label), places.score.copy(), list(places.readings)
    for plate, button in blank_beside(places, detections).items():
        if button >= 0:
            label[button], score[button], readings[button] = label[plate], score[plate], readings[plate]
        label[plate], readings[plate] = PLATE, ((PLATE, 1.0),)
    return replace(places, label=tuple(label), score=score, readings=tuple(readings))


def _tells(printed: list[float], pair: tuple[int, int]) -> bool:
    """Tell whether the left one of two is surely read and the right one shows nothing to read."""
    return printed[pair[0]] >= _PRINTED and printed[pair[1]] < _BLANK


def _near(one: Detection, other: Detection) -> bool:
    """Tell whether two stand as near to each other as a plate and its button."""
    return abs(one.x_px - other.x_px) <= _BESIDE * max(one.width_px, other.width_px)


def _columns(places: PanelPlaces, pairs: list[tuple[int, int]]) -> set[tuple[int, int]]:
    """Return the columns (left, right) of the pairs: those with most of them, each column once."""
    counts = Counter(_columns_of(places, pair) for pair in pairs)
    used: set[int] = set()
    found = set()
    for columns, _ in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
        if used.isdisjoint(columns):
            found.add(columns)
            used.update(columns)
    return found


def _neighbours(places: PanelPlaces) -> list[tuple[int, int]]:
    """Return (left, right) of detected places that are next to each other in a row."""
    detected = np.flatnonzero(places.detection >= 0)
    found = []
    for left in detected:
        down, along = (places.at[detected] - places.at[left]).T
        beside = detected[(np.abs(down) < _SAME_ROW) & (along > 0.0) & (along < _NEXT)]
        if len(beside):
            found.append((int(left), int(beside[places.at[beside, 1].argmin()])))
    return found


def _column(places: PanelPlaces, k: int) -> int:
    return round(2.0 * float(places.at[k, 1]))


def _read(places: PanelPlaces, k: int) -> Readings:
    """Return what was read at place k as a distribution."""
    known = places.read_at(k)
    return known or (((places.label[k], min(1.0, max(0.0, float(places.score[k])))),) if places.label[k] else ())


def _read_alike(places: PanelPlaces, left: int, right: int) -> bool:
    """Tell whether two places are read as the same, and neither as the beginning of another label."""
    one, other = dict(_read(places, left)), dict(_read(places, right))
    if sum(p * other.get(label, 0.0) for label, p in one.items()) < _ALIKE:
        return False
    both = [*one.items(), *other.items()]
    name = max(one, key=lambda label: one[label] * other.get(label, 0.0))
    return not any(label.startswith(name) and label[len(name) :].isalpha() and p > _LONGER for label, p in both)


def _both(plate: Readings, button: Readings) -> Readings:
    """Return the distribution of one label that is read twice."""
    if not plate or not button:
        return plate or button
    one, other = dict(plate), dict(button)
    product = {k: (one.get(k, 0.0) + _ANYTHING) * (other.get(k, 0.0) + _ANYTHING) for k in one.keys() | other.keys()}
    total = sum(product.values()) + _ANYTHING**2
    likely = [(label, p / total) for label, p in product.items() if p / total > _TOLD]
    return tuple(sorted(likely, key=lambda item: (-item[1], item[0])))
