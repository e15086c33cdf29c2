"""What errors that all buttons and frames have in common do to a pose: neither more buttons nor more frames make them
less.

Nobody's focal length and lens are exact, and a fit that is accepted with some confidence may be mistaken.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elevator_rectify.core.config import JointConfig
from elevator_rectify.core.geometry.pose import cross_matrix, moved_in_common, place_jacobian, projection_jacobian
from elevator_rectify.core.types import Array, FitResult, FitT

# A taught panel leaves open the pose and the ratio of the pitches, outlines tell the rotation by themselves.
_FREE = {"known": 7, "outlines": 3}
# The columns of `common_response` that say how a mistaken fit is off; those before are of the calibration.
_MISTAKEN = slice(2, None)
# So much a mistaken fit to a picture is turned, about each axis: of 858 accepted fits to six to ten buttons of real
# panels .79 had the rotation of the fit to all buttons in their 95 % region without it, .96 with it; of 171 held-out
# ones .87 and .96 (`benchmark --reliability`).
_MISTAKEN_RAD = np.deg2rad(5.0)


def with_common_errors(fit: FitT, config: JointConfig) -> FitT:
    """Return the fit with the errors of focal length and lens, and of being mistaken, in its covariance.

    An error of the focal length scales all rays, one of the lens's first radial coefficient moves them by the cube of
    their distance from the axis. What that does to a pose is the least-squares response of the filled cells' places
    (Hartley and Zisserman, 5.2: propagation of errors through a fit).
    """
    filled = fit.filled
    if not filled.any() or not np.isfinite(fit.covariance).all():
        return fit
    places = fit.grid_panel[filled]
    stds = np.array([config.focal_std_share, config.radial_std])
    response = np.column_stack([_response(fit, places) * stds, _mistaken(fit, places)])
    covariance = fit.covariance + response[:6] @ response[:6].T
    return replace(fit, covariance=covariance, common_response=response)


def _mistaken(fit: FitResult, panel: Array) -> Array:
    """Return d(t, rotation, shape) / d(turn about each axis) (6 + S, 3) about the middle of the places (K, 2) on the
    panel, in the standard deviation that a fit to a picture has which is wrong with the probability that it says.

    The covariance of a mixture of right fits and wrong ones is that of the right ones, and so much of the wrong ones'.
    Fits to boxes are as exact as they say, taught panels and outlines have errors of other kinds.
    """
    turned = np.zeros((len(fit.shape_covariance), 3))
    if fit.method == "joint" and fit.known is None and fit.measurement is not None:
        std = _MISTAKEN_RAD * np.sqrt(1.0 - fit.confidence)
        turned[:3] = std * cross_matrix(fit.R_camera_panel[:, :2] @ panel.mean(axis=0))
        turned[3:6] = std * np.eye(3)
    return turned


def covariance_if_right(fit: FitResult, covariance: Array, panel: Array) -> Array:
    """Return the covariance (3, 3) of a place (2,) on the panel without that of being mistaken: two fits agree where
    they are as near to each other as they are exact, not because either may be mistaken."""
    moved = moved_in_common(fit, panel[None])[0, :3, _MISTAKEN]
    return np.asarray(covariance - moved @ moved.T)


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
