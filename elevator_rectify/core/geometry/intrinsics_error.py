"""What errors of the camera's calibration do to a pose: nobody's focal length and lens are exact.

They are common to all buttons and to all frames, so that neither more buttons nor more frames make them less.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elevator_rectify.core.config import JointConfig
from elevator_rectify.core.geometry.pose import place_jacobian, projection_jacobian
from elevator_rectify.core.types import Array, FitResult, FitT

# A taught panel leaves open the pose and the ratio of the pitches, outlines tell the rotation by themselves.
_FREE = {"known": 7, "outlines": 3}


def with_intrinsics_error(fit: FitT, config: JointConfig) -> FitT:
    """Return the fit with the errors of focal length and lens in its covariance.

    An error of the focal length scales all rays, one of the lens's first radial coefficient moves them by the cube of
    their distance from the axis. What that does to a pose is the least-squares response of the filled cells' places
    (Hartley and Zisserman, 5.2: propagation of errors through a fit).
    """
    row, column = np.unique(fit.cells[fit.cells[:, 0] >= 0], axis=0).T
    stds = np.array([config.focal_std_share, config.radial_std])
    if not stds.any() or not len(row) or not np.isfinite(fit.covariance).all():
        return fit
    response = _response(fit, fit.grid_panel[row, column]) * stds
    covariance = fit.covariance + response[:6] @ response[:6].T
    return replace(fit, covariance=covariance, intrinsics_response=response)


def _response(fit: FitResult, panel: Array) -> Array:
    """Return d(t, rotation, shape) / d(ln focal length, radial coefficient) (6 + S, 2), by places (K, 2)."""
    point = panel @ fit.R_camera_panel[:, :2].T + fit.t_camera_panel
    rays = point[:, :2] / point[:, 2:]
    J = (projection_jacobian(point) @ place_jacobian(fit, panel)[:, :3]).reshape(2 * len(panel), -1)
    moved = np.stack([rays, rays * (rays**2).sum(axis=1, keepdims=True)], axis=-1).reshape(2 * len(panel), 2)
    free = _FREE.get("known" if fit.known is not None else fit.method, J.shape[1])
    response = np.zeros((J.shape[1], 2))
    # Columns of one length: places and angles have different units.
    length = np.maximum(np.linalg.norm(J[:, :free], axis=0), 1e-12)
    response[:free] = np.linalg.lstsq(J[:, :free] / length, moved, rcond=1e-6)[0] / length[:, None]
    return response
