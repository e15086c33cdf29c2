"""Pose of a planar lattice from its homography, and the covariance of that pose.

The lattice has coordinates q = (column, aspect * row): the column pitch is the unit of length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.types import Array, FitResult

# Share of a pitch over which the projection is taken for linear.
_STEP = 0.05

# Places so little before a row or column, in pitches, are on it: staggered ones are half a pitch behind.
_ON_LINE = 0.25


@dataclass(frozen=True)
class LatticePose:
    """x_camera = R (column, aspect * row, 0) + t, in column pitches."""

    R: Array
    t: Array
    aspect: float

    def camera_points(self, lattice: Array) -> Array:
        """Return camera-frame points (..., 3) of lattice coordinates (..., 2) = (column, row)."""
        plane = np.asarray(lattice) * np.array([1.0, self.aspect])
        return np.asarray(plane @ self.R[:, :2].T + self.t)


def pose_from_homography(G: Array) -> LatticePose:
    """Split G (3, 3), which maps (column, row, 1) to normalised image coordinates, into a pose.

    G ~ [r1, aspect r2, t]. Where G is no exact pose (erratum 10: products of plane maps are not), the first two
    columns are orthogonalised symmetrically.
    """
    G = G * np.sign(G[2, 2])
    lengths = np.linalg.norm(G[:, :2], axis=0)
    u, _, vt = np.linalg.svd(G[:, :2] / lengths, full_matrices=False)
    axes = u @ vt
    R = np.column_stack([axes, np.cross(axes[:, 0], axes[:, 1])])
    return LatticePose(R, G[:, 2] / lengths[0], float(lengths[1] / lengths[0]))


def lattice_jacobian(lattice: Array, pose: LatticePose) -> Array:
    """Return d(x, y) / d(t, theta, ln aspect) (N, 2, 7) for lattice points (N, 2) = (column, row).

    theta: R <- exp(theta) R about the camera's axes, at the lattice's origin t. Column order follows REP-103:
    translation, then rotation.
    """
    plane = lattice * np.array([1.0, pose.aspect])
    arm = plane @ pose.R[:, :2].T
    d_point = projection_jacobian(arm + pose.t)
    stretch = plane[:, 1:] * pose.R[:, 1]
    return np.concatenate([d_point, -d_point @ cross_matrix(arm), d_point @ stretch[:, :, None]], axis=2)


def projection_jacobian(points: Array) -> Array:
    """Return d(x, y) / d(point) (N, 2, 3) of the rays (x, y) to points (N, 3)."""
    x, y, inverse = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2], 1.0 / points[:, 2]
    zero = np.zeros_like(x)
    return np.stack(
        [np.stack([inverse, zero, -x * inverse], axis=-1), np.stack([zero, inverse, -y * inverse], axis=-1)], axis=1
    )


def cross_matrix(v: Array) -> Array:
    """Return [v]x (..., 3, 3) of vectors (..., 3)."""
    zero = np.zeros(v.shape[:-1])
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    rows = [np.stack(r, axis=-1) for r in ([zero, -z, y], [z, zero, -x], [-y, x, zero])]
    return np.stack(rows, axis=-2)


def pose_covariance(lattice: Array, pose: LatticePose, weights: Array, sigma: float) -> Array:
    """Return the (6, 6) covariance of (t, theta) for detections of standard deviation `sigma` (normalised units).

    The aspect is unknown too and marginalised. Singular directions become infinite, not zero.
    """
    J = lattice_jacobian(lattice, pose)
    information = np.einsum("n,nij,nik->jk", weights, J, J) / sigma**2
    values, vectors = np.linalg.eigh(information)
    if values[0] <= 1e-12 * values[-1]:
        return np.full((6, 6), np.inf)
    return np.asarray((vectors / values @ vectors.T)[:6, :6])


def scale_pose_covariance(covariance: Array, t: Array, pitch: float, pitch_std: float) -> Array:
    """Return the covariance with lengths multiplied by the column pitch, whose own uncertainty is added.

    t: (3,) in column pitches. The error of the pitch moves t along itself: pitch_std^2 t t'.
    """
    if not np.isfinite(covariance).all():
        return covariance
    scaled = in_unit(covariance, pitch)
    scaled[:3, :3] += pitch_std**2 * np.outer(t, t)
    return scaled


def in_unit(covariance: Array, pitch: float) -> Array:
    """Return the covariance (6 + S, 6 + S) of (t, rotation, shape) with lengths multiplied by the column pitch."""
    lengths = np.ones(len(covariance))
    lengths[:3] = pitch
    return np.asarray(covariance * np.outer(lengths, lengths))


def covariance_at(fit: FitResult, panel: Array) -> Array:
    """Return the covariance (K, 6, 6) of the pose at places (K, 2) on the panel, in the fit's unit.

    The errors of the aspect and of the gaps move a place along the panel, that of the scale along its line of sight;
    those that all frames have in common, of the camera's calibration and of being mistaken, are in it too.
    """
    T, response = place_jacobian(fit, panel), fit.common_response
    whole = fit.shape_covariance + response @ response.T if response.size else fit.shape_covariance
    found = T @ whole @ np.swapaxes(T, 1, 2)
    point = panel @ fit.R_camera_panel[:, :2].T + fit.t_camera_panel
    found[:, :3, :3] += fit.scale_std_share**2 * point[:, :, None] * point[:, None, :]
    return np.asarray(found)


def residual_covariance_at(fit: FitResult, panel: Array) -> Array:
    """Return the covariance (K, 6, 6) of the pose at places (K, 2) on the panel that the residuals leave: without what
    all frames have in common, the errors of scale and calibration, and of being mistaken."""
    T = place_jacobian(fit, panel)
    return np.asarray(T @ fit.shape_covariance @ np.swapaxes(T, 1, 2))


def moved_in_common(fit: FitResult, panel: Array) -> Array:
    """Return by how much (K, 6, C) one standard deviation of each error that all frames have in common moves the pose
    at places (K, 2) on the panel."""
    if not fit.common_response.size:
        return np.zeros((len(panel), 6, fit.common_response.shape[1]))
    return np.asarray(place_jacobian(fit, panel) @ fit.common_response)


def place_jacobian(fit: FitResult, panel: Array) -> Array:
    """Return d(point, rotation) / d(t, rotation, shape) (K, 6, 6 + S) of places (K, 2) on the panel."""
    arm = panel @ fit.R_camera_panel[:, :2].T
    T = np.zeros((len(panel), 6, len(fit.shape_covariance)))
    T[:, :, :6] = np.eye(6)
    T[:, :3, 3:6] = -cross_matrix(arm)
    T[:, :3, 6:] = _shape_jacobian(fit, panel)
    return T


def _shape_jacobian(fit: FitResult, panel: Array) -> Array:
    """Return d(point) / d(ln aspect, row breaks, column breaks) (K, 3, S) of places (K, 2) on the panel."""
    J = np.zeros((len(panel), 3, len(fit.shape_covariance) - 6))
    if not J.shape[-1]:
        return J
    along, down = fit.R_camera_panel[:, 0], fit.R_camera_panel[:, 1]
    J[:, :, 0] = panel[:, 1:] * down
    at = 1
    for axis, lines, block, direction in (
        (1, fit.row_positions, fit.row_block, down),
        (0, fit.column_positions, fit.column_block, along),
    ):
        line = np.searchsorted(lines, panel[:, axis] / fit.pitch[axis] + _ON_LINE, side="right") - 1
        mine = block[np.clip(line, 0, len(lines) - 1)]
        for number in range(1, int(block[-1]) + 1 if len(block) else 1):
            J[:, :, at] = (mine >= number)[:, None] * fit.pitch[axis] * direction
            at += 1
    return J


def jacobians_px(fit: FitResult, places: Array, camera: Camera) -> Array:
    """Return d pixel / d place (K, 2, 2), in pixels a unit of the fit, at places (K, 2) of the panel; NaN behind the
    camera."""
    step = _STEP * float(fit.pitch[0])
    near = places[None] + np.array([[0.0, 0.0], [step, 0.0], [0.0, step]])[:, None]
    px = camera.project(near @ fit.R_camera_panel[:, :2].T + fit.t_camera_panel)
    return np.asarray(np.stack([px[1] - px[0], px[2] - px[0]], axis=-1) / step)


def on_plane(R: Array, t: Array, rays: Array) -> tuple[Array, Array]:
    """Return where rays (N, 2), normalised, meet the plane of a pose, (N, 2) in its frame, and their depths (N,)."""
    lines = np.column_stack([rays, np.ones(len(rays))])
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (R[:, 2] @ t) / (lines @ R[:, 2])
        return np.asarray((lines * depth[:, None] - t) @ R[:, :2]), depth
