"""The rectified view: the image of a camera with the same centre, turned to face the panel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from elevator_rectify.core.config import ViewConfig
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.types import Array, FitResult, Image

DEFAULT_VIEW = ViewConfig()


@dataclass(frozen=True)
class Rectification:
    """A fronto-parallel view: the image, its exact camera, and the homography from undistorted input pixels."""

    image: Image
    camera: Camera
    H_rectified_image: Array
    R_rectified_camera: Array


def rectify_image(image: Image, camera: Camera, fit: FitResult, config: ViewConfig = DEFAULT_VIEW) -> Rectification:
    """Return the fronto-parallel view of the fitted panel, resampled once.

    image: (height, width[, channels]) as taken, with the camera's distortion.
    Raises ValueError where the fit has no geometry or the image has another size than the camera.
    """
    if image.shape[:2] != (camera.height, camera.width):
        raise ValueError(f"image is {image.shape[1]} x {image.shape[0]}, its camera {camera.width} x {camera.height}")
    view = facing_camera(camera, fit, config)
    R_rectified_camera = fit.R_camera_panel.T
    H = view.matrix @ R_rectified_camera @ np.linalg.inv(camera.matrix)
    H = H / H[2, 2]
    size = (view.width, view.height)
    if not camera.distorted:
        return Rectification(cv2.warpPerspective(image, H, size, flags=cv2.INTER_LINEAR), view, H, R_rectified_camera)
    map_x, map_y = _sampling_map(camera, view, R_rectified_camera)
    warped = cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return Rectification(warped, view, H, R_rectified_camera)


def facing_camera(camera: Camera, fit: FitResult, config: ViewConfig = DEFAULT_VIEW) -> Camera:
    """Return the pinhole camera at the same centre that faces the panel and frames it.

    Its focal length keeps the pixel density of the input where the panel is seen best (the largest singular value of
    the map from panel to pixels over the grid), within the limits of `config`.
    """
    if not np.isfinite(fit.t_camera_panel).all() or not fit.grid_panel.size:
        raise ValueError(f"the fit has no geometry to rectify: {fit.status}")
    corners = _frame(fit, config.margin_pitch)
    depth = float((fit.R_camera_panel.T @ fit.t_camera_panel)[2])
    in_view = corners + (fit.R_camera_panel.T @ fit.t_camera_panel)[:2]
    extent = in_view[1] - in_view[0]
    most = config.max_share * camera.width * camera.height
    largest = min(config.max_size_px / float(extent.max()), float(np.sqrt(most / extent.prod())))
    density = min(_best_density(camera, fit), largest)
    width, height = (max(16, round(float(e) * density)) for e in extent)
    centre = (in_view[0] + in_view[1]) / 2.0
    principal = np.array([width - 1, height - 1]) / 2.0 - density * centre
    focal = density * depth
    matrix = np.array([[focal, 0.0, principal[0]], [0.0, focal, principal[1]], [0.0, 0.0, 1.0]])
    return Camera.from_matrix(matrix, width, height)


def _frame(fit: FitResult, margin_pitch: float) -> Array:
    """Return the two corners (2, 2) of the grid in the panel's plane, with the margin."""
    points = fit.grid_panel.reshape(-1, 2)
    margin = margin_pitch * float(fit.pitch.min())
    return np.array([points.min(axis=0) - margin, points.max(axis=0) + margin])


def _best_density(camera: Camera, fit: FitResult) -> float:
    """Return the most input pixels per unit of length on the panel, over the grid's cells that are in the image."""
    points = fit.grid_points.reshape(-1, 3)
    step = 1e-3 * float(fit.pitch.min())
    centre = camera.project(points)
    inside = ((centre >= 0) & (centre < [camera.width, camera.height])).all(axis=1)
    chosen = points[inside] if inside.any() else points
    moved = [(camera.project(chosen + s * step * fit.R_camera_panel[:, k])) for k in (0, 1) for s in (1, -1)]
    jacobians = np.stack([moved[0] - moved[1], moved[2] - moved[3]], axis=-1) / (2.0 * step)
    return float(np.linalg.norm(jacobians, ord=2, axis=(1, 2)).max())


def _sampling_map(camera: Camera, view: Camera, R_rectified_camera: Array) -> tuple[Array, Array]:
    """Return the input pixel (x, y) of every pixel of the view, through the distortion."""
    u, v = np.meshgrid(np.arange(view.width, dtype=float), np.arange(view.height, dtype=float))
    rays = np.stack(
        [(u - view.matrix[0, 2]) / view.matrix[0, 0], (v - view.matrix[1, 2]) / view.matrix[1, 1], np.ones_like(u)],
        axis=-1,
    )
    pixels = camera.project(rays @ R_rectified_camera)
    pixels = np.nan_to_num(pixels, nan=-1e4).astype(np.float32)
    return pixels[..., 0], pixels[..., 1]
