"""Panels as they are: rows and columns at free distances, half-pitch rows, and the pose fitted with them.

A layout places node (r, c) at (columns[c] + half if row r is staggered, rows[r] + half if column c is staggered).
A break before row r says that its distance to row r - 1 is no whole or half pitch and is estimated; all rows behind
it move along. The same for columns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.config import JointConfig
from elevator_rectify.core.hypotheses import lattice_coordinates
from elevator_rectify.core.lattice_fit import (
    Poses,
    estimated_sigma,
    jacobians,
    log_prior,
    mixture_likelihood,
    projected,
    stepped,
)
from elevator_rectify.core.pose import LatticePose, cross_matrix
from elevator_rectify.core.types import Array, IntArray

_STEPS = 5
# A distance within this of a whole pitch counts as that.
_WHOLE = 0.06
_MAX_EXTRA_LINES = 10
# Two rows of buttons are no closer than this; a staggered one fits between.
_CLOSEST = 0.6
_EXTRAPOLATED = 2.0


@dataclass(frozen=True)
class Layout:
    """Positions (R,), (C,) in pitches, staggered (R,), (C,) as 0 or 1, and the indices before which a break is."""

    rows: Array
    columns: Array
    row_stagger: Array
    column_stagger: Array
    row_breaks: tuple[int, ...] = ()
    column_breaks: tuple[int, ...] = ()

    @property
    def nodes(self) -> Array:
        """Return lattice coordinates (R, C, 2) = (column, row)."""
        u = self.columns[None, :] + 0.5 * self.row_stagger[:, None]
        v = self.rows[:, None] + 0.5 * self.column_stagger[None, :]
        return np.stack(np.broadcast_arrays(u, v), axis=-1)

    @property
    def cells(self) -> float:
        """Return how many cells the layout has; a staggered line has one less."""
        return max(1.0, float(len(self.rows) * len(self.columns) - self.row_stagger.sum() - self.column_stagger.sum()))

    @property
    def transposed(self) -> Layout:
        """Return the layout with rows and columns exchanged."""
        return Layout(
            self.columns, self.rows, self.column_stagger, self.row_stagger, self.column_breaks, self.row_breaks
        )


@dataclass(frozen=True)
class LayoutFit:
    """A pose (batch of one) with its layout; node (N,) index of each detection's nearest node, inlier (N,) in 0..1."""

    pose: Poses
    layout: Layout
    node: IntArray
    inlier: Array
    sigma: float
    log_likelihood: float

    @property
    def cells(self) -> IntArray:
        """Return (N, 2) row and column of each detection, -1 for outliers."""
        row, column = np.divmod(self.node, len(self.layout.columns))
        return np.where(self.inlier[:, None] > 0.5, np.column_stack([row, column]), -1)


def regular_layout(cells: Array, inlier: Array, brick: bool = False) -> Layout:
    """Return the box of the inliers' cells (N, 2) = (column, row); in a brick layout odd rows are staggered."""
    on = cells[inlier > 0.5]
    low, high = np.floor(on.min(axis=0)), np.floor(on.max(axis=0))
    columns, rows = (np.arange(low[k], high[k] + 1.0) for k in (0, 1))
    return Layout(rows, columns, rows % 2.0 if brick else np.zeros(len(rows)), np.zeros(len(columns)))


def evaluate(pose: Poses, layout: Layout, rays: Array, sigma: float, area: float, config: JointConfig) -> LayoutFit:
    """Return what pose and layout explain, with the standard deviation that they leave."""
    nodes = projected(pose, layout.nodes.reshape(1, -1, 2))[0][0]
    distance2 = ((rays[:, None] - nodes[None]) ** 2).sum(axis=-1)
    node = distance2.argmin(axis=1)
    error2, number = distance2[np.arange(len(rays)), node][None], np.array([layout.cells])
    inlier = mixture_likelihood(error2, number, sigma, area, config)[1]
    own = estimated_sigma(error2, inlier, sigma)
    likelihood, inlier = mixture_likelihood(error2, number, own, area, config)
    prior = float(log_prior(pose, config)[0])
    return LayoutFit(
        pose, layout, node, inlier[0], float(own[0]), float(likelihood[0]) + prior - _penalty(layout, config)
    )


def design(fit: LayoutFit, rays: Array) -> tuple[Array, Array, Array]:
    """Return error (N, 2), Jacobian (N, 2, 7 + breaks) and d/d(u, v) (N, 2, 2) at each detection's node."""
    at = fit.layout.nodes.reshape(-1, 2)[fit.node]
    x, J, d_uv = jacobians(fit.pose, at[None])
    row, column = np.divmod(fit.node, len(fit.layout.columns))
    extra = [d_uv[0, :, :, 1] * (row >= b)[:, None] for b in fit.layout.row_breaks]
    extra += [d_uv[0, :, :, 0] * (column >= b)[:, None] for b in fit.layout.column_breaks]
    return rays - x[0], np.concatenate([J[0], *[e[..., None] for e in extra]], axis=-1), d_uv[0]


def information(J: Array, weights: Array, sigma: float, config: JointConfig) -> Array:
    """Return J' W J / sigma^2 with the aspect's prior."""
    flat = J.reshape(-1, J.shape[-1])
    normal = (flat * np.repeat(weights, 2)[:, None] / sigma**2).T @ flat
    normal[6, 6] += 1.0 / config.log_aspect_std**2
    return np.asarray(normal)


