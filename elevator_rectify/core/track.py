"""From frame to frame: the last fit starts the next, and the pose is smoothed as far as the covariances allow."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from elevator_rectify.core.config import SmoothingConfig
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.types import Array, FitResult, FitT

# 99.9 % of a chi-squared variable of six degrees of freedom: what lies beyond is a jump, not noise.
_JUMP_CHI2 = 22.46
_SAME_LINE = 0.1


@dataclass(frozen=True)
class Track:
    """The last accepted fit as measured, its smoothed pose with the covariance of that, and the image's stamp."""

    fit: FitResult
    R: Array
    t: Array
    covariance: Array
    stamp_ns: int


def smoothed(
    track: Track | None, fit: FitT, camera: Camera, stamp_ns: int, config: SmoothingConfig
) -> tuple[Track | None, FitT]:
    """Return the new track and the fit to publish: smoothed by the track where it shows the same panel.

    A Kalman filter (Thrun, Burgard and Fox, 3.2): the panel stands, the camera moves by the configured speeds. The
    published covariance stays the single frame's: a detector's errors repeat from frame to frame.
    """
    if not fit.ok:
        return track, fit
    if track is not None and stamp_ns <= track.stamp_ns:
        return track, fit
    fresh = Track(fit, fit.R_camera_panel, fit.t_camera_panel, fit.covariance, stamp_ns)
    seconds = 0.0 if track is None else 1e-9 * (stamp_ns - track.stamp_ns)
    if track is None or seconds > config.max_gap_s or not same_panel(track.fit, fit):
        return fresh, fit
    unit = 1.0 if fit.metric else 1.0 / config.usual_pitch_m
    moved = np.repeat([config.speed_m_per_s * unit, config.turn_rad_per_s], 3) * seconds
    prior = track.covariance + np.diag(moved**2)
    innovation = np.concatenate(
        [fit.t_camera_panel - track.t, cv2.Rodrigues(fit.R_camera_panel @ track.R.T)[0].ravel()]
    )
    together = prior + fit.covariance
    if innovation @ np.linalg.solve(together, innovation) > _JUMP_CHI2:
        return fresh, fit
    gain = np.linalg.solve(together, prior).T
    step = gain @ innovation
    R, t = cv2.Rodrigues(step[3:])[0] @ track.R, track.t + step[:3]
    return Track(fit, R, t, prior - gain @ prior, stamp_ns), posed(fit, R, t, camera)


def same_panel(one: FitResult, other: FitResult) -> bool:
    """Tell whether two fits have the same rows and columns, and one unit."""
    if one.metric != other.metric or (one.rows, one.columns) != (other.rows, other.columns):
        return False
    lines = ((one.row_positions, other.row_positions), (one.column_positions, other.column_positions))
    return all(bool((np.abs(a - b) < _SAME_LINE).all()) for a, b in lines)


def posed(fit: FitT, R: Array, t: Array, camera: Camera) -> FitT:
    """Return the fit with another pose of its panel."""
    points = fit.grid_panel @ R[:, :2].T + t
    return replace(fit, R_camera_panel=R, t_camera_panel=t, grid_points=points, grid_px=camera.project(points))
