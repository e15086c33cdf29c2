"""The button that means what was asked for, or the reason why it is not certain."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.config import TargetConfig
from elevator_rectify.core.geometry.pose import moved_in_common
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.reading.labels import canonical
from elevator_rectify.core.reading.misread import is_number
from elevator_rectify.core.reading.panel import others_at, probability_of
from elevator_rectify.core.reading.plates import blank_beside
from elevator_rectify.core.types import Array, Button

DEFAULT_TARGET = TargetConfig()
# A second button with more than this probability of the label is named as a candidate.
_CANDIDATE = 0.1
# The order alone does not overrule a label that is read with such a score.
_NOT_OVERRULED = 0.98
# A label that is read with a low score is believed where the whole panel makes it as sure as this.
_BY_PANEL = 0.95
# A label with less of what was read of its button is told by the others alone. Of 320 such on 723 real panels, with .9
# and more, 15 were another button's, with .98 and more three of 258; of 4,780 that were read so, seven.
_HALF_READ = 0.4
# What digits read as upside down, and those that can only be read upright: they tell, if two buttons, and every
# twelfth, have one that is surely read.
_OVER = {"0": "0", "1": "1", "2": "2", "5": "5", "6": "9", "8": "8", "9": "6"}
_UPRIGHT, _SURELY_READ, _FEWEST_TELLING, _TELLING_SHARE = frozenset("347"), 0.9, 2.0, 1 / 12
# Floors grow upwards by so much more pairs of them than downwards, of at least so many pairs in different rows.
_UPWARDS, _FEWEST_PAIRS = 0.7, 6


@dataclass(frozen=True)
class Choice:
    """The button that was asked for, or None and why: status and reason; probability: that it has the label;
    others: labels that it may have instead, with their probabilities."""

    button: Button | None
    status: str
    reason: str = ""
    probability: float = 0.0
    others: tuple[tuple[str, float], ...] = ()


def find_button(fit: GridFit, target: str, config: TargetConfig = DEFAULT_TARGET) -> Choice:
    """Return the one button of the fit that means `target` ('7', 'open', 'B1'), or why there is none.

    A wrong pose presses a wrong button: a label that another button may have too, that is not surely what was asked
    for, or a place that is not known well enough are reasons to refuse. Spellings are unified (`labels.canonical`).
    """
    name = canonical(target)
    if not name:
        return Choice(None, "empty_target", "the target is empty")
    if not fit.ok:
        return Choice(None, "no_panel", f"{fit.status}: {fit.reason}")
    if fit.reading.keypad and is_number(name) and len(name) > 1:
        return Choice(None, "unknown_label", f"{name} is no button: this is a keypad, enter its digits")
    probability = probability_of(fit.reading, name)
    order = np.argsort(-probability, kind="stable")
    first, second = (float(probability[order[k]]) if k < len(order) else 0.0 for k in (0, 1))
    button = fit.buttons[order[0]]
    if first < 0.5 and second < _CANDIDATE:
        read = sorted({b.label for b in fit.buttons if b.label})
        return Choice(None, "unknown_label", f"no button is labelled {name}; known are: {', '.join(read) or 'none'}")
    if second > _CANDIDATE:
        places = " and ".join(_place_of(fit.buttons[k]) for k in order[:2])
        return Choice(None, "two_candidates", f"{name} may be {places}")
    others = _other_readings(fit, button) - {name, ""}
    if others:
        return Choice(None, "two_candidates", f"the cell of {name} is read as {', '.join(sorted(others))} too")
    choice = _decided(fit, button, name, first * (1.0 - second), config)
    if choice.button is None:
        return choice
    if fit.known is None and order[0] in blank_beside(fit.reading.places, fit.detections):
        reason = (
            f"what is read {_place_of(button)} may be the plate of the button without print beside it; "
            "labels.plates_on_left is off"
        )
        return Choice(None, "two_candidates", reason)
    return replace(choice, others=others_at(fit.reading, int(order[0]), name))


def _place_of(button: Button) -> str:
    return f"in cell ({button.row}, {button.column})" if button.row >= 0 else "beside the grid"


def _other_readings(fit: GridFit, button: Button) -> set[str]:
    """Return what the other detections of the button's cell read."""
    if button.row < 0:
        return set()
    mine = np.flatnonzero((fit.cells == [button.row, button.column]).all(axis=1))
    return {canonical(fit.detections[k].label) for k in mine if fit.detections and k != button.detection}


