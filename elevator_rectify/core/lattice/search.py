"""Finding the panel's layout: its size, rows and columns apart, staggered ones, gaps that are no whole pitch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np

from elevator_rectify.core.config import JointConfig
from elevator_rectify.core.lattice.hypotheses import lattice_coordinates
from elevator_rectify.core.lattice.layout import (
    Layout,
    LayoutFit,
    design,
    evaluate,
    information,
    penalty,
    refine_layout,
)
from elevator_rectify.core.lattice.refinement import Poses, jacobians
from elevator_rectify.core.types import Array

_Change = Callable[[LayoutFit, Array, float, float, JointConfig], LayoutFit]
# A distance within this of a whole pitch counts as that.
WHOLE = 0.06
_MAX_EXTRA_LINES = 10
# Two rows of buttons are no closer than this; a staggered one fits between.
_CLOSEST = 0.6
_EXTRAPOLATED = 2.0
# A row between two that are a pitch apart is real where more than one detection lies on it, chance otherwise.
_INTERSTITIAL_GAP, _INTERSTITIAL_DETECTIONS = 0.75, 2


def with_extra_rows(fit: LayoutFit, rays: Array, sigma: float, area: float, config: JointConfig) -> LayoutFit:
    """Add rows through detections that the layout leaves out: staggered, or beyond a gap of no whole pitch."""
    for _ in range(_MAX_EXTRA_LINES):
        found = _best_extra_row(fit, rays, sigma, area, config)
        if found is None:
            return fit
        trial = evaluate(fit.pose, found, rays, sigma, area, config)
        trial = refine_layout(trial, rays, sigma, area, config, steps=3)
        if trial.log_likelihood <= fit.log_likelihood:
            return fit
        fit = trial
    return fit


def with_extra_columns(fit: LayoutFit, rays: Array, sigma: float, area: float, config: JointConfig) -> LayoutFit:
    """Add columns as `with_extra_rows` adds rows."""
    return with_columns_as_rows(with_extra_rows, fit, rays, sigma, area, config)


def with_columns_as_rows(
    change: _Change, fit: LayoutFit, rays: Array, sigma: float, area: float, config: JointConfig
) -> LayoutFit:
    """Do with the columns what `change` does with rows, where that explains the detections better."""
    turned = _turned(config)
    across = evaluate(transposed(fit.pose), fit.layout.transposed, rays, sigma, area, turned)
    changed = change(across, rays, sigma, area, turned)
    if changed is across:
        return fit
    back = evaluate(transposed(changed.pose), changed.layout.transposed, rays, sigma, area, config)
    return back if back.log_likelihood > fit.log_likelihood else fit


@lru_cache(maxsize=64)
def _turned(config: JointConfig) -> JointConfig:
    """Return the settings for a panel whose rows and columns are exchanged."""
    return replace(config, log_aspect=-config.log_aspect)


def transposed(poses: Poses) -> Poses:
    """Return the same panel with rows and columns exchanged; the row pitch becomes the unit."""
    R = np.stack([poses.R[:, :, 1], poses.R[:, :, 0], -poses.R[:, :, 2]], axis=-1)
    return Poses(R, poses.t / np.exp(poses.log_aspect)[:, None], -poses.log_aspect, poses.centre[:, ::-1], poses.brick)


def _best_extra_row(fit: LayoutFit, rays: Array, sigma: float, area: float, config: JointConfig) -> Layout | None:
    """Return the layout with the row that gains most, or None where none gains."""
    layout = fit.layout
    left = np.flatnonzero(fit.inlier < 0.5)
    q = lattice_coordinates(fit.pose.maps, rays[None])[0]
    reach = max(3.0, 0.7 * len(layout.rows))
    inside = (np.abs(q[left, 1] - np.clip(q[left, 1], layout.rows[0] - reach, layout.rows[-1] + reach)) < 1e-9) & (
        np.abs(q[left, 0] - np.clip(q[left, 0], layout.columns[0] - 0.7, layout.columns[-1] + 0.7)) < 1e-9
    )
    left = left[inside]
    if not len(left):
        return None
    d_uv = jacobians(fit.pose, q[None, left])[2][0]
    # The row is extrapolated: its place is less sure than a detection's. The likelihood after refinement decides.
    spread = _EXTRAPOLATED * sigma
    number = layout.cells + len(layout.columns)
    odds = np.log(config.inlier_share / (1 - config.inlier_share) * area / (2 * np.pi * sigma**2 * number))
    positions = np.unique(np.concatenate([q[left, 1], np.round(q[left, 1]), np.round(2 * q[left, 1]) / 2]))
    loss = float(fit.inlier.sum()) * np.log1p(len(layout.columns) / layout.cells)
    best, best_gain = None, 0.0
    for stagger in (0.0, 1.0):
        nodes = layout.columns + 0.5 * stagger
        u = nodes[np.abs(q[left, 0, None] - nodes).argmin(axis=1)]
        across, down = q[left, 0] - u, q[left, 1] - positions[:, None]
        x, y = (d_uv[:, k, 0] * across + d_uv[:, k, 1] * down for k in (0, 1))
        error2 = x * x + y * y
        gains = np.logaddexp(0.0, odds - 0.5 * error2 / spread**2).sum(axis=1) - loss
        supporters = (error2 < (3.0 * spread) ** 2).sum(axis=1)
        for k in np.argsort(-gains)[:6]:
            trial = _inserted(layout, float(positions[k]), stagger)
            if trial is None or (_interstitial(layout, positions[k]) and supporters[k] < _INTERSTITIAL_DETECTIONS):
                continue
            lost = _row_value(fit, positions[k]) if len(trial.rows) == len(layout.rows) else 0.0
            gain = float(gains[k]) - lost - penalty(trial, config) + penalty(layout, config)
            if gain > best_gain:
                best, best_gain = trial, gain
    return best


def _row_value(fit: LayoutFit, position: float) -> float:
    """Return roughly the log likelihood of what the row at this position explains now."""
    row = int(np.abs(fit.layout.rows - position).argmin())
    mine = (fit.node // len(fit.layout.columns) == row) & (fit.inlier > 0.5)
    return 6.0 * float(mine.sum())


def _interstitial(layout: Layout, position: float) -> bool:
    """Tell whether a row at this position is closer than usual to a row above and to one below."""
    distance = position - layout.rows
    above = (distance > 0) & (distance < _INTERSTITIAL_GAP)
    below = (distance < 0) & (distance > -_INTERSTITIAL_GAP)
    return bool(above.any() and below.any())


def _inserted(layout: Layout, position: float, stagger: float) -> Layout | None:
    """Insert a row, or stagger the one that is there; None where it would overlap another one."""
    nearest = int(np.abs(layout.rows - position).argmin())
    distance = abs(float(layout.rows[nearest]) - position)
    if distance < 1e-9 and stagger and not layout.row_stagger[nearest]:
        flags = layout.row_stagger.copy()
        flags[nearest] = 1.0
        return with_breaks(replace(layout, row_stagger=flags))
    if distance < (_CLOSEST if stagger == layout.row_stagger[nearest] else 0.4):
        return None
    where = int(np.searchsorted(layout.rows, position))
    rows = np.insert(layout.rows, where, position)
    return with_breaks(replace(layout, rows=rows, row_stagger=np.insert(layout.row_stagger, where, stagger)))


def with_breaks(layout: Layout) -> Layout:
    """Set the breaks of the rows: where a distance is no whole pitch, nor a half one to a staggered row."""
    distance, change = np.diff(layout.rows), np.abs(np.diff(layout.row_stagger))
    off = np.minimum(np.abs(distance - np.round(distance)), np.where(change > 0, np.abs(distance - 0.5), 1.0))
    return replace(layout, row_breaks=tuple(int(k) + 1 for k in np.flatnonzero(off > WHOLE)))


def with_gaps(fit: LayoutFit, rays: Array, sigma: float, area: float, config: JointConfig) -> LayoutFit:
    """Free the distances that are no whole pitch, one by one, while each gains enough.

    Which one, and by how much, comes from the score test: the gain of one more column z of the Jacobian, to first
    order, is (z' W e)^2 / (2 sigma^2 z' W (1 - P) z), P the projection on the parameters there are.
    """
    for _ in range(4):
        best = _best_gap(fit, rays, config)
        if best is None:
            return fit
        trial = refine_layout(evaluate(fit.pose, best, rays, sigma, area, config), rays, sigma, area, config, steps=3)
        if trial.log_likelihood <= fit.log_likelihood:
            return fit
        fit = trial
    return fit


def _best_gap(fit: LayoutFit, rays: Array, config: JointConfig) -> Layout | None:
    """Return the layout with the break of the largest score, None where it is below the threshold."""
    layout = fit.layout
    error, J, d_uv = design(fit, rays)
    row, column = np.divmod(fit.node, len(layout.columns))
    candidates = [("row", b) for b in range(1, len(layout.rows)) if b not in layout.row_breaks]
    candidates += [("column", b) for b in range(1, len(layout.columns)) if b not in layout.column_breaks]
    if not candidates:
        return None
    columns = [
        d_uv[..., 1] * (row >= b)[:, None] if axis == "row" else d_uv[..., 0] * (column >= b)[:, None]
        for axis, b in candidates
    ]
    Z = np.stack([c.ravel() for c in columns], axis=1)
    w, flat = np.repeat(fit.inlier, 2) / fit.sigma**2, J.reshape(-1, J.shape[-1])
    normal = information(J, fit.inlier, fit.sigma, config) + 1e-9 * np.eye(J.shape[-1])
    cross = (flat * w[:, None]).T @ Z
    try:
        explained = np.linalg.solve(normal, cross)
    except np.linalg.LinAlgError:
        # Of a degenerate pose, as curves have, nothing can be told.
        return None
    variance = (Z * w[:, None] * Z).sum(axis=0) - (cross * explained).sum(axis=0)
    score = (Z * w[:, None]).T @ error.ravel()
    usable = variance > 1e-3 * (Z * w[:, None] * Z).sum(axis=0)
    gain = np.where(usable, 0.5 * score**2 / np.where(usable, variance, 1.0), 0.0)
    shift = np.where(usable, score / np.where(usable, variance, 1.0), 0.0)
    gain = np.where(np.abs(shift) > WHOLE, gain, 0.0)
    k = int(gain.argmax())
    if gain[k] < config.gap_nats:
        return None
    axis, b = candidates[k]
    if axis == "row":
        return replace(layout, row_breaks=tuple(sorted({*layout.row_breaks, b})))
    return replace(layout, column_breaks=tuple(sorted({*layout.column_breaks, b})))


def trimmed(fit: LayoutFit, rays: Array, sigma: float, area: float, config: JointConfig) -> LayoutFit:
    """Drop outer rows and columns while the likelihood rises: fewer cells make every other one more likely."""
    while True:
        layout = fit.layout
        trials = []
        if len(layout.rows) > 2:
            trials += [_without_row(layout, 0), _without_row(layout, -1)]
        if len(layout.columns) > 2:
            trials += [_without_row(layout.transposed, k).transposed for k in (0, -1)]
        fits = [evaluate(fit.pose, trial, rays, sigma, area, config) for trial in trials]
        best = max(fits, key=lambda f: f.log_likelihood, default=fit)
        if best.log_likelihood <= fit.log_likelihood:
            return fit
        fit = best


def _without_row(layout: Layout, end: int) -> Layout:
    """Drop the first (0) or last (-1) row."""
    if end == 0:
        rows, flags = layout.rows[1:], layout.row_stagger[1:]
        return replace(
            layout, rows=rows, row_stagger=flags, row_breaks=tuple(b - 1 for b in layout.row_breaks if b > 1)
        )
    rows, flags = layout.rows[:-1], layout.row_stagger[:-1]
    return replace(
        layout, rows=rows, row_stagger=flags, row_breaks=tuple(b for b in layout.row_breaks if b < len(rows))
    )
