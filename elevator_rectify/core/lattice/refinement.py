"""Pose and lattice together: expectation maximisation with Gauss-Newton steps on the 7-parameter model.

    x_n = pi(R (u_n, aspect v_n, 0)' + t),   in column pitches

for B hypotheses at once. The parameters are (t, rotation, ln aspect), at the lattice's centroid, where they are nearly
independent; the likelihood is the paper's mixture over the cells of the occupied box, with a uniform outlier.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.compiled import COMPILED, plain
from elevator_rectify.core.config import JointConfig
from elevator_rectify.core.geometry.rotations import rotations
from elevator_rectify.core.lattice import kernels, pose_kernels
from elevator_rectify.core.lattice.hypotheses import lattice_coordinates, nearest_nodes
from elevator_rectify.core.lattice.kernels import CONNECTED_CELLS, STEEP_RAD, TURNED_RAD
from elevator_rectify.core.lattice.pose_kernels import settings, steps_towards
from elevator_rectify.core.types import Array, IntArray

_HUBER = 4.0
_FIELDS = ("R", "t", "log_aspect", "centre", "brick")
_FARTHEST_CELL = 300
ANNEALING = (2.0, 1.4, 1.0, 1.0)


@dataclass(frozen=True)
class Poses:
    """B poses: R (B, 3, 3), t (B, 3) of the lattice point `centre` (B, 2), ln aspect (B,), brick (B,) as 0 or 1."""

    R: Array
    t: Array
    log_aspect: Array
    centre: Array
    brick: Array

    def take(self, chosen: IntArray) -> Poses:
        """Return the chosen poses."""
        return Poses(*(getattr(self, name)[chosen] for name in _FIELDS))

    @property
    def maps(self) -> Array:
        """Return G (B, 3, 3), from (column, row, 1) to the normalised plane."""
        first, second = self.R[:, :, 0], self.R[:, :, 1] * np.exp(self.log_aspect)[:, None]
        third = self.t - first * self.centre[:, :1] - second * self.centre[:, 1:]
        return np.stack([first, second, third], axis=-1)


@dataclass(frozen=True)
class Scored:
    """Poses with what they explain: cells (B, N, 2) (column, row), inlier (B, N), log likelihood (B,), sigma (B,)."""

    poses: Poses
    cells: Array
    inlier: Array
    log_likelihood: Array
    sigma: Array

    def take(self, chosen: IntArray) -> Scored:
        """Return the chosen ones."""
        poses = self.poses.take(chosen)
        return Scored(poses, self.cells[chosen], self.inlier[chosen], self.log_likelihood[chosen], self.sigma[chosen])


def joined(*several: Poses) -> Poses:
    """Return all poses in one batch."""
    return Poses(*(np.concatenate([getattr(p, name) for p in several]) for name in _FIELDS))


def poses_from_maps(G: Array, centre: Array, brick: Array) -> Poses:
    """Split homographies (B, 3, 3) into the nearest poses, referred to lattice points centre (B, 2)."""
    at = np.einsum("bij,bj->bi", G, np.column_stack([centre, np.ones(len(centre))]))
    G = G * np.sign(at[:, 2])[:, None, None]
    at = at * np.sign(at[:, 2])[:, None]
    lengths = np.linalg.norm(G[:, :, :2], axis=1)
    u, _, vt = np.linalg.svd(G[:, :, :2] / lengths[:, None], full_matrices=False)
    axes = u @ vt
    R = np.concatenate([axes, np.cross(axes[:, :, 0], axes[:, :, 1])[..., None]], axis=-1)
    return Poses(R, at / lengths[:, :1], np.log(lengths[:, 1] / lengths[:, 0]), centre, brick)


def mirrored(poses: Poses) -> Poses:
    """Return the poses with the tilt against the line of sight reversed (Necker): the other minimum far away."""
    sight = poses.t / np.linalg.norm(poses.t, axis=1, keepdims=True)
    # An affine camera does not see the components along the line of sight: change their sign.
    turned = poses.R - 2.0 * sight[:, :, None] * (sight[:, None, :] @ poses.R)
    turned[:, :, 2] = np.cross(turned[:, :, 0], turned[:, :, 1])
    return replace(poses, R=turned)


def projected(poses: Poses, lattice: Array) -> tuple[Array, Array, Array]:
    """Return points (B, N, 2), camera-frame arms (B, N, 3) from t, and depths (B, N) of lattice points (B, N, 2)."""
    plane = lattice - poses.centre[:, None]
    plane[..., 1] *= np.exp(poses.log_aspect)[:, None]
    arm = plane @ np.swapaxes(poses.R[:, :, :2], 1, 2)
    points = arm + poses.t[:, None]
    depth = np.asarray(np.maximum(points[..., 2], 1e-3), dtype=np.float64)
    return np.asarray(points[..., :2] / depth[..., None]), np.asarray(arm), depth


def jacobians(poses: Poses, lattice: Array) -> tuple[Array, Array, Array]:
    """Return predicted points (B, N, 2), d/d(t, rotation, ln aspect) (B, N, 2, 7) and d/d(u, v) (B, N, 2, 2)."""
    if COMPILED and len(poses.R) == 1:
        R, t, centre, points = (plain(array[0]) for array in (poses.R, poses.t, poses.centre, lattice))
        x, J, d_uv = pose_kernels.jacobians(R, t, float(poses.log_aspect[0]), centre, points)
        return x[None], J[None], d_uv[None]
    x, arm, depth = projected(poses, lattice)
    inverse = 1.0 / depth
    B, N = depth.shape
    J = np.zeros((B, N, 2, 7))
    J[..., 0, 0] = J[..., 1, 1] = inverse
    J[..., :, 2] = -x * inverse[..., None]
    X, Y, Z = arm[..., 0], arm[..., 1], arm[..., 2]
    px, py = x[..., 0], x[..., 1]
    # d(point) = rotation x arm; then the projection.
    J[..., 0, 3], J[..., 0, 4], J[..., 0, 5] = -px * Y * inverse, (Z + px * X) * inverse, -Y * inverse
    J[..., 1, 3], J[..., 1, 4], J[..., 1, 5] = -(Z + py * Y) * inverse, py * X * inverse, X * inverse
    aspect = np.exp(poses.log_aspect)
    a, b = poses.R[:, None, :, 0], poses.R[:, None, :, 1] * aspect[:, None, None]
    d_uv = np.empty((B, N, 2, 2))
    for k, e in enumerate((a, b)):
        d_uv[..., k] = (e[..., :2] - x * e[..., 2:]) * inverse[..., None]
    J[..., 6] = d_uv[..., 1] * (lattice[..., 1] - poses.centre[:, None, 1])[..., None]
    return x, J, d_uv


def box_cells(cells: Array, inlier: Array) -> Array:
    """Return (B,) the number of cells of the box around the inliers' cells, at least 1."""
    on = inlier[..., None] > 0.5
    low = np.where(on, cells, np.inf).min(axis=1)
    high = np.where(on, cells, -np.inf).max(axis=1)
    cells_along = np.where(np.isfinite(high - low), high - low + 1.0, 1.0)
    return np.asarray(np.maximum(cells_along.prod(axis=1), 1.0))


