"""Labels that were surely read on a panel a little before: a button that is not seen now may only be hidden."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.same_places import same_places
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.reading.labels import canonical
from elevator_rectify.core.reading.target import Choice
from elevator_rectify.core.types import Array, Button

# Labels that are as probable as this are remembered; nearer than so many pitches to where one was, its button is seen.
_SURE, _NEAR = 0.9, 0.5
# Buttons of so many labels and more that lie so many times further apart, or nearer, than before, all alike to this
# share: columns or rows between them are hidden, or doubled.
_FEWEST_SPACED, _SPACED, _ALIKE = 3, 1.6, 0.15


@dataclass(frozen=True)
class SeenLabels:
    """Places (K, 2) on a panel in column pitches, and the label (K,) of each."""

    places: Array = field(default_factory=lambda: np.zeros((0, 2)))
    labels: tuple[str, ...] = ()


def seen_labels(fit: GridFit, before: SeenLabels | None = None) -> SeenLabels:
    """Return the labels that are surely read on an accepted fit's panel, and those of before that it does not show, at
    their places on this panel.

    Where it is another panel, those of before are forgotten.
    """
    sure = _labelled(fit, [b for b in _seen(fit) if b.label_source == "read" and b.label_probability >= _SURE])
    shift = None if before is None else _shift(before, fit)
    if before is None or shift is None:
        return sure
    moved = before.places + shift
    kept = [k for k, label in enumerate(before.labels) if label not in sure.labels and _far(moved[k], sure.places)]
    return SeenLabels(np.concatenate([sure.places, moved[kept]]), (*sure.labels, *(before.labels[k] for k in kept)))


def hidden_labels(seen: SeenLabels, fit: GridFit, camera: Camera) -> frozenset[str]:
    """Return the labels of which the accepted fit shows no button, though their places are in the picture.

    seen: what is known of this fit's panel (`seen_labels`).
    """
    now = _labelled(fit, _seen(fit))
    there = {label: now.places[[k for k, name in enumerate(now.labels) if name == label]] for label in seen.labels}
    points = seen.places * fit.column_pitch @ fit.R_camera_panel[:, :2].T + fit.t_camera_panel
    px = camera.project(points)
    inside = np.all((px >= 0.0) & (px <= np.array([camera.width - 1.0, camera.height - 1.0])), axis=1)
    return frozenset(
        label
        for place, label, in_picture in zip(seen.places, seen.labels, inside, strict=True)
        if in_picture and _far(place, there[label]) and _far(place, now.places)
    )


def respaced(before: SeenLabels, fit: GridFit) -> str:
    """Return how much further apart, in column pitches, an accepted fit has the buttons of labels that were read a
    little before; '' where they are as they were, or where it shows more labels than that.

    A lattice that lost every second column has twice the pitch: with a known pitch, its panel is at half the distance.
    """
    now = _labelled(fit, _seen(fit))
    common = [label for label in before.labels if now.labels.count(label) == before.labels.count(label) == 1]
    if len(common) < _FEWEST_SPACED or len(now.labels) > len(before.labels):
        return ""
    apart = []
    for one in (before, now):
        at = one.places[[one.labels.index(label) for label in common]]
        apart.append(np.linalg.norm(at[:, None] - at[None], axis=-1)[np.triu_indices(len(at), 1)])
    ratio = apart[1] / np.maximum(apart[0], 1e-9)
    middle = float(np.median(ratio))
    if 1.0 / _SPACED < middle < _SPACED or (np.abs(ratio / middle - 1.0) > _ALIKE).any():
        return ""
    return (
        f"the buttons {', '.join(sorted(common)[:3])} are {middle:.2f} times as many pitches apart as a little before: "
        "lines between them are hidden, or doubled"
    )


def unless_respaced(fit: GridFit, before: SeenLabels | None) -> GridFit:
    """Return an accepted fit; as 'ambiguous' where its labels are further apart, or nearer, than a little before."""
    reason = respaced(before, fit) if before is not None else ""
    return replace(fit, status="ambiguous", reason=reason) if reason else fit


def unless_hidden(choice: Choice, target: str, hidden: frozenset[str]) -> Choice:
    """Return the choice; as 'occluded' where the button that was asked for is hidden, and none is read so elsewhere.

    What the others' order makes of another button's reading is no reason to look for it elsewhere.
    """
    name = canonical(target)
    if name not in hidden or (choice.button is not None and _is_read(choice.button)):
        return choice
    return Choice(None, "occluded", f"{name} was read a little before, and nothing is seen there now")


def _is_read(button: Button) -> bool:
    return _is_seen(button) and button.label_source == "read"


def _is_seen(button: Button) -> bool:
    """Tell whether the button was detected, or is shown by the picture and was read."""
    return button.detection >= 0 or button.label_source == "read"


def _seen(fit: GridFit) -> list[Button]:
    return [button for button in fit.buttons if _is_seen(button)]


def _labelled(fit: GridFit, buttons: list[Button]) -> SeenLabels:
    places = np.array([b.panel for b in buttons]).reshape(-1, 2) / fit.column_pitch
    return SeenLabels(places, tuple(b.label for b in buttons))


def _shift(before: SeenLabels, fit: GridFit) -> Array | None:
    """Return how far (2,) places of before lie from those of the fit, None where it is not surely the same panel."""
    now = _labelled(fit, _seen(fit))
    pairs = same_places(before, now)
    if not len(pairs):
        return None
    return np.asarray((now.places[pairs[:, 1]] - before.places[pairs[:, 0]]).mean(axis=0))


def _far(place: Array, others: Array) -> bool:
    return not len(others) or bool(np.linalg.norm(others - place, axis=1).min() > _NEAR)
