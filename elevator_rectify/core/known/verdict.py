"""Whether a match is this panel, in this place, and known well enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.known.evidence import agreeing
from elevator_rectify.core.known.matches import Matches, Scene, in_view
from elevator_rectify.core.types import BoolArray, Detection, FitResult

FEWEST = 4
# Evidence, in nats, that so many tries do not give by chance.
_LEAST_NATS = 25.0
# Shares of the buttons in view that must be found, and of the detections there that must be buttons; the first of two
# where less than some labels are surely read, and it was not known in the frame before.
_LEAST_FOUND, _LEAST_KNOWN, _FEWEST_SURE = (0.8, 0.65), (0.8, 0.6), 3
# What a sure reading says for or against this panel, about; so much is borne against it.
_RIGHT_NATS, _WRONG_NATS, _DOUBT_NATS = 2.0, 3.5, 1.0
# Detections with a sure label among its buttons that are none of them: false ones, so many or this share of its own.
_MOST_STRANGERS, _STRANGERS_SHARE = 2, 0.1
# So far beyond its outer buttons, in pitches, a larger panel would have its next ones; a detection so near is one.
_NEXT, _AT = 1.6, 0.4
# The margin that two places on a panel need where no label tells them apart.
_UNREAD_NATS = 15.0
_MOST_SURE, _LARGEST_LOGIT = 0.999, 50.0


def identified(scene: Scene, matches: Matches, fit: FitResult, read: Sequence[Detection], follows: bool) -> FitResult:
    """Return the fit with its confidence, refused where it is not this panel, or not surely this part of it.

    read: the usable detections as read; follows: the panel was known in this place in the frame before.
    """
    margin, config, known = matches.margin, scene.config, scene.known
    logit = np.clip(min(margin, float(matches.nats[0]) - _LEAST_NATS), -_LARGEST_LOGIT, _LARGEST_LOGIT)
    confidence = min(_MOST_SURE, 1.0 / (1.0 + float(np.exp(-logit))))
    said = _said(scene, matches, read)
    by_labels = follows or bool(said.sure.sum() >= _FEWEST_SURE)
    fit = replace(fit, margin_nats=margin, confidence=confidence)
    reason = _not_this(scene, matches, said, int(by_labels))
    if reason:
        return replace(fit, status="unknown_panel", reason=f"this is not '{known.name}': {reason}")
    if margin < (config.joint.ambiguity_nats if by_labels else _UNREAD_NATS):
        reason = f"two parts of '{known.name}' explain the detections, {margin:.2g} nats apart"
        return replace(fit, status="ambiguous", reason=reason)
    return fit


@dataclass(frozen=True)
class _Said:
    """Of the detections (N,): near or at the panel's buttons, surely read, and as what is taught there."""

    near: BoolArray
    at: BoolArray
    sure: BoolArray
    right: BoolArray


def _said(scene: Scene, matches: Matches, read: Sequence[Detection]) -> _Said:
    near, at = places(scene, matches)
    sure, right = agreeing(read, [scene.known.labels[k] for k in matches.node[0]])
    return _Said(near, at, sure & near, right & at)


def _not_this(scene: Scene, matches: Matches, said: _Said, by_labels: int) -> str:
    """Return why the detections are not of this panel, '' where they may be."""
    on = matches.inlier[0] > 0.5
    seen, filled = np.flatnonzero(in_view(scene, matches.best)[0]), np.unique(matches.node[0][on])
    if len(filled) < FEWEST:
        return f"{len(filled)} of its buttons are seen, {FEWEST} needed"
    if matches.nats[0] < _LEAST_NATS:
        return "its buttons explain the detections no better than chance"
    near, at, sure, right = said.near, said.at, said.sure, said.right
    wrong = int((sure & ~right).sum())
    if _WRONG_NATS * wrong > _RIGHT_NATS * right.sum() + _DOUBT_NATS:
        return f"{wrong} of {int(sure.sum())} labels that are read are not where it has them"
    strangers = int((sure & ~at).sum())
    if strangers > max(_MOST_STRANGERS, _STRANGERS_SHARE * at.sum()):
        return f"{strangers} labelled buttons are there that it does not have"
    found = np.isin(seen, filled)
    if len(seen) and found.mean() < _LEAST_FOUND[by_labels]:
        return f"{int(found.sum())} of {len(seen)} of its buttons in view are seen"
    if at.sum() < _LEAST_KNOWN[by_labels] * near.sum():
        return f"{int(at.sum())} of {int(near.sum())} detections there are its buttons"
    return ""


def places(scene: Scene, matches: Matches) -> tuple[BoolArray, BoolArray]:
    """Return which detections (N,) lie among the best match's buttons or where these would go on, and which of them lie
    at a button, however inexact they are."""
    lines = np.column_stack([scene.usable.rays, np.ones(len(scene.usable.rays))])
    seen = lines @ np.linalg.inv(matches.best.maps[0]).T
    with np.errstate(divide="ignore", invalid="ignore"):
        place = seen[:, :2] / seen[:, 2:]
    buttons = scene.layout.places
    low, high = buttons.min(axis=0) - _NEXT, buttons.max(axis=0) + _NEXT
    near = ((place > low) & (place < high)).all(axis=1) & (seen[:, 2] > 0)
    at = np.linalg.norm(place[:, None] - buttons, axis=-1).min(axis=1) < _AT
    return np.asarray(near), np.asarray(near & at)
