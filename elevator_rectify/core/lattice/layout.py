"""Panels as they are: rows and columns at free distances, half-pitch rows, and the pose fitted with them.

A layout places node (r, c) at (columns[c] + half if row r is staggered, rows[r] + half if column c is staggered).
A break before row r says that its distance to row r - 1 is no whole or half pitch and is estimated; all rows behind
it move along. The same for columns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from elevator_rectify.core.compiled import COMPILED, plain
from elevator_rectify.core.config import JointConfig
from elevator_rectify.core.geometry.pose import LatticePose, cross_matrix
from elevator_rectify.core.lattice import kernels
from elevator_rectify.core.lattice.kernels import SETTLED, PosedLayout
from elevator_rectify.core.lattice.pose_kernels import settings
from elevator_rectify.core.lattice.refinement import (
    Poses,
    estimated_sigma,
    jacobians,
    log_prior,
    mixture_likelihood,
    projected,
    stepped,
)
from elevator_rectify.core.lattice.sizes import size_information, size_nats
from elevator_rectify.core.types import Array, IntArray

_STEPS = 5
_NO_SIZES = np.zeros(0)


@dataclass(frozen=True)
class Layout:
    """Positions (R,), (C,) in pitches, staggered (R,), (C,) as 0 or 1, and the indices before which a break is."""

    rows: Array
    columns: Array
    row_stagger: Array
    column_stagger: Array
    row_breaks: tuple[int, ...] = ()
    column_breaks: tuple[int, ...] = ()

    @cached_property
    def nodes(self) -> Array:
        """Return lattice coordinates (R, C, 2) = (column, row), which must not be written to."""
        nodes = np.empty((len(self.rows), len(self.columns), 2))
        nodes[..., 0] = self.columns[None, :] + 0.5 * self.row_stagger[:, None]
        nodes[..., 1] = self.rows[:, None] + 0.5 * self.column_stagger[None, :]
        nodes.flags.writeable = False
        return nodes

    @cached_property
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
    """A pose (batch of one) with its layout; node (N,) index of each detection's nearest node, inlier (N,) in 0..1;
    size_nats: what the boxes' sizes add to the log likelihood of the places."""

    pose: Poses
    layout: Layout
    node: IntArray
    inlier: Array
    sigma: float
    log_likelihood: float
    size_nats: float = 0.0

    @property
    def support(self) -> float:
        """Return the log likelihood of the detections' places and sizes."""
        return self.log_likelihood + self.size_nats

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


def penalty(layout: Layout, config: JointConfig) -> float:
    """Return what breaks and staggered lines cost, in nats."""
    breaks = len(layout.row_breaks) + len(layout.column_breaks)
    return config.gap_nats * breaks + config.stagger_nats * float(
        layout.row_stagger.sum() + layout.column_stagger.sum()
    )


def evaluate(pose: Poses, layout: Layout, rays: Array, sigma: float, area: float, config: JointConfig) -> LayoutFit:
    """Return what pose and layout explain, with the standard deviation that they leave."""
    if COMPILED:
        return _explained(pose, layout, rays, sigma, area, config)
    nodes = projected(pose, layout.nodes.reshape(1, -1, 2))[0][0]
    distance2 = ((rays[:, None] - nodes[None]) ** 2).sum(axis=-1)
    node = distance2.argmin(axis=1)
    error2, number = distance2[np.arange(len(rays)), node][None], np.array([layout.cells])
    inlier = mixture_likelihood(error2, number, sigma, area, config)[1]
    own = estimated_sigma(error2, inlier, sigma)
    likelihood, inlier = mixture_likelihood(error2, number, own, area, config)
    prior = float(log_prior(pose, config)[0])
    empty = max(0.0, layout.cells - float(inlier.sum()))
    total = float(likelihood[0]) + prior - penalty(layout, config) - config.empty_nats * empty
    return LayoutFit(pose, layout, node, inlier[0], float(own[0]), total)


def _explained(pose: Poses, layout: Layout, rays: Array, sigma: float, area: float, config: JointConfig) -> LayoutFit:
    """Do the work of `evaluate` by the compiled kernel."""
    cost = layout.cells, penalty(layout, config)
    node, inlier, own, total = kernels.explained(
        posed_layout(pose, layout), *cost, plain(rays), float(sigma), float(area), settings(config)
    )
    return LayoutFit(pose, layout, node, inlier, own, total)


