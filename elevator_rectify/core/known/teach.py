"""Teaches a panel: from fits to one or several views of it to its buttons' places, sizes and labels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.pose import on_plane
from elevator_rectify.core.known.evidence import distribution
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.reading.plates import PLATE
from elevator_rectify.core.types import Array, Button, FitResult, KnownPanel

# A label that is less probable in every view is left open.
_LEAST_LABEL = 0.5


@dataclass(frozen=True)
class View:
    """An accepted fit and its camera."""

    fit: GridFit
    camera: Camera


def unteachable(fit: FitResult) -> str:
    """Return why a fit cannot teach its panel, '' where it can."""
    if not fit.ok:
        return f"a panel is taught by an accepted fit, this one is {fit.status}: {fit.reason}"
    if min(fit.rows, fit.columns) < 2:
        return "one row or one column of buttons cannot be taught: its centres do not determine a pose"
    return ""


def taught(view: View, name: str) -> KnownPanel:
    """Return the panel as one view shows it. Raises ValueError where the fit was refused, or is of a single line."""
    fit = view.fit
    if why := unteachable(fit):
        raise ValueError(why)
    buttons = [b for b in fit.buttons if _is_button(fit, b)]
    seen = fit.measurement
    residual = seen.residual * float(fit.pitch[0]) if seen is not None else fit.rms_px * _unit_per_px(fit)
    aspect = fit.shape_covariance[6, 6] if len(fit.shape_covariance) > 6 else 0.0
    return KnownPanel(
        name=name,
        labels=tuple(b.label if b.label_probability >= _LEAST_LABEL and b.label != PLATE else "" for b in buttons),
        places=np.array([_place(fit, b, view.camera) for b in buttons]),
        sizes=np.array([b.size for b in buttons]),
        cells=np.array([(b.row, b.column) for b in buttons], dtype=np.int64),
        metric=fit.metric,
        pitch=fit.pitch,
        row_positions=fit.row_positions,
        column_positions=fit.column_positions,
        row_staggered=fit.row_staggered,
        column_staggered=fit.column_staggered,
        row_block=fit.row_block,
        column_block=fit.column_block,
        place_std=float(residual),
        log_aspect_std=float(np.sqrt(aspect)),
        scale_std_share=fit.scale_std_share,
    )


def _is_button(fit: GridFit, button: Button) -> bool:
    """Tell whether a place surely holds a button: one that was detected, or that the picture shows and the reader took
    for one; of detections beside the grid only those with a label."""
    if button.state == "observed":
        return button.row >= 0 or button.label_probability >= _LEAST_LABEL
    if fit.measurement is None or button.state == "empty":
        return False
    cell = (button.row, button.column)
    return bool(np.isfinite(fit.measurement.correlation[cell])) and fit.undetected.get(cell, button) is not None


def _place(fit: GridFit, button: Button, camera: Camera) -> Array:
    """Return where on the panel a button really is: as the picture shows it, or else its detection or its cell."""
    if fit.measurement is not None and button.row >= 0:
        centre = fit.measurement.centre_px[button.row, button.column]
        if np.isfinite(centre).all():
            return _on_panel(fit, camera.rays(centre[None]))
    if button.row < 0 and button.detection >= 0:
        return _on_panel(fit, fit.rays[[button.detection]])
    return button.panel


def _on_panel(fit: GridFit, ray: Array) -> Array:
    """Return the place (2,) on the panel that is seen along a ray (1, 2)."""
    return np.asarray(on_plane(fit.R_camera_panel, fit.t_camera_panel, ray)[0][0])


def _unit_per_px(fit: GridFit) -> float:
    """Return the length on the panel of a pixel, about."""
    steps = [np.linalg.norm(np.diff(fit.grid_px, axis=axis), axis=2) for axis in (0, 1)]
    px = min(float(np.nanmedian(step)) for step in steps if step.size)
    return float(fit.pitch.min()) / max(px, 1e-9)


def joined(known: KnownPanel, views: Sequence[View]) -> KnownPanel:
    """Return the panel with its places and labels averaged over several views, all fitted with `known` as it is.

    Each view's places are brought to the taught ones by the affine map between them: its pose errs, too.
    """
    places = [known.places]
    votes = [Counter({label: 1.0} if label else {}) for label in known.labels]
    for view in views:
        seen = np.array([_place_of(view, k) for k in range(len(known.labels))])
        places.append(_aligned(seen, known.places))
        _vote(votes, view.fit)
    several = np.array(places)
    number = np.isfinite(several[..., 0]).sum(axis=0)
    mean = np.nanmean(several, axis=0)
    spread = np.sqrt(np.nanmean((several - mean) ** 2)) if len(views) else known.place_std
    count = float(np.median(number))
    return replace(
        known,
        labels=tuple(vote.most_common(1)[0][0] if vote else "" for vote in votes),
        places=mean,
        place_std=float(np.hypot(spread, known.place_std) / np.sqrt(count)),
        log_aspect_std=known.log_aspect_std / float(np.sqrt(count)),
    )


def _place_of(view: View, k: int) -> Array:
    """Return where a view shows a known button, NaN where it does not: boxes know less of a lattice than it does."""
    fit = view.fit
    assert fit.known is not None
    row, column = fit.known.cells[k]
    if row >= 0:
        centre = np.full(2, np.nan) if fit.measurement is None else fit.measurement.centre_px[row, column]
        return _on_panel(fit, view.camera.rays(centre[None])) if np.isfinite(centre).all() else centre
    mine = np.flatnonzero(fit.matched == k)
    return _on_panel(fit, fit.rays[mine[:1]]) if len(mine) else np.full(2, np.nan)


def _aligned(seen: Array, places: Array) -> Array:
    """Return a view's places (K, 2) without its own shift, turn and stretch against the taught ones."""
    on = np.isfinite(seen).all(axis=1)
    if on.sum() < 4:
        return np.full_like(places, np.nan)
    lines = np.column_stack([seen, np.ones(len(seen))])
    found = np.linalg.lstsq(lines[on], places[on], rcond=None)[0]
    return np.asarray(lines @ found)


def _vote(votes: list[Counter[str]], fit: GridFit) -> None:
    """Add what a view's detections read to the votes for each button's label.

    What has none so far is not named like another: it may be that one's label plate.
    """
    assert fit.known is not None
    labels = fit.known.labels
    for detection, k in zip(fit.detections, fit.matched.tolist(), strict=True):
        for label, p in distribution(detection).items() if k >= 0 else ():
            if labels[k] or label not in labels:
                votes[k][label] += p
