"""Straight edges in the picture that run along the panel's two directions: plates, seams, frames.

A line in space with direction d is seen in a plane through the camera's centre; with that plane's normal l, l . d = 0
(Hartley and Zisserman, 8.6). Only the direction counts, so that an edge parallel to the panel serves, in its plane or
not; those of other directions, such as a handrail seen from aside, agree with neither axis and are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.rotations import rotation_angle_rad, rotations
from elevator_rectify.core.types import Array, Image

_LARGEST_PX = 1000
# Where the ends of a segment are uncertain by so much, and what its direction is off besides.
_END_STD_PX, _DIRECTION_STD = 0.7, np.deg2rad(0.35)
# Edges further from an axis than this are others.
_AGREES_RAD = np.deg2rad(3.0)
_STEPS = 4
# What a pose is judged by: edges as long as this share of the picture, which run within the wider angle of an axis,
# should do so within the narrower one.
_LONG_SHARE, _NEAR_RAD, _UPRIGHT_RAD = 1 / 25, np.deg2rad(12.0), np.deg2rad(1.5)
_MOST_TURNED = 10.0


@dataclass(frozen=True)
class Segments:
    """Straight edges: normal (M, 3) of the plane through each and the camera, standard deviation (M,) of its angle."""

    normal: Array
    std_rad: Array


NO_SEGMENTS = Segments(np.zeros((0, 3)), np.zeros(0))


@dataclass(frozen=True)
class Photo:
    """A picture (height, width[, 3]) uint8 and its camera; its edges are found when they are first asked for."""

    image: Image
    camera: Camera

    @cached_property
    def segments(self) -> Segments:
        """Return the straight edges that are long enough to judge a pose by."""
        return segments_of(self.image, self.camera, _LONG_SHARE * max(self.image.shape[:2]))


def segments_of(image: Image, camera: Camera, shortest_px: float) -> Segments:
    """Return the straight edges of the image (OpenCV's line segment detector), their ends undistorted."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    scale = min(1.0, _LARGEST_PX / max(grey.shape))
    small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1.0 else grey
    lines = cv2.createLineSegmentDetector().detect(small)[0]
    if lines is None:
        return NO_SEGMENTS
    ends = (lines.reshape(-1, 2, 2).astype(float) + 0.5) / scale - 0.5
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    ends, length = ends[length > shortest_px], length[length > shortest_px]
    rays = camera.rays(ends.reshape(-1, 2)).reshape(-1, 2, 2)
    sound = np.isfinite(rays).all(axis=(1, 2))
    rays, length = rays[sound], length[sound]
    homogeneous = np.concatenate([rays, np.ones((len(rays), 2, 1))], axis=2)
    normal = np.cross(homogeneous[:, 0], homogeneous[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return Segments(normal, np.hypot(1.4 * _END_STD_PX / length, _DIRECTION_STD))


def agreement(segments: Segments, R: Array) -> tuple[Array, Array]:
    """Return the errors (M, 2) in radians of the segments from the panel's x and y axes, and their weights (M, 2).

    An edge counts for the axis that it is nearer to, if it agrees; R: (3, 3) panel to camera.
    """
    error = np.arcsin(np.clip(segments.normal @ R[:, :2], -1.0, 1.0))
    nearer = np.abs(error) <= np.abs(error[:, ::-1])
    tolerance = _AGREES_RAD + segments.std_rad[:, None]
    weight = nearer * np.maximum(0.0, 1.0 - (error / tolerance) ** 2) ** 2 / segments.std_rad[:, None] ** 2
    return error, np.asarray(weight)


def support(segments: Segments, R: Array) -> float:
    """Return how well the segments agree with the panel's axes, in nats above no agreement."""
    error, _ = agreement(segments, R)
    error = np.abs(error).min(axis=1)
    # Of edges that are not the panel's, any angle is as likely; half of the edges are the panel's.
    density = np.exp(-0.5 * (error / segments.std_rad) ** 2) / (np.sqrt(2.0 * np.pi) * segments.std_rad)
    return float(np.log(0.7 + 0.3 * density * np.pi / 4.0).sum())


def sharpened(R: Array, covariance: Array, segments: Segments) -> tuple[Array, Array]:
    """Return the rotation (3, 3) and its covariance (3, 3), camera axes, made more exact by the edges that agree."""
    prior, start = np.linalg.inv(covariance), R
    information = prior
    for _ in range(_STEPS):
        error, weight = agreement(segments, R)
        gradient = prior @ cv2.Rodrigues(start @ R.T)[0].ravel()
        information = prior.copy()
        for k in (0, 1):
            # d(l . exp(w) r) / dw = r x l.
            J = np.cross(R[:, k], segments.normal)
            information += (J * weight[:, k : k + 1]).T @ J
            gradient -= J.T @ (weight[:, k] * error[:, k])
        R = rotations(np.linalg.solve(information, gradient)[None])[0] @ R
    return R, np.asarray(np.linalg.inv(information))


def uprightness(segments: Segments, R: Array, covariance: Array) -> Array:
    """Return what the edges say of a rotation with its covariance (3, 3), as three numbers.

    The share of those near an axis that are along it, how far they turn it over its standard deviation, and ln of the
    standard deviation that they leave.
    """
    own = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
    if not len(segments.normal):
        return np.array([0.0, 0.0, np.log(own)])
    off = np.abs(agreement(segments, R)[0]).min(axis=1)
    share = float((off < _UPRIGHT_RAD).sum()) / max(1.0, float((off < _NEAR_RAD).sum()))
    better, left = sharpened(R, covariance, segments)
    turned = rotation_angle_rad(R.T @ better) / max(own, 0.003)
    return np.array([share, min(turned, _MOST_TURNED), 0.5 * np.log(np.linalg.eigvalsh(left)[-1])])
