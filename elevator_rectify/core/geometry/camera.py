"""Pinhole camera with the distortion models of sensor_msgs/CameraInfo: pixels to rays and back."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from elevator_rectify.core.types import Array

NO_DISTORTION = np.zeros(0)
# How many coefficients OpenCV takes for each model (REP-104 names).
COEFFICIENTS = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14), "equidistant": (4,)}
_NEWTON_STEPS = 4
# A pixel whose ray does not project back onto it lies where the distortion model cannot be inverted.
_ROUND_TRIP_PX = 0.1


def _as_modelled(distortion: Array, model: str) -> tuple[Array, str]:
    """Return coefficients and model of calibrations that are written in another model's length, but mean it.

    An equidistant lens without coefficients is no pinhole: r = f theta. plumb_bob with a tail of zeros, and the first
    five coefficients of rational_polynomial, are plumb_bob's five.
    """
    if model == "equidistant" and not distortion.any():
        return np.zeros(4), model
    if model == "plumb_bob" and len(distortion) > 5 and not distortion[5:].any():
        return distortion[:5], model
    if model == "rational_polynomial" and len(distortion) in (4, 5):
        return distortion, "plumb_bob"
    return distortion, model


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one camera image.

    matrix: (3, 3) K in pixels; distortion: (n,) coefficients, empty for none; model: the REP-104 name.
    """

    matrix: Array
    width: int
    height: int
    distortion: Array = field(default_factory=lambda: NO_DISTORTION)
    model: str = "plumb_bob"

    @classmethod
    def from_matrix(cls, K: Any, width: int, height: int, D: Any = (), distortion_model: str = "plumb_bob") -> Camera:
        """Build a camera, checking every number.

        K: (3, 3) in pixels. D: distortion coefficients, all zero or empty for none.
        Raises ValueError naming the field where the camera is uncalibrated or impossible.
        """
        matrix = np.array(K, dtype=float).reshape(3, 3)
        distortion = np.array(D, dtype=float).ravel()
        if not np.isfinite(matrix).all() or not np.isfinite(distortion).all():
            raise ValueError(
                f"camera: K and D must be finite, K = {matrix.ravel().tolist()}, D = {distortion.tolist()}"
            )
        if matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
            raise ValueError(f"camera: uncalibrated, focal lengths K[0], K[4] = {matrix[0, 0]:g}, {matrix[1, 1]:g}")
        if width <= 0 or height <= 0:
            raise ValueError(f"camera: width x height = {width} x {height}, must be positive")
        if matrix[1, 0] or (matrix[2] != (0.0, 0.0, 1.0)).any():
            form = "[fx s cx; 0 fy cy; 0 0 1]; is it transposed?"
            raise ValueError(f"camera: K = {matrix.ravel().tolist()} is not {form}")
        distortion, distortion_model = _as_modelled(distortion, distortion_model)
        if not distortion.any() and distortion_model != "equidistant":
            return cls(matrix, int(width), int(height))
        if len(distortion) not in COEFFICIENTS.get(distortion_model, ()):
            raise ValueError(
                f"camera: distortion_model '{distortion_model}' with {len(distortion)} coefficients is unknown"
            )
        return cls(matrix, int(width), int(height), distortion, distortion_model)

    @classmethod
    def centred(cls, width: int, height: int, focal_px: float) -> Camera:
        """Build a camera without distortion whose principal point is the middle of the picture.

        The middle of the corner pixel is (0, 0), as OpenCV counts: that of the picture is ((w - 1) / 2, (h - 1) / 2).
        """
        K = [[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1]]
        return cls.from_matrix(K, width, height)

    @property
    def focal_px(self) -> float:
        """Return the geometric mean of the two focal lengths."""
        return float(np.sqrt(self.matrix[0, 0] * self.matrix[1, 1]))

    @property
    def distorted(self) -> bool:
        """Tell whether pixels and rays are related by more than K."""
        return bool(self.distortion.size)

    def rays(self, points_px: Array) -> Array:
        """Return the (N, 2) normalised coordinates (x/z, y/z) of (N, 2) pixels; NaN where there is no ray."""
        points = np.asarray(points_px, dtype=float).reshape(-1, 2)
        if not self.distorted:
            x = np.linalg.solve(self.matrix, np.c_[points, np.ones(len(points))].T).T
            return np.asarray(x[:, :2] / x[:, 2:])
        if not len(points):
            return points
        undistort = cv2.fisheye.undistortPoints if self.model == "equidistant" else cv2.undistortPoints
        rays = np.array(undistort(points[:, None, :], self.matrix, self.distortion), dtype=float)[:, 0]
        rays = self._refined(rays, points)
        rays[~(np.linalg.norm(self.pixels(rays) - points, axis=1) < _ROUND_TRIP_PX)] = np.nan
        return rays

    def _refined(self, rays: Array, points_px: Array) -> Array:
        """Return the rays after a few Newton steps: OpenCV's own inversion stops early, and differs by version."""
        step = 1e-6
        for _ in range(_NEWTON_STEPS):
            at = self.pixels(rays)
            columns = [(self.pixels(rays + step * e) - at) / step for e in np.eye(2)]
            jacobian = np.stack(columns, axis=-1)
            sound = np.isfinite(jacobian).all(axis=(1, 2)) & (np.abs(np.linalg.det(jacobian)) > 1e-6)
            change = np.zeros_like(rays)
            change[sound] = np.linalg.solve(jacobian[sound], (points_px - at)[sound, :, None])[..., 0]
            rays = rays + np.clip(change, -0.1, 0.1)
        return rays

    def pixels(self, rays: Array) -> Array:
        """Return the (N, 2) distorted pixels of (N, 2) normalised coordinates."""
        rays = np.asarray(rays, dtype=float).reshape(-1, 2)
        if not self.distorted or not len(rays):
            return np.asarray(rays @ self.matrix[:2, :2].T + self.matrix[:2, 2])
        points = np.c_[rays, np.ones(len(rays))][:, None, :]
        project = cv2.fisheye.projectPoints if self.model == "equidistant" else cv2.projectPoints
        pixels, _ = project(points, np.zeros(3), np.zeros(3), self.matrix, self.distortion)
        return np.asarray(pixels, dtype=float).reshape(-1, 2)

    def project(self, points: Array) -> Array:
        """Return the pixels of points (..., 3) in the camera frame; NaN for those not in front of the camera."""
        depth = np.asarray(points)[..., 2:]
        rays = np.where(depth > 0, np.asarray(points)[..., :2] / np.where(depth > 0, depth, 1.0), np.nan)
        return self.pixels(rays).reshape(*rays.shape)
