"""Poses of a taught panel that detections may be seen from: three of its buttons taken for three detections.

A button and two of its neighbours fix an affine map; what that map makes of the buttons around them shows whether it is
worth more. An affine map of a plane of known shape is two poses (weak perspective): the sign of the tilt is open.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elevator_rectify.core.config import JointConfig
from elevator_rectify.core.lattice.refinement import (
    Poses,
    fitted,
    gauss_newton,
    jacobians,
    joined,
    mirrored,
    projected,
    stepped,
)
from elevator_rectify.core.types import Array, BoolArray, IntArray

# Nearest neighbours of which two make a corner; so many corners of the panel, and of the detections, are tried.
_NEIGHBOURS, _MOST_BUTTONS, _MOST_CORNERS = 6, 320, 48
# Sine of the least angle at a corner.
_LEAST_SINE = 0.3
# Singular values of a panel's affine map are not further apart: it is not tilted more than 75 degrees.
_MOST_FORESHORTENED = 0.25
# Buttons around a corner that are looked for, and how near to their place, in distances of the nearest neighbour.
_AROUND, _NEAR = 8, 0.35
# Corners that are followed. A button that is found where it should be counts as much as so many nats.
_FOLLOWED, _FOUND_NATS = 32, 2.0
_LOCAL_STEPS = 3
# How far from its place, in pitches, a button may be while more and more of the panel is fitted; then the noise counts.
_CAPTURE = (0.3, 0.22, 0.15, 0.08, 0.0, 0.0)
_WIDER = 1.4


@dataclass(frozen=True)
class Corners:
    """T corners: indices (T, 3) of points and two neighbours, the second clockwise from the first as y points down."""

    index: IntArray

    def edges(self, points: Array) -> Array:
        """Return (T, 2, 2) whose columns lead from the corner to its neighbours."""
        corner = points[self.index[:, 0]]
        return np.stack([points[self.index[:, 1]] - corner, points[self.index[:, 2]] - corner], axis=-1)


def corners_of(points: Array, neighbours: int) -> Corners:
    """Return the corners that points (N, 2) make, those of the nearest neighbours first."""
    away = points[None] - points[:, None]
    distance = np.linalg.norm(away, axis=-1)
    order = np.argsort(distance, axis=1, kind="stable")[:, 1 : 1 + neighbours]
    number = order.shape[1]
    a, b = (k.ravel() for k in np.meshgrid(np.arange(number), np.arange(number), indexing="ij"))
    corner = np.repeat(np.arange(len(points)), number**2)
    i, j = order[:, a].ravel(), order[:, b].ravel()
    along, across = away[corner, i], away[corner, j]
    area = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    length = distance[corner, i] * distance[corner, j]
    wide = area > _LEAST_SINE * np.maximum(length, 1e-12)
    rank = np.tile(a + b, len(points))
    chosen = np.flatnonzero(wide)
    chosen = chosen[np.lexsort((length[chosen], rank[chosen]))]
    return Corners(np.column_stack([corner, i, j])[chosen])


def hypotheses(places: Array, rays: Array, evidence: Array, sigma: float, config: JointConfig) -> Poses | None:
    """Return poses from which the panel's buttons at places (K, 2), in column pitches, may be seen along some of the
    rays (N, 2) of an upright camera; None where there are none.

    evidence: (N, K) nats that the readings add where a detection is a button; sigma: of the rays.
    """
    ours = Corners(corners_of(places, _NEIGHBOURS).index[:_MOST_BUTTONS])
    seen = Corners(corners_of(rays, _NEIGHBOURS).index[:_MOST_CORNERS])
    if not len(ours.index) or not len(seen.index):
        return None
    # (T seen, T ours, 2, 2): d(ray) / d(place).
    A = seen.edges(rays)[:, None] @ np.linalg.inv(ours.edges(places))[None]
    possible = _possible(A, config)
    s, o = np.nonzero(possible)
    if not len(s):
        return None
    A, corner, at = A[s, o], ours.index[o], seen.index[s]
    around, found, near = _around(places, rays, A, corner[:, 0], at[:, 0])
    nats = evidence[at, corner].sum(axis=1) + np.where(near, _FOUND_NATS + evidence[found, around], -0.5).sum(axis=1)
    best = np.argsort(-nats, kind="stable")[:_FOLLOWED]
    start = _poses(A[best], places[corner[best, 0]], rays[at[best, 0]])
    lattice = np.concatenate([places[corner[best]], places[around[best]]], axis=1)
    targets = np.concatenate([rays[at[best]], rays[found[best]]], axis=1)
    weight = np.concatenate([np.ones((len(best), 3)), near[best]], axis=1)
    lattice, weight, targets = (np.concatenate([part, part]) for part in (lattice, weight, targets))
    return fitted(joined(start, mirrored(start)), lattice, weight, targets, 2.0 * sigma, config, _LOCAL_STEPS)


def _possible(A: Array, config: JointConfig) -> BoolArray:
    """Return which affine maps (..., 2, 2) a panel may have before an upright camera."""
    a, b, c, d = A[..., 0, 0], A[..., 0, 1], A[..., 1, 0], A[..., 1, 1]
    turned, mirrored_part = np.hypot(a + d, c - b), np.hypot(a - d, b + c)
    roll = np.arctan2(c - b, a + d)
    foreshortened = (turned - mirrored_part) / np.maximum(turned + mirrored_part, 1e-12)
    return np.asarray((foreshortened > _MOST_FORESHORTENED) & (np.abs(roll) < config.max_roll_rad))


def _around(
    places: Array, rays: Array, A: Array, corner: IntArray, at: IntArray
) -> tuple[IntArray, IntArray, BoolArray]:
    """Return for each map (T, 2, 2), of a button `corner` (T,) seen at detection `at` (T,): the buttons around it, the
    detections nearest to where they should be, and whether these are near enough, each (T, around)."""
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    by_distance = np.argsort(apart, axis=1, kind="stable")[:, 1 : 1 + _AROUND]
    step = np.take_along_axis(apart, by_distance[:, :1], axis=1)[:, 0]
    around = by_distance[corner]
    expected = rays[at][:, None] + (places[around] - places[corner][:, None]) @ np.swapaxes(A, 1, 2)
    found, least = np.empty(around.shape, dtype=np.int64), np.empty(around.shape)
    # One by one: all at once would take a hundred megabytes.
    for k in range(around.shape[1]):
        distance2 = (expected[:, k, :1] - rays[:, 0]) ** 2 + (expected[:, k, 1:] - rays[:, 1]) ** 2
        found[:, k] = distance2.argmin(axis=1)
        least[:, k] = distance2.min(axis=1)
    scale = np.sqrt(np.maximum(np.linalg.det(A), 1e-12)) * step[corner]
    near = least < (_NEAR * scale[:, None]) ** 2
    return around, found, near & (found != at[:, None])


def _poses(A: Array, corner: Array, at: Array) -> Poses:
    """Return one of the two poses of each affine map (B, 2, 2) of a place (B, 2) that is seen along a ray (B, 2)."""
    scale = np.linalg.norm(A, ord=2, axis=(1, 2))
    top = A / scale[:, None, None]
    hidden = np.sqrt(np.maximum(0.0, 1.0 - (top**2).sum(axis=1)))
    sign = np.where(-(top[:, :, 0] * top[:, :, 1]).sum(axis=1) < 0.0, -1.0, 1.0)
    third = np.stack([hidden[:, 0], sign * hidden[:, 1]], axis=1)
    u, _, vt = np.linalg.svd(np.concatenate([top, third[:, None]], axis=1), full_matrices=False)
    axes = u @ vt
    R = np.concatenate([axes, np.cross(axes[:, :, 0], axes[:, :, 1])[..., None]], axis=-1)
    t = np.concatenate([at, np.ones((len(at), 1))], axis=1) / scale[:, None]
    return Poses(R, t, np.zeros(len(A)), corner, np.zeros(len(A)))


def grown(poses: Poses, places: Array, rays: Array, sigma: float, config: JointConfig) -> Poses:
    """Return the poses fitted to all detections near a button, with an annealed variance; buttons are re-assigned in
    every step."""
    every = np.broadcast_to(places, (len(poses.R), *places.shape))
    for capture in _CAPTURE:
        node, error2 = nearest(poses, places, rays)
        predicted, J, _ = jacobians(poses, np.take_along_axis(every, node[..., None], axis=1))
        spread = np.maximum(_WIDER * sigma, capture / np.maximum(poses.t[:, 2], 1e-6))
        weight = np.exp(-0.5 * np.minimum(error2 / spread[:, None] ** 2, 60.0))
        poses = stepped(poses, gauss_newton(J, rays - predicted, weight, spread, poses.log_aspect, config))
    return poses


def nearest(poses: Poses, places: Array, rays: Array) -> tuple[IntArray, Array]:
    """Return the button (B, N) nearest to each detection, and the squared distance (B, N) from it."""
    points, _, depth = projected(poses, places[None])
    # Far away what lies behind the camera.
    seen = np.where(depth[..., None] > 1e-3, points, 1e6)
    distance2 = ((rays[None, :, None] - seen[:, None]) ** 2).sum(axis=-1)
    node = distance2.argmin(axis=-1)
    return node, np.take_along_axis(distance2, node[..., None], axis=-1)[..., 0]