def refine_layout(
    fit: LayoutFit, rays: Array, sigma: float, area: float, config: JointConfig, steps: int = _STEPS
) -> LayoutFit:
    """Alternate responsibilities and Gauss-Newton steps on pose and breaks."""
    for _ in range(steps):
        error, J, _ = design(fit, rays)
        normal = information(J, fit.inlier, fit.sigma, config)
        gradient = np.einsum("nij,ni,n->j", J, error, fit.inlier) / fit.sigma**2
        gradient[6] -= fit.pose.log_aspect[0] / config.log_aspect_std**2
        step = np.linalg.solve(normal + np.diag(1e-6 + 1e-5 * np.diag(normal)), gradient)
        fit = evaluate(stepped(fit.pose, step[None, :7]), _moved(fit.layout, step[7:]), rays, sigma, area, config)
        if np.abs(step).max() < 1e-5:
            break
    return fit


def _moved(layout: Layout, steps: Array) -> Layout:
    """Move the lines behind each break."""
    rows, columns = layout.rows.copy(), layout.columns.copy()
    bounded = np.clip(steps, -0.3, 0.3)
    for index, step in zip(layout.row_breaks, bounded, strict=False):
        rows[index:] += step
    for index, step in zip(layout.column_breaks, bounded[len(layout.row_breaks) :], strict=True):
        columns[index:] += step
    return replace(layout, rows=rows, columns=columns)


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
    across = evaluate(transposed(fit.pose), fit.layout.transposed, rays, sigma, area, config)
    more = with_extra_rows(across, rays, sigma, area, config)
    if more is across:
        return fit
    back = evaluate(transposed(more.pose), more.layout.transposed, rays, sigma, area, config)
    return back if back.log_likelihood > fit.log_likelihood else fit


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
        across = np.broadcast_to(q[left, 0] - u, (len(positions), len(left)))
        delta = np.stack([across, q[left, 1] - positions[:, None]], axis=-1)
        error2 = (np.einsum("nij,pnj->pni", d_uv, delta) ** 2).sum(axis=-1)
        gains = np.logaddexp(0.0, odds - 0.5 * error2 / spread**2).sum(axis=1) - loss
        for k in np.argsort(-gains)[:6]:
            trial = _inserted(layout, float(positions[k]), stagger)
            if trial is None:
                continue
            lost = _row_value(fit, positions[k]) if len(trial.rows) == len(layout.rows) else 0.0
            gain = float(gains[k]) - lost - _penalty(trial, config) + _penalty(layout, config)
            if gain > best_gain:
                best, best_gain = trial, gain
    return best


def _row_value(fit: LayoutFit, position: float) -> float:
    """Return roughly the log likelihood of what the row at this position explains now."""
    row = int(np.abs(fit.layout.rows - position).argmin())
    mine = (fit.node // len(fit.layout.columns) == row) & (fit.inlier > 0.5)
    return 6.0 * float(mine.sum())


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
    return replace(layout, row_breaks=tuple(int(k) + 1 for k in np.flatnonzero(off > _WHOLE)))


def _penalty(layout: Layout, config: JointConfig) -> float:
    """Return what breaks and staggered lines cost, in nats."""
    breaks = len(layout.row_breaks) + len(layout.column_breaks)
    return config.gap_nats * breaks + config.stagger_nats * float(
        layout.row_stagger.sum() + layout.column_stagger.sum()
    )


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
    variance = (Z * w[:, None] * Z).sum(axis=0) - (cross * np.linalg.solve(normal, cross)).sum(axis=0)
    score = (Z * w[:, None]).T @ error.ravel()
    usable = variance > 1e-3 * (Z * w[:, None] * Z).sum(axis=0)
    gain = np.where(usable, 0.5 * score**2 / np.where(usable, variance, 1.0), 0.0)
    shift = np.where(usable, score / np.where(usable, variance, 1.0), 0.0)
    gain = np.where(np.abs(shift) > _WHOLE, gain, 0.0)
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


def pose_at(fit: LayoutFit, rays: Array, node: Array, config: JointConfig) -> tuple[LatticePose, Array]:
    """Return the pose with its origin at a lattice point (2,), and the covariance (6, 6) of (t, rotation) there.

    Aspect and breaks are unknown too and marginalised; `node` must lie before every break. An error of the focal length
    scales all rays; its part is the fit's linear response to that.
    """
    _, J, _ = design(fit, rays)
    inverse = np.linalg.inv(information(J, fit.inlier, fit.sigma, config) + 1e-9 * np.eye(J.shape[-1]))
    pull = np.einsum("nij,ni,n->j", J, rays, fit.inlier) / fit.sigma**2
    response = config.focal_std_share * (inverse @ pull)
    inverse = inverse + np.outer(response, response)
    R, aspect = fit.pose.R[0], float(np.exp(fit.pose.log_aspect[0]))
    offset = (np.asarray(node) - fit.pose.centre[0]) * np.array([1.0, aspect])
    arm = R[:, :2] @ offset
    T = np.zeros((6, J.shape[-1]))
    T[:, :6] = np.eye(6)
    T[:3, 3:6] = -cross_matrix(arm)
    T[:3, 6] = R[:, 1] * offset[1]
    return LatticePose(R, fit.pose.t[0] + arm, aspect), np.asarray(T @ inverse @ T.T)
