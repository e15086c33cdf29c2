"""Poses and headers as messages."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from elevator_rectify.core.geometry.pose import covariance_at
from elevator_rectify.core.geometry.rotations import rotation
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.types import Array
from elevator_rectify.ros.messages import Make

# Variance of a translation whose scale is unknown: a kilometre of standard deviation. No filter and no arm uses it.
UNKNOWN_SCALE_VARIANCE = 1e6


def ros_header(header: Any, make: Make) -> Any:
    """Return a std_msgs/Header of the same stamp and frame, in the types of `make`."""
    stamp = make("builtin_interfaces/msg/Time", sec=int(header.stamp.sec), nanosec=int(header.stamp.nanosec))
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=str(header.frame_id))


def quaternion(R: Array) -> tuple[float, float, float, float]:
    """Return (x, y, z, w) of a rotation matrix, w >= 0."""
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    squares = (1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i, 1.0 + a + e + i)
    # By the largest of the four: well conditioned at every angle (Shepperd 1978).
    rows = (
        (squares[0], b + d, c + g, h - f),
        (b + d, squares[1], f + h, c - g),
        (c + g, f + h, squares[2], d - b),
        (h - f, c - g, d - b, squares[3]),
    )
    q = rows[squares.index(max(squares))]
    length = math.copysign(math.hypot(*q), q[3])
    return q[0] / length, q[1] / length, q[2] / length, q[3] / length


def rotation_of(x: float, y: float, z: float, w: float) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion of any length."""
    half = np.array([x, y, z])
    length = float(np.linalg.norm(half))
    return rotation(half / length * 2.0 * np.arctan2(length, w) if length > 1e-12 else np.zeros(3))


def pose_of(t: Array, q: tuple[float, float, float, float], make: Make) -> Any:
    """Return a geometry_msgs/Pose."""
    position = make("geometry_msgs/msg/Point", x=float(t[0]), y=float(t[1]), z=float(t[2]))
    orientation = make("geometry_msgs/msg/Quaternion", x=q[0], y=q[1], z=q[2], w=q[3])
    return make("geometry_msgs/msg/Pose", position=position, orientation=orientation)


def stamped_pose(pose: Any, covariance: Array, header: Any, make: Make) -> Any:
    """Return a PoseWithCovarianceStamped of a Pose and its covariance (6, 6)."""
    both = make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance.ravel())
    return make("geometry_msgs/msg/PoseWithCovarianceStamped", header=header, pose=both)


def message_covariance(fit: GridFit, panel: Array | None = None) -> Array:
    """Return the (6, 6) covariance to publish, at the panel's origin or at a place (2,) on it.

    Where the scale is unknown, the translation is in pitches, and its variance too large for any use.
    """
    covariance = fit.covariance.copy() if panel is None else covariance_at(fit, panel[None])[0]
    if not fit.metric:
        covariance[:3] = covariance[:, :3] = 0.0
        covariance[:3, :3] = UNKNOWN_SCALE_VARIANCE * np.eye(3)
    return covariance