def design(fit: LayoutFit, rays: Array) -> tuple[Array, Array, Array]:
    """Return error (N, 2), Jacobian (N, 2, 7 + breaks) and d/d(u, v) (N, 2, 2) at each detection's node."""
    if COMPILED:
        return kernels.design(posed_layout(fit.pose, fit.layout), fit.node, plain(rays))
    at = fit.layout.nodes.reshape(-1, 2)[fit.node]
    x, J, d_uv = jacobians(fit.pose, at[None])
    row, column = np.divmod(fit.node, len(fit.layout.columns))
    extra = [d_uv[0, :, :, 1] * (row >= b)[:, None] for b in fit.layout.row_breaks]
    extra += [d_uv[0, :, :, 0] * (column >= b)[:, None] for b in fit.layout.column_breaks]
    return rays - x[0], np.concatenate([J[0], *[e[..., None] for e in extra]], axis=-1), d_uv[0]


def depths(fit: LayoutFit) -> tuple[Array, Array]:
    """Return the depth (N,) of each detection's node and its derivative (N, 7 + breaks) as `design` orders it."""
    lattice = fit.layout.nodes.reshape(-1, 2)[fit.node]
    _, arm, depth = projected(fit.pose, lattice[None])
    along, down = fit.pose.R[0, 2, 0], fit.pose.R[0, 2, 1] * np.exp(fit.pose.log_aspect[0])
    row, column = np.divmod(fit.node, len(fit.layout.columns))
    zero = np.zeros(len(lattice))
    first = [zero, zero, zero + 1.0, arm[0, :, 1], -arm[0, :, 0], zero]
    first.append(down * (lattice[:, 1] - fit.pose.centre[0, 1]))
    extra = [down * (row >= b) for b in fit.layout.row_breaks]
    extra += [along * (column >= b) for b in fit.layout.column_breaks]
    return np.maximum(depth[0], 1e-6), np.column_stack([*first, *extra])


def information(J: Array, weights: Array, sigma: float, config: JointConfig) -> Array:
    """Return J' W J / sigma^2 with the aspect's prior."""
    flat = J.reshape(-1, J.shape[-1])
    normal = (flat * np.repeat(weights, 2)[:, None] / sigma**2).T @ flat
    normal[6, 6] += 1.0 / config.log_aspect_std**2
    return np.asarray(normal)


def refine_layout(
    fit: LayoutFit,
    rays: Array,
    sigma: float,
    area: float,
    config: JointConfig,
    steps: int = _STEPS,
    log_sizes: Array | None = None,
) -> LayoutFit:
    """Alternate responsibilities and Gauss-Newton steps on pose and breaks; by the boxes' sizes, too, if given."""
    if COMPILED:
        return _refined(fit, rays, sigma, area, config, steps, log_sizes)
    for _ in range(steps):
        error, J, _ = design(fit, rays)
        normal = information(J, fit.inlier, fit.sigma, config)
        gradient = np.einsum("nij,ni,n->j", J, error, fit.inlier) / fit.sigma**2
        gradient[6] -= (fit.pose.log_aspect[0] - config.log_aspect) / config.log_aspect_std**2
        if log_sizes is not None:
            of_sizes, pull = size_information(*depths(fit), log_sizes, fit.inlier)
            normal, gradient = normal + of_sizes, gradient + pull
        step = np.linalg.solve(normal + np.diag(1e-6 + 1e-5 * np.diag(normal)), gradient)
        fit = evaluate(stepped(fit.pose, step[None, :7]), moved(fit.layout, step[7:]), rays, sigma, area, config)
        if np.abs(step).max() < SETTLED:
            break
    return fit if log_sizes is None else replace(fit, size_nats=size_nats(depths(fit)[0], log_sizes, fit.inlier))


def _refined(
    fit: LayoutFit, rays: Array, sigma: float, area: float, config: JointConfig, steps: int, log_sizes: Array | None
) -> LayoutFit:
    """Do the work of `refine_layout` by the compiled kernel."""
    layout = fit.layout
    posed, moves, node, inlier, own, total, depth = kernels.refined(
        posed_layout(fit.pose, layout),
        *(layout.cells, penalty(layout, config), plain(rays), float(sigma), float(area), settings(config)),
        *(fit.node, plain(fit.inlier), fit.sigma, steps, plain(_NO_SIZES if log_sizes is None else log_sizes)),
    )
    nats = 0.0 if log_sizes is None else size_nats(depth, log_sizes, inlier)
    return LayoutFit(pose_of(posed, fit.pose), shifted(layout, moves), node, inlier, own, total, nats)


