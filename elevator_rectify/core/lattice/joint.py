"""The joint method: many lattice hypotheses, refined together with the pose; the best layout wins."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.config import Config
from elevator_rectify.core.geometry.rotations import rotation_angle_rad
from elevator_rectify.core.lattice.coarsening import coarsened
from elevator_rectify.core.lattice.columns import column_layouts
from elevator_rectify.core.lattice.hypotheses import grown_hypotheses
from elevator_rectify.core.lattice.layout import (
    LayoutFit,
    evaluate,
    refine_layout,
    regular_layout,
    without_empty_blocks,
)
from elevator_rectify.core.lattice.refinement import (
    Poses,
    Scored,
    fitted,
    joined,
    mirrored,
    poses_from_maps,
    refine,
    scored,
    supporting_cells,
)
from elevator_rectify.core.lattice.search import trimmed, with_extra_columns, with_extra_rows, with_gaps
from elevator_rectify.core.types import Array, IntArray

# Poses less apart than this are one (the margin to the best other one says how ambiguous the fit is).
OTHER_POSE_RAD = np.deg2rad(4.0)
_FIXED_STEPS = 4
# Fits that are completed to layouts: so many, and none further behind than extra rows and gaps usually gain.
_LEADERS = 3
_FEWEST = 5
_HOPELESS_NATS = 25.0
# A tracked fit must still explain this share of the detections that the last one explained.
_TRACKED_SHARE = 0.9


@dataclass(frozen=True)
class Effort:
    """How thoroughly layouts are sought.

    Where fewer than `explained` of `few` detections or less lie on a lattice, a column with controls may explain them.
    aspects: the points are stretched by these, too: greedy steps take other paths there, to other layouts.
    """

    few: int = 16
    explained: float = 0.95
    aspects: tuple[float, ...] = ()


USUAL = Effort()
# For panels on which the usual effort leads to nothing sure: on a fifth of 156 real ones this finds likelier layouts.
THOROUGH = Effort(few=60, explained=1.01, aspects=(0.75, 1.33))
# Layouts that are carried over from stretched points, the share of the hypotheses that they are sought among, and how
# coarsely they are refined first.
_CARRIED, _CARRIED_SHARE, _COARSE = 2, 0.25, (4.0, 2.0)


@dataclass(frozen=True)
class JointFit:
    """The best layout, the best one with another pose (None: there is none), and the margin between them in nats."""

    best: LayoutFit
    other: LayoutFit | None
    margin: float


def fit_joint(
    rays: Array, log_sizes: Array, sigma: float, area: float, config: Config, effort: Effort = USUAL
) -> JointFit | None:
    """Fit points (N, 2) in the normalised plane, with standard deviation sigma, in an image of this area.

    log_sizes: (N,) ln of the root of the boxes' area, in any unit, NaN where unknown. Returns None where no hypothesis
    has two rows and two columns.
    """
    layouts = _layouts(rays, sigma, area, config, effort)
    for aspect in effort.aspects:
        layouts += _carried_layouts(aspect, rays, sigma, area, config, effort)
    if not layouts:
        return None
    layouts = [refine_layout(f, rays, sigma, area, config.joint, log_sizes=log_sizes) for f in layouts]
    layouts.sort(key=lambda f: -f.support)
    best = layouts[0]
    other = next((f for f in layouts[1:] if pose_angle(f, best) > OTHER_POSE_RAD), None)
    return JointFit(best, other, best.support - other.support if other else np.inf)


def _layouts(rays: Array, sigma: float, area: float, config: Config, effort: Effort) -> list[LayoutFit]:
    """Return the layouts that lattices and, where they explain too little, columns with controls grow into."""
    layouts = _regular_layouts(rays, sigma, area, config)
    if len(rays) <= effort.few and max((_explained(f) for f in layouts), default=0.0) < effort.explained:
        fits = (_extended(f, rays, sigma, area, config) for f in column_layouts(rays, sigma, area, config))
        layouts += [f for f in fits if f is not None]
    return layouts


def _carried_layouts(
    aspect: float, rays: Array, sigma: float, area: float, config: Config, effort: Effort
) -> list[LayoutFit]:
    """Return the likeliest layouts of points that are stretched across, fitted to the points as they are."""
    few = replace(config, hypotheses=config.hypotheses.scaled(_CARRIED_SHARE))
    found = _layouts(rays / [1.0, aspect], sigma, area / aspect, few, effort)
    carried = []
    for fit in sorted(found, key=lambda f: -f.log_likelihood)[:_CARRIED]:
        maps = np.diag([1.0, aspect, 1.0]) @ fit.pose.maps
        direct = poses_from_maps(maps, fit.pose.centre, fit.pose.brick)
        for pose in (direct, mirrored(direct)):
            moved = evaluate(pose, fit.layout, rays, _COARSE[0] * sigma, area, config.joint)
            for times in _COARSE:
                moved = refine_layout(moved, rays, times * sigma, area, config.joint)
            carried.append(trimmed(moved, rays, sigma, area, config.joint))
    return carried


def _explained(fit: LayoutFit) -> float:
    """Return the share of the detections that are inliers."""
    return float((fit.inlier > 0.5).mean())


def _regular_layouts(rays: Array, sigma: float, area: float, config: Config) -> list[LayoutFit]:
    """Return the layouts that the best lattice hypotheses grow into."""
    maps, brick = grown_hypotheses(rays, sigma, config.hypotheses)
    starts = _distinct(maps, brick, rays, sigma, area, config) if len(maps) else None
    if starts is None:
        return []
    fits = refine(starts, rays, sigma, area, config.joint)
    several = (complete(fits, k, rays, sigma, area, config) for k in _leaders(fits))
    return [f for f in several if f is not None]


def track_joint(
    previous: LayoutFit, share: float, rays: Array, log_sizes: Array, sigma: float, area: float, config: Config
) -> LayoutFit | None:
    """Fit the previous pose and layout to new points; None where they do not explain them as well as they did.

    share: the share of inliers of the previous fit.
    """
    joint = config.joint
    fit = evaluate(previous.pose, previous.layout, rays, 6.0 * sigma, area, joint)
    fit = refine_layout(fit, rays, 2.0 * sigma, area, joint, steps=2)
    fit = refine_layout(fit, rays, sigma, area, joint, steps=3, log_sizes=log_sizes)
    if fit.layout.row_breaks or fit.layout.column_breaks:
        fit = evaluate(fit.pose, without_empty_blocks(fit), rays, sigma, area, joint)
    filled = np.count_nonzero(np.bincount(fit.node[fit.inlier > 0.5])) / fit.layout.cells
    return fit if _explained(fit) >= _TRACKED_SHARE * share and filled > 0.4 and fit.sigma < 2.0 * sigma else None


def turned(fit: LayoutFit, R: Array) -> LayoutFit:
    """Return the fit in a camera frame turned by R (3, 3): x_new = R x."""
    pose = replace(fit.pose, R=R @ fit.pose.R, t=fit.pose.t @ R.T)
    return replace(fit, pose=pose)


def pose_angle(one: LayoutFit, other: LayoutFit) -> float:
    """Return the angle between two fits' rotations."""
    return rotation_angle_rad(one.pose.R[0].T @ other.pose.R[0])


