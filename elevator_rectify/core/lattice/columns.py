"""Layouts of one column of floors with a pair of controls above or below, as every fourth real panel has.

The controls are a row whose distance from the column's end is free, and their own distance is no whole number of
pitches; no two neighbours of the column span a cell, so that no hypothesis of the regular search has both.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from elevator_rectify.core.config import Config, JointConfig
from elevator_rectify.core.lattice.hypotheses import TILT_SINE, fit_homographies
from elevator_rectify.core.lattice.layout import Layout, LayoutFit, evaluate, refine_layout
from elevator_rectify.core.lattice.refinement import Poses, fitted, mirrored, poses_from_maps
from elevator_rectify.core.lattice.search import WHOLE, with_breaks
from elevator_rectify.core.types import Array, IntArray

# A column is so long at least; its next button is where the last two say, within these shares of the step.
_SHORTEST, _ALONG, _ACROSS = 3, 0.3, 0.15
# Perspective changes a column's step from one button to the next by no more than this: prior of the 1-D projection.
_BENDING = 0.1
# The middle of two controls is on the column's line, or one of them is, within this share of their distance.
_ON_LINE = 0.15
# Controls further from the column's end than so many pitches belong to something else.
_FARTHEST = 6.0
# Steps from the affine pose to the fitted one.
_STEPS = 8
# Layouts that are refined, the likeliest of all.
_REFINED = 2


def column_layouts(rays: Array, sigma: float, area: float, config: Config) -> list[LayoutFit]:
    """Return the likeliest layouts of a column and a pair of points (N, 2), refined; none where there is no such."""
    joint, found = config.joint, list[LayoutFit]()
    for pose, layout in _candidates(rays, sigma, config):
        for one in (pose, mirrored(pose)):
            found.append(evaluate(one, layout, rays, 2.0 * sigma, area, joint))
    found.sort(key=lambda f: -f.log_likelihood)
    fits = [refine_layout(f, rays, 2.0 * sigma, area, joint) for f in found[:_REFINED]]
    return [refine_layout(f, rays, sigma, area, joint) for f in fits]


def _candidates(rays: Array, sigma: float, config: Config) -> Iterator[tuple[Poses, Layout]]:
    """Yield a pose and a layout for every pair that goes with the longest column."""
    steepest = float(np.tan(config.hypotheses.max_axis_angle_rad))
    column = _longest_column(rays, steepest)
    if len(column) < _SHORTEST:
        return
    along, place = _direction(rays[column])
    others = np.setdiff1d(np.arange(len(rays)), column)
    for left in others:
        for right in others:
            across = rays[right] - rays[left]
            if not (across[0] > 0 and abs(across[1]) < steepest * across[0]):
                continue
            which = _on_the_line(rays[[left, right]], place, along)
            if which is None:
                continue
            at = rays[left] + which * across
            row = _index_of(float((at - place) @ along), (rays[column] - place) @ along)
            if not -_FARTHEST < row < len(column) - 1 + _FARTHEST:
                continue
            row = float(np.round(row)) if abs(row - np.round(row)) < WHOLE else row
            ends = np.array([[-1.0, row], [1.0, row]]) if which == 0.5 else np.array([[0.0, row], [1.0, row]])
            ends = ends if which != 1.0 else ends - [1.0, 0.0]
            yield _posed(rays[np.concatenate([column, [left, right]])], len(column), ends, sigma, config.joint)


def _longest_column(rays: Array, steepest: float) -> IntArray:
    """Return the indices of the longest chain of points downwards in steps that change little."""
    best: list[int] = []
    offset = rays[None] - rays[:, None]
    down = (offset[..., 1] > 0) & (np.abs(offset[..., 0]) < steepest * offset[..., 1])
    for first, second in zip(*np.nonzero(down), strict=True):
        chain = [int(first), int(second)]
        while True:
            step = rays[chain[-1]] - rays[chain[-2]]
            length = float(np.hypot(*step))
            error = rays - (rays[chain[-1]] + step)
            parallel, normal = np.abs(error @ step) / length**2, np.abs(error @ [-step[1], step[0]]) / length**2
            near = np.flatnonzero((parallel < _ALONG) & (normal < _ACROSS))
            if not len(near):
                break
            chain.append(int(near[parallel[near].argmin()]))
        if len(chain) > len(best):
            best = chain
    return np.array(best, dtype=np.int64)


def _direction(points: Array) -> tuple[Array, Array]:
    """Return unit direction (2,) and first point (2,) of the line through a column's points, downwards."""
    along = np.linalg.svd(points - points.mean(axis=0))[2][0]
    return along * np.sign(along[1]), points[0]


def _on_the_line(pair: Array, place: Array, along: Array) -> float | None:
    """Return where between the pair's points (2, 2) the line passes: .5 for their middle, 0 or 1 for one of them."""
    normal = np.array([-along[1], along[0]])
    left, right = (pair - place) @ normal
    width = abs(right - left)
    for which in (0.5, 0.0, 1.0):
        if abs(left + which * (right - left)) < _ON_LINE * width:
            return which
    return None


def _index_of(position: float, positions: Array) -> float:
    """Return the index at which a place on the column's line is, from those of its buttons (K,): 1-D projection.

    position = (p k + q) / (1 + r k), linear in p, q and r; r is held small.
    """
    k = np.arange(len(positions), dtype=float)
    step = float(np.median(np.diff(positions)))
    A = np.column_stack([k, np.ones(len(k)), -k * positions / step])
    ridge = np.diag([0.0, 0.0, (0.05 / _BENDING) ** 2])
    p, q, r = np.linalg.solve(A.T @ A + ridge + 1e-9 * np.eye(3), A.T @ (positions / step))
    x = position / step
    slope = p - r * x
    return float((x - q) / slope) if abs(slope) > 0.2 else float("inf")


def _posed(points: Array, floors: int, ends: Array, sigma: float, config: JointConfig) -> tuple[Poses, Layout]:
    """Return pose and layout of a column's points and the pair's (floors + 2, 2): the column at u = 0, the pair at
    `ends` (2, 2)."""
    at = np.concatenate([np.column_stack([np.zeros(floors), np.arange(floors)]), ends])
    length = float(np.hypot(*(points[1] - points[0])))
    everyone = np.ones((1, len(points)))
    to_rays = np.array([[length, 0.0, points[0, 0]], [0.0, length, points[0, 1]], [0.0, 0.0, 1.0]])
    ridge = np.array([sigma / (TILT_SINE * length**2)])
    G = to_rays @ fit_homographies(at[None], (points[None] - points[0]) / length, everyone, ridge)
    poses = poses_from_maps(G, at.mean(axis=0).round()[None], np.zeros(1))
    poses = fitted(poses, at[None], everyone, points, sigma, config, _STEPS)
    rows, columns = np.unique(np.append(np.arange(floors, dtype=float), ends[0, 1])), np.unique(at[:, 0])
    return poses, with_breaks(Layout(rows, columns, np.zeros(len(rows)), np.zeros(len(columns))))
