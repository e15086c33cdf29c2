"""What was read in a frame just before: buttons that are where they were on the panel need not be read again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elevator_rectify.core.geometry.pose import on_plane
from elevator_rectify.core.geometry.same_places import mutually_nearest, stayed
from elevator_rectify.core.types import Array, Detection, FitResult

# Detections this near to each other on the panel, in pitches, are of one button.
_SAME_PLACE = 0.25


def same_buttons(fit: FitResult, last: FitResult) -> dict[int, int]:
    """Return which detection of the last fit each of the new one's is, where it is surely one of them."""
    if not stayed(fit, last) or not len(fit.rays) or not len(last.rays):
        return {}
    apart = np.linalg.norm(_places(fit)[:, None] - _places(last)[None], axis=-1)
    apart = np.where(np.isfinite(apart), apart, np.inf)
    return {int(k): int(n) for k, n in mutually_nearest(apart, _SAME_PLACE)}


def _places(fit: FitResult) -> Array:
    """Return the detections' places (N, 2) on the panel, in pitches."""
    return np.asarray(on_plane(fit.R_camera_panel, fit.t_camera_panel, fit.rays)[0] / fit.pitch)


def as_before(detection: Detection, before: Detection) -> Detection:
    """Return the detection as the one before was read."""
    if not before.label:
        return replace(detection, readings=before.readings)
    return replace(detection, label=before.label, score=before.score, readings=before.readings)