def connected(cells: Array, inlier: Array) -> Array:
    """Return the inliers (B, N) that have another one, of another cell, within two cells: far ones are chance."""
    if COMPILED:
        return kernels.connected(plain(cells), plain(inlier))
    u, v = cells[..., 0].astype(np.float32), cells[..., 1].astype(np.float32)
    du, dv = np.abs(u[:, :, None] - u[:, None]), np.abs(v[:, :, None] - v[:, None])
    near = (du <= CONNECTED_CELLS) & (dv <= CONNECTED_CELLS) & (du + dv > 0) & (inlier > 0.5)[:, None, :]
    return np.asarray(inlier * near.any(axis=-1))


def nearest_cells(G: Array, brick: Array, rays: Array) -> tuple[Array, Array]:
    """Return the nearest cells (B, N, 2) of homographies (B, 3, 3), bounded, and the lattice coordinates (B, N, 2)."""
    q = lattice_coordinates(G, np.broadcast_to(rays, (len(G), *rays.shape)))
    return np.clip(nearest_nodes(q, brick), -_FARTHEST_CELL, _FARTHEST_CELL), q


def supporting_cells(G: Array, brick: Array, rays: Array, tolerance: float = 0.28) -> tuple[Array, Array]:
    """Return cells (B, N, 2) and inliers (B, N) of homographies (B, 3, 3): detections near a node, in cells."""
    cells, q = nearest_cells(G, brick, rays)
    near = (((q - cells) ** 2).sum(axis=-1) < tolerance**2).astype(float)
    return cells, connected(cells, near)