def _distinct(maps: Array, brick: Array, rays: Array, sigma: float, area: float, config: Config) -> Poses | None:
    """Return the poses, each with its mirrored tilt, of the best hypotheses that explain the points differently.

    They are compared as poses: with few points many homographies fit that no panel has.
    """
    cells, inlier = supporting_cells(maps, brick, rays)
    usable = np.flatnonzero(inlier.sum(axis=1) >= 4)
    if not len(usable):
        return None
    cells, inlier = cells[usable], inlier[usable]
    centre = (cells * inlier[..., None]).sum(axis=1) / inlier.sum(axis=1, keepdims=True)
    direct = poses_from_maps(maps[usable], np.round(centre), brick[usable])
    poses = joined(direct, mirrored(direct))
    cells, inlier = np.concatenate([cells, cells]), np.concatenate([inlier, inlier])
    poses = fitted(poses, cells, inlier, rays, sigma, config.joint, _FIXED_STEPS)
    fits = scored(poses, rays, 2.0 * sigma, area, config.joint)
    starts, seen = [], set()
    for index in np.argsort(-fits.log_likelihood, kind="stable"):
        on = fits.inlier[index] > 0.5
        mine = fits.cells[index][on]
        if on.sum() < 4 or (np.ptp(mine, axis=0) < 1).any():
            continue
        key = (on.tobytes(), (mine - mine.min(axis=0)).tobytes())
        if key not in seen:
            seen.add(key)
            starts.append(index)
        if len(starts) == config.hypotheses.refined:
            break
    if not starts:
        return None
    chosen = fits.poses.take(np.array(starts))
    other = fitted(mirrored(chosen), fits.cells[starts], fits.inlier[starts], rays, sigma, config.joint, _FIXED_STEPS)
    return joined(chosen, other)


def _leaders(fits: Scored) -> IntArray:
    """Return the likeliest fits, one of each group of equal ones; what is far behind cannot catch up any more."""
    chosen: list[int] = []
    best = float(fits.log_likelihood.max())
    for k in np.argsort(-fits.log_likelihood, kind="stable"):
        if fits.log_likelihood[k] < best - _HOPELESS_NATS or len(chosen) == _LEADERS:
            break
        same = (abs(fits.log_likelihood[k] - fits.log_likelihood[c]) < 1e-2 for c in chosen)
        aligned = (np.trace(fits.poses.R[k].T @ fits.poses.R[c]) > 1.0 + 2.0 * np.cos(0.01) for c in chosen)
        if not any(s and a for s, a in zip(same, aligned, strict=True)):
            chosen.append(int(k))
    return np.array(chosen, dtype=np.int64)


def complete(fits: Scored, k: int, rays: Array, sigma: float, area: float, config: Config) -> LayoutFit | None:
    """Turn a regular fit into the layout of the panel: size, staggered rows, gaps."""
    inlier = fits.inlier[k]
    if (inlier > 0.5).sum() < 4:
        return None
    layout = regular_layout(fits.cells[k], inlier, bool(fits.poses.brick[k]))
    if len(layout.rows) < 2 or len(layout.columns) < 2 or len(layout.rows) * len(layout.columns) > 8 * len(rays):
        return None
    fit = evaluate(fits.poses.take(np.array([k])), layout, rays, sigma, area, config.joint)
    return _extended(fit, rays, sigma, area, config)


def _extended(fit: LayoutFit, rays: Array, sigma: float, area: float, config: Config) -> LayoutFit | None:
    """Return the fit with the rows, columns and gaps that it lacks; None where too little lies on it."""
    joint = config.joint
    fit = trimmed(fit, rays, sigma, area, joint)
    fit = coarsened(fit, rays, sigma, area, joint)
    fit = with_extra_rows(fit, rays, sigma, area, joint)
    fit = with_extra_columns(fit, rays, sigma, area, joint)
    fit = with_gaps(fit, rays, sigma, area, joint)
    fit = refine_layout(trimmed(fit, rays, sigma, area, joint), rays, sigma, area, joint)
    return fit if (fit.inlier > 0.5).sum() >= _FEWEST else None
