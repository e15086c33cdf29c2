"""A panel read as a whole: which places hold a button, and the probability of every label at each."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.reading.filled import missed
from elevator_rectify.core.reading.keypad import is_keypad, signs
from elevator_rectify.core.reading.misread import is_number, right_alone
from elevator_rectify.core.reading.places import PanelPlaces, places_of
from elevator_rectify.core.reading.plates import without_plates, without_printed_plates
from elevator_rectify.core.reading.sequence import Floors, floors_of
from elevator_rectify.core.types import Array, BoolArray, FitResult

# To the floors' order, a cell without a detection is as likely empty as not; `filled` knows panels better.
_EVEN = 0.5
# An empty cell where the picture was searched and showed nothing holds a button with the odds over this, however sure
# the floors' order is: panels have blind cells too.
_NOT_SHOWN, _MOST_SURE = 30.0, 0.97
# A button shown by the picture alone is one with this probability, and so is a detection beside the grid.
_SHOWN, _BESIDE = 0.99, 0.99
# Where a detection lies across it, or beyond the end of a staggered line, there is no cell.
_NO_CELL = 0.01
_MOST_PLACES = 400
# A button is read, if not surely as what, where its labels have this probability together.
_READABLE = 0.7
# On so many of 624 real panels is exactly one button of the name. The reader was trained to expect each symbol on so
# many of the buttons that it reads, and a label that is rarer than symbols on one in so many times as many buttons as
# there are panels that have it.
_ON_PANELS = {"open": 0.6, "close": 0.56, "alarm": 0.47, "G": 0.27, "call": 0.14, "B1": 0.1, "B": 0.08, "CH": 0.08}
# The one who taught a panel erred less often than in so many labels.
_MOST_TAUGHT = 0.999
# So many other labels of a button are told, of those that are so likely.
_MOST_TOLD, _TOLD = 3, 1e-3
_ON_PANELS_USUAL, _READ_SHARE, _READ_OF_A_PANEL, _MOST_NAMED = 0.05, 0.014, 12.0, 0.995


@dataclass(frozen=True)
class Reading:
    """Of K places: present (K,) the probability of a button; floors, None where no number is read; floor_nats (K,) the
    log odds that their order gives for a floor at a place without a detection, beyond what was known; keypad: whether
    the buttons are digits to be entered, no floors; taught: (K,) the probability that each label is right where the
    panel was taught, None where it is read."""

    places: PanelPlaces
    present: Array
    floors: Floors | None
    floor_nats: Array
    keypad: bool = False
    taught: Array | None = None


def read_panel(fit: FitResult, plates_on_left: bool = False) -> Reading:
    """Return the reading of a fit that has a grid; plates_on_left: what stands to the left of a button without print is
    its label."""
    places = places_of(fit)
    if fit.known is not None:
        return _taught(fit, places)
    places = without_plates(places)
    if plates_on_left:
        places = without_printed_plates(places, fit.detections)
    keypad = is_keypad(places)
    if keypad:
        places = replace(places, label=signs(places), readings=())
    filled, prior = places.filled, _prior(fit, places)
    floors, nats = None, np.zeros(len(prior))
    if not keypad and any(is_number(text) for text in places.label) and len(places.label) <= _MOST_PLACES:
        floors = floors_of(places, prior)
        nats = _log_odds(1.0 - floors.other) - _log_odds(prior)
    present = _present(fit, places, nats)
    if floors is not None:
        floors = _scaled(_considered(floors, places), present, filled)
    return Reading(places, present, floors, nats, keypad)


def _taught(fit: FitResult, places: PanelPlaces) -> Reading:
    """Return the reading of a taught panel: its labels are as sure as that it is this panel, in this place."""
    named = np.array([label != "" for label in places.label])
    button = named | places.filled
    right = np.where(named, np.minimum(fit.confidence, _MOST_TAUGHT), 0.0)
    keypad = is_keypad(places)
    return Reading(places, np.where(button, 1.0, 0.0), None, np.zeros(len(right)), keypad, right)


def _considered(floors: Floors, places: PanelPlaces) -> Floors:
    """Return the floors without those that a reader, which read something, did not even consider: the order may choose
    among its readings, and say what it could not read, but a panel may have an order of its own."""
    floor, names = floors.floor.copy(), [str(n) for n in floors.numbers]
    for k in range(len(floor)):
        readings = dict(places.read_at(k))
        if sum(readings.values()) >= _READABLE:
            floor[k, [name not in readings for name in names]] = 0.0
    return Floors(floors.numbers, floor, floors.other)


def _prior(fit: FitResult, places: PanelPlaces) -> Array:
    """Return (K,) the probability of a button before the panel's layout and its floors are looked at."""
    prior = np.where(places.taken | places.beyond, _NO_CELL, _EVEN)
    if fit.measurement is not None:
        prior = _not_shown(prior)
    return np.where(places.filled, 1.0, prior)