def mixture_likelihood(
    error2: Array, number: Array, sigma: Array | float, area: float, config: JointConfig
) -> tuple[Array, Array]:
    """Return log likelihood ratio (B,) against pure outliers, and the responsibilities (B, N) of the nearest cell."""
    s2 = np.broadcast_to(np.asarray(sigma, dtype=float), number.shape)[:, None] ** 2
    odds = config.inlier_share / (1.0 - config.inlier_share) * area / (number[:, None] * 2.0 * np.pi * s2)
    log_ratio = np.log(odds) - 0.5 * error2 / s2
    log_total = np.logaddexp(0.0, log_ratio)
    return log_total.sum(axis=1), np.exp(log_ratio - log_total)


def fitted(
    poses: Poses, cells: Array, inlier: Array, rays: Array, sigma: float, config: JointConfig, steps: int
) -> Poses:
    """Fit all poses to given cells (B, N, 2) and inliers (B, N).

    A homography's nearest pose may lie many pixels off its points: without this, EM would lose them.
    """
    wide = np.full(len(poses.R), sigma)
    for _ in range(steps):
        # One wrong cell must not carry the others away.
        poses = towards(poses, cells, inlier, rays, wide, config, _HUBER * sigma)
    return poses


def towards(
    poses: Poses, cells: Array, inlier: Array, rays: Array, sigma: Array, config: JointConfig, huber: float = np.inf
) -> Poses:
    """Return the poses after a Gauss-Newton step; huber: errors that are larger count less (Huber)."""
    if COMPILED:
        return _by_kernel(poses, cells, inlier, rays, sigma, config, huber)
    predicted, J, _ = jacobians(poses, cells)
    error = rays - predicted
    weights = inlier / np.maximum(1.0, np.hypot(error[..., 0], error[..., 1]) / huber)
    return stepped(poses, gauss_newton(J, error, weights, sigma, poses.log_aspect, config))


def _by_kernel(
    poses: Poses, cells: Array, inlier: Array, rays: Array, sigma: Array, config: JointConfig, huber: float
) -> Poses:
    """Do the work of `towards` by the compiled kernel."""
    rays = np.broadcast_to(rays, cells.shape)
    given = (poses.R, poses.t, poses.log_aspect, poses.centre, cells, rays, inlier, sigma)
    R, t, log_aspect, centre, cells, rays, inlier, sigma = (plain(array) for array in given)
    R, t, log_aspect = steps_towards(
        R, t, log_aspect, centre, cells, rays, inlier, sigma, float(huber), settings(config)
    )
    return replace(poses, R=R, t=t, log_aspect=log_aspect)


def refine(poses: Poses, rays: Array, sigma: float, area: float, config: JointConfig) -> Scored:
    """Run EM with annealed variance on all poses; cells are re-assigned in every step."""
    wide = np.full(len(poses.R), sigma)
    number = np.full(len(poses.R), float(len(rays)))
    for factor in ANNEALING:
        cells = nearest_cells(poses.maps, poses.brick, rays)[0]
        error = rays - projected(poses, cells)[0]
        _, inlier = mixture_likelihood((error**2).sum(axis=-1), number, wide * factor, area, config)
        inlier = connected(cells, inlier)
        number = box_cells(cells, inlier)
        poses = towards(poses, cells, inlier, rays, wide * factor, config)
    return scored(poses, rays, sigma, area, config)