def posed_layout(pose: Poses, layout: Layout) -> PosedLayout:
    """Return a pose (batch of one) and its layout as the kernels take them."""
    R, t, centre = (plain(array[0]) for array in (pose.R, pose.t, pose.centre))
    nodes = plain(layout.nodes.reshape(-1, 2))
    breaks = np.array(layout.row_breaks, dtype=np.int64), np.array(layout.column_breaks, dtype=np.int64)
    return PosedLayout(R, t, float(pose.log_aspect[0]), centre, nodes, len(layout.columns), *breaks)


def pose_of(posed: PosedLayout, before: Poses) -> Poses:
    """Return the pose (batch of one) that a kernel made of the one before."""
    return replace(before, R=posed.R[None], t=posed.t[None], log_aspect=np.array([posed.log_aspect]))


def moved(layout: Layout, steps: Array) -> Layout:
    """Move the lines behind each break, by no more than is sound at once."""
    return shifted(layout, np.clip(steps, -0.3, 0.3))


def shifted(layout: Layout, steps: Array) -> Layout:
    """Return the layout with the lines behind each break so much further."""
    if not len(steps):
        return layout
    rows, columns = layout.rows.copy(), layout.columns.copy()
    for index, step in zip(layout.row_breaks, steps, strict=False):
        rows[index:] += step
    for index, step in zip(layout.column_breaks, steps[len(layout.row_breaks) :], strict=True):
        columns[index:] += step
    return replace(layout, rows=rows, columns=columns)


def without_empty_blocks(fit: LayoutFit) -> Layout:
    """Return the layout without the outer blocks that hold no detection: nothing says any more where they are."""
    layout = fit.layout
    row, column = np.divmod(fit.node[fit.inlier > 0.5], len(layout.columns))
    r, row_breaks = _kept(len(layout.rows), layout.row_breaks, row)
    c, column_breaks = _kept(len(layout.columns), layout.column_breaks, column)
    return Layout(
        layout.rows[r], layout.columns[c], layout.row_stagger[r], layout.column_stagger[c], row_breaks, column_breaks
    )


def _kept(number: int, breaks: tuple[int, ...], filled: IntArray) -> tuple[slice, tuple[int, ...]]:
    """Return the lines from the first block with a filled line to the last one, and the breaks between them."""
    edges = (0, *breaks, number)
    held = [k for k in range(len(edges) - 1) if ((filled >= edges[k]) & (filled < edges[k + 1])).any()]
    if not held:
        return slice(0, number), breaks
    low, high = edges[held[0]], edges[held[-1] + 1]
    return slice(low, high), tuple(b - low for b in breaks if low < b < high)


def pose_at(
    fit: LayoutFit,
    rays: Array,
    node: Array,
    config: JointConfig,
    weights: Array | None = None,
    log_sizes: Array | None = None,
) -> tuple[LatticePose, Array]:
    """Return the pose with its origin at a lattice point (2,), and the covariance of (t, rotation, ln aspect, breaks)
    there, (7 + B, 7 + B).

    rays: (N, 2) of what the fit's nodes were fitted to; weights: (N, 2, 2) the information of each, by default that of
    detections; log_sizes: (N,) of the boxes, where they were fitted to them too. `node` must lie before every break.
    """
    _, J, _ = design(fit, rays)
    if weights is None:
        weights = (fit.inlier / fit.sigma**2)[:, None, None] * np.eye(2)
    weighted = np.swapaxes(J, 1, 2) @ weights
    normal = (weighted @ J).sum(axis=0) + 1e-9 * np.eye(J.shape[-1])
    normal[6, 6] += 1.0 / config.log_aspect_std**2
    if log_sizes is not None:
        normal += size_information(*depths(fit), log_sizes, fit.inlier)[0]
    inverse = np.linalg.inv(normal)
    R, aspect = fit.pose.R[0], float(np.exp(fit.pose.log_aspect[0]))
    offset = (np.asarray(node) - fit.pose.centre[0]) * np.array([1.0, aspect])
    arm = R[:, :2] @ offset
    T = np.eye(J.shape[-1])
    T[:3, 3:6] = -cross_matrix(arm)
    T[:3, 6] = R[:, 1] * offset[1]
    return LatticePose(R, fit.pose.t[0] + arm, aspect), np.asarray(T @ inverse @ T.T)