def _present(fit: FitResult, places: PanelPlaces, nats: Array) -> Array:
    """Return (K,) the probability of a button, as the panel's layout and its floors' order say."""
    present = np.full(len(nats), _BESIDE)
    found = missed(fit, places, nats[: places.cells])
    if fit.measurement is not None:
        found = np.where(places.filled[: places.cells], 1.0, _not_shown(found))
    present[: places.cells] = found
    barred = (places.taken | places.beyond) & ~places.filled
    present[barred] = np.minimum(present[barred], _NO_CELL)
    present[places.shown & (places.detection < 0)] = _SHOWN
    return present


def _scaled(floors: Floors, present: Array, filled: BoolArray) -> Floors:
    """Return the floors of places without a detection as probable as the button is, where that is less."""
    total = floors.floor.sum(axis=1)
    share = np.where(filled, 1.0, np.minimum(1.0, present / np.maximum(total, 1e-12)))
    floor = floors.floor * share[:, None]
    return Floors(floors.numbers, floor, 1.0 - floor.sum(axis=1))


def _not_shown(probability: Array) -> Array:
    """Return the probability of a button where the picture does not show it."""
    p = np.minimum(probability, _MOST_SURE)
    odds = p / (1.0 - p) / _NOT_SHOWN
    return np.asarray(odds / (1.0 + odds))


def _log_odds(probability: Array) -> Array:
    p = np.clip(probability, 1e-9, 1.0 - 1e-9)
    return np.asarray(np.log(p) - np.log1p(-p))


def as_read(reading: Reading) -> Array:
    """Return (K,) the probability that each place's label is right as it was read, 0 where none was."""
    if reading.taught is not None:
        return reading.taught
    labels = np.array(reading.places.label)
    value = np.zeros(len(labels))
    for label in set(reading.places.label) - {""}:
        floor = _of_floor(reading, label)
        value[labels == label] = (_named(reading, label) if floor is None else floor)[labels == label]
    return value


def _of_floor(reading: Reading, name: str) -> Array | None:
    """Return (K,) the probability that each place is the floor `name`, None where it is none that was considered."""
    floors = reading.floors
    if floors is None or not is_number(name) or not floors.numbers[0] <= int(name) <= floors.numbers[-1]:
        return None
    return np.asarray(floors.floor[:, int(name) - floors.numbers[0]])


def _named(reading: Reading, name: str) -> Array:
    """Return (K,) the probability that each place is labelled `name`, which is no floor of the panel's.

    Where readings are distributions: a panel has such a button once, or not at all, as often as panels have it. What is
    read as 'open' with .6, and nothing else is, is the panel's open button more probably than that.
    """
    places = reading.places
    alone = np.array([_alone(reading, k, name) for k in range(len(places.label))])
    soft = np.array([bool(places.read_at(k)) for k in range(len(places.label))], dtype=bool)
    if not soft.any() or alone[~soft].any():
        return alone
    has = _ON_PANELS.get(name, _ON_PANELS_USUAL)
    p = np.clip(alone, 0.0, _MOST_NAMED)
    share = min(_READ_SHARE, has / _READ_OF_A_PANEL)
    weight = has / max(1, int(places.filled.sum())) * p / (1.0 - p) * (1.0 - share) / share
    return np.asarray(weight / (weight.sum() + 1.0 - has))


def _alone(reading: Reading, k: int, name: str) -> float:
    """Return the probability that place k is labelled `name`, which is no floor of the panel's."""
    places, floors = reading.places, reading.floors
    other = 1.0 if floors is None else float(floors.other[k])
    readings = places.read_at(k)
    if not readings:
        return float(right_alone(name, places.score[k])) * other if places.label[k] == name else 0.0
    mine = dict(readings).get(name, 0.0)
    if floors is None:
        return mine
    # That it is no floor may make a label surer than it was read, or less sure.
    inside = sum(p for label, p in readings if is_number(label))
    return mine / max(1.0 - inside, mine, 1e-9) * other


def probability_of(reading: Reading, name: str) -> Array:
    """Return (K,) the probability that each place's button is labelled `name`."""
    if reading.taught is not None:
        return np.where(np.array(reading.places.label) == name, reading.taught, 0.0)
    floor = _of_floor(reading, name)
    return np.asarray(_named(reading, name) * reading.present) if floor is None else floor


def others_at(reading: Reading, k: int, name: str) -> tuple[tuple[str, float], ...]:
    """Return what else than `name` the button at place k may be labelled, likeliest first, with probabilities."""
    labels = {label for label, _ in reading.places.read_at(k)} | {reading.places.label[k]}
    if reading.floors is not None:
        labels |= {str(n) for n in reading.floors.numbers}
    found = [(label, float(probability_of(reading, label)[k])) for label in sorted(labels - {name, ""})]
    likely = sorted((item for item in found if item[1] >= _TOLD), key=lambda item: -item[1])
    return tuple(likely[:_MOST_TOLD])