def scored(poses: Poses, rays: Array, sigma: float, area: float, config: JointConfig) -> Scored:
    """Return the poses with cells, inliers and the likelihood at their own estimate of sigma."""
    cells = nearest_cells(poses.maps, poses.brick, rays)[0]
    error2 = ((rays - projected(poses, cells)[0]) ** 2).sum(axis=-1)
    near = connected(cells, (error2 < (3.5 * sigma) ** 2).astype(float))
    error2 = np.where((error2 < (3.5 * sigma) ** 2) & (near < 0.5), 1e6, error2)
    inlier = mixture_likelihood(error2, box_cells(cells, near), sigma, area, config)[1]
    own = estimated_sigma(error2, inlier, sigma)
    likelihood, inlier = mixture_likelihood(error2, box_cells(cells, inlier), own, area, config)
    empty = np.maximum(box_cells(cells, inlier) - inlier.sum(axis=1), 0.0)
    prior = log_prior(poses, config) - config.empty_nats * empty
    return Scored(poses, cells, inlier, likelihood + prior - config.stagger_nats * poses.brick, own)


def log_prior(poses: Poses, config: JointConfig) -> Array:
    """Return the log prior (B,): pitch ratio, tilt, and an upright camera, which tells rows from columns."""
    tilt = np.arccos(np.clip(np.abs(poses.R[:, 2, 2]), 0.0, 1.0))
    roll = np.arctan2(poses.R[:, 1, 0] - poses.R[:, 0, 1], poses.R[:, 0, 0] + poses.R[:, 1, 1])
    steep = np.maximum(tilt - config.max_usual_tilt_rad, 0.0) / STEEP_RAD
    turned = np.maximum(np.abs(roll) - config.max_roll_rad, 0.0) / TURNED_RAD
    ratio = (poses.log_aspect - config.log_aspect) / config.log_aspect_std
    return np.asarray(-0.5 * (ratio**2 + steep**2 + turned**2))


def estimated_sigma(error2: Array, inlier: Array, sigma: float) -> Array:
    """Return (B,) the standard deviation per coordinate, drawn to `sigma` as by four more residuals, and clipped."""
    dof = 2.0 * inlier.sum(axis=1) - 7.0
    variance = ((inlier * error2).sum(axis=1) + 4.0 * sigma**2) / (np.maximum(dof, 0.0) + 4.0)
    return np.asarray(np.clip(np.sqrt(variance), 0.3 * sigma, 2.7 * sigma))


def gauss_newton(J: Array, error: Array, weights: Array, sigma: Array, log_aspect: Array, config: JointConfig) -> Array:
    """Return the step (B, 7) that maximises the expected log posterior."""
    w = weights / (sigma**2)[:, None]
    B, N = weights.shape
    flat = J.reshape(B, 2 * N, 7)
    weighted = flat * np.repeat(w, 2, axis=1)[..., None]
    normal = np.swapaxes(weighted, 1, 2) @ flat
    gradient = np.einsum("bmi,bm->bi", weighted, error.reshape(B, 2 * N))
    normal[:, 6, 6] += 1.0 / config.log_aspect_std**2
    gradient[:, 6] -= (log_aspect - config.log_aspect) / config.log_aspect_std**2
    diagonal = np.arange(7)
    normal[:, diagonal, diagonal] *= 1.0 + 1e-4
    normal[:, diagonal, diagonal] += 1e-6
    return np.asarray(np.linalg.solve(normal, gradient[..., None])[..., 0])


def stepped(poses: Poses, step: Array) -> Poses:
    """Apply a step (B, 7), bounded so that the linearisation holds."""
    depth = poses.t[:, 2:]
    t = poses.t + np.clip(step[:, :3], -0.3 * depth, 0.3 * depth)
    turn = step[:, 3:6]
    angle = np.linalg.norm(turn, axis=1, keepdims=True)
    turn = turn * np.minimum(1.0, 0.5 / np.maximum(angle, 1e-12))
    return replace(
        poses,
        R=rotations(turn) @ poses.R,
        t=t,
        log_aspect=np.clip(poses.log_aspect + np.clip(step[:, 6], -0.3, 0.3), -1.5, 1.5),
    )