def _decided(fit: GridFit, button: Button, name: str, probability: float, config: TargetConfig) -> Choice:
    """Refuse a button whose label is not sure."""
    if fit.known is not None:
        return _of_taught(fit, button, name, probability, config)
    as_read = canonical(button.read) == name
    # What nobody detected, but the picture shows and the reader reads, is as good as detected. Of a box beside the grid
    # the floors' order says nothing: it may be no button.
    if (button.detection < 0 or button.row < 0) and not as_read and not config.allow_inferred:
        reason = f"{name} was not read, only inferred from the others; target.allow_inferred is off"
        return Choice(None, "inferred_only", reason)
    if as_read and not button.score >= config.min_score and not _weighed(fit, button, probability):
        return Choice(None, "low_score", f"{name} is read with score {button.score:.2f} < {config.min_score:g}")
    least, alone = config.min_probability, ""
    if not (as_read or config.allow_inferred or _half_read(fit, button, name)):
        least, alone = max(least, config.min_inferred_probability), ", by the others' labels alone,"
    if probability < least:
        reason = f"the label is {name}{alone} with probability {probability:.3f} < {least:g}"
        return Choice(None, "unsure_label", reason)
    if button.label_source == "corrected" and button.score >= _NOT_OVERRULED:
        reason = f"{name} by the floors' order alone, where {canonical(button.read)} is read with {button.score:.2f}"
        return Choice(None, "unsure_label", reason)
    over = upside_down(name)
    surely_upright = config.camera_is_upright or fit.labels_upright
    if over not in ("", name) and not surely_upright and not _upright(fit.buttons):
        way_out = "see target.camera_is_upright"
        reason = f"{name} is {over} upside down, and the labels do not tell which way is up; {way_out}"
        return Choice(None, "unsure_label", reason)
    return replace(_placed(fit, button, config), probability=probability)


def _weighed(fit: GridFit, button: Button, probability: float) -> bool:
    """Tell whether a label was read with all its alternatives, and is sure by the whole panel: of 26 such that were
    read with low scores none was wrong."""
    return probability >= _BY_PANEL and bool(fit.reading.places.read_at(index_of(fit, button)))


def _half_read(fit: GridFit, button: Button, name: str) -> bool:
    """Tell whether the label has much of what was read of the button, or of its plate; True where nothing was read with
    alternatives: other detectors leave labels out for many reasons, and the order of those that are there is reliable
    (of 5,384 asked on outlined panels .9996 of the answers were right)."""
    places = fit.reading.places
    if not any(places.read_at(k) for k in range(len(places.label))):
        return True
    return dict(places.read_at(index_of(fit, button))).get(name, 0.0) >= _HALF_READ


def _of_taught(fit: GridFit, button: Button, name: str, probability: float, config: TargetConfig) -> Choice:
    """Refuse a button of a taught panel that is not seen, or is surely read as another."""
    if not fit.reading.places.filled[index_of(fit, button)]:
        return Choice(None, "occluded", f"{name} is not seen where '{_name(fit)}' has it")
    read = canonical(button.read)
    if read not in ("", name) and button.score >= _SURELY_READ:
        return Choice(None, "unsure_label", f"{name} of '{_name(fit)}' is read as {read} with {button.score:.2f}")
    if probability < config.min_probability:
        reason = f"it is '{_name(fit)}', in this place, with probability {probability:.3f} < {config.min_probability:g}"
        return Choice(None, "unsure_label", reason)
    return replace(_placed(fit, button, config), probability=probability)


def _name(fit: GridFit) -> str:
    return "" if fit.known is None else fit.known.name


def index_of(fit: GridFit, button: Button) -> int:
    """Return which of the fit's buttons it is."""
    return next(k for k, b in enumerate(fit.buttons) if b is button)


def upside_down(label: str) -> str:
    """Return what a label reads as when it stands on its head, as in the picture of a camera that hangs: '' for what
    cannot be read then."""
    if label in ("up", "down"):
        return "down" if label == "up" else "up"
    turned = "".join(_OVER.get(c, " ") for c in reversed(label))
    # No floor is called 01.
    return "" if " " in turned or (turned.startswith("0") and turned != "0") else turned


def _upright(buttons: tuple[Button, ...]) -> bool:
    """Tell whether digits that are none upside down are surely read, or floors that grow upwards: hardly a panel counts
    downwards."""
    read = [(canonical(b.read), b.panel[1]) for b in buttons if b.score >= _SURELY_READ]
    floors = [(name, y) for name, y in read if name and is_number(name)]
    upright = sum(not _UPRIGHT.isdisjoint(name) for name, _ in floors)
    if upright >= max(_FEWEST_TELLING, _TELLING_SHARE * len(buttons)):
        return True
    number, y = np.array([int(name) for name, _ in floors]), np.array([y for _, y in floors])
    way = np.sign(np.subtract.outer(number, number) * np.subtract.outer(y, y))
    pairs = np.abs(way).sum() / 2.0
    return bool(pairs >= _FEWEST_PAIRS and -way.sum() / 2.0 >= _UPWARDS * pairs)


def _placed(fit: GridFit, button: Button, config: TargetConfig) -> Choice:
    """Refuse a button whose place is not known well enough to press it."""
    if not fit.metric:
        return Choice(None, "unknown_scale", "the scale is unknown: set scale.column_pitch_m or use a depth image")
    spread = lateral_std(fit, button)
    if spread > config.max_lateral_std_m:
        reason = f"{button.label} is known to {spread:.4f} m sideways, {config.max_lateral_std_m:g} allowed"
        return Choice(None, "uncertain", reason)
    return Choice(button, "found")


def lateral_std(fit: GridFit, button: Button) -> float:
    """Return the standard deviation of the button's place across the pressing direction, along the worse axis.

    Without the part of the camera's calibration: that moves its neighbours with it, and goes as the robot turns to it.
    """
    across: Array = np.linalg.svd(button.normal[None])[2][1:]
    moved = moved_in_common(fit, button.panel[None])[0, :3]
    own = button.covariance - moved @ moved.T
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(across @ own @ across.T)[-1])))
