"""Outlines of a few buttons in one plane, circles and rounded rectangles, and the picture's edges along them.

The model is one plane (R, through a point at depth 1), one shape for all buttons (half sizes and corner radius), and a
centre for each.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.types import Array, Image

# Points on an outline.
POINTS = 48
_DIRECTIONS = np.column_stack([np.cos(a := np.linspace(0, 2 * np.pi, POINTS, endpoint=False)), np.sin(a)])
_BLUR_PX = 1.0
# Of ln size and corner, for the derivatives.
_DIFFERENCE = 1e-6
# Directions nearer to an axis than this meet only one side.
_NO_MEETING = 1e-12


@dataclass(frozen=True)
class Edges:
    """Derivatives (height, width) of the blurred grey image, from pixel `corner` on; and its camera."""

    gx: Image
    gy: Image
    corner: Array
    camera: Camera


@dataclass(frozen=True)
class OutlineModel:
    """R (3, 3), origin (3,) of the plane; centres (N, 2) in it; half (2,) sizes; corner radius over the smaller half.

    round: a circle, with one half size and no corner.
    """

    R: Array
    origin: Array
    centres: Array
    half: Array
    corner: float
    round: bool

    @property
    def parameters(self) -> int:
        """Return how many there are: two of the normal, the centres, one radius or sizes, corner and turn."""
        return 2 + self.centres.size + (1 if self.round else 4)


def edges_of(image: Image, boxes: Array, camera: Camera) -> Edges:
    """Return the image's derivatives around the boxes (N, 4) = x, y, width, height in px."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    margin = 0.6 * boxes[:, 2:].max()
    low = np.floor((boxes[:, :2] - boxes[:, 2:] / 2).min(axis=0) - margin).astype(int)
    high = np.ceil((boxes[:, :2] + boxes[:, 2:] / 2).max(axis=0) + margin).astype(int)
    low, high = np.maximum(low, 0), np.minimum(high, [camera.width, camera.height])
    part = cv2.GaussianBlur(grey[low[1] : high[1], low[0] : high[0]].astype(np.float32), (0, 0), _BLUR_PX)
    gx, gy = (cv2.Scharr(part, cv2.CV_32F, *d) / 32.0 for d in ((1, 0), (0, 1)))
    return Edges(gx, gy, low.astype(float), camera)


def shape_points(half: Array, corner: Array) -> Array:
    """Return points (..., POINTS, 2) of the outlines of rounded rectangles, in equal steps of angle.

    half: (..., 2) half sizes; corner: (...) radius over the smaller one.
    """
    direction = np.abs(_DIRECTIONS)
    radius = (corner * half.min(axis=-1))[..., None]
    # Where the ray from the centre meets the sides, or else the circle of the corner.
    t = (half[..., None, :] / np.maximum(direction, _NO_MEETING)).min(axis=-1)
    inner = half[..., None, :] - radius[..., None]
    rounded = (t[..., None] * direction > inner).all(axis=-1)
    along = (inner * direction).sum(axis=-1)
    root = np.sqrt(np.maximum(along**2 - (inner**2).sum(axis=-1) + radius**2, 0.0))
    return np.asarray(np.where(rounded, along + root, t)[..., None] * _DIRECTIONS)


def unit_shape(model: OutlineModel) -> Array:
    """Return the outline (POINTS, 2) of a model whose half sizes are 1."""
    return _DIRECTIONS if model.round else shape_points(np.ones(2), np.array(model.corner))


def shape_of(model: OutlineModel) -> Array:
    """Return the outline (POINTS, 2) around the centre."""
    return model.half[0] * _DIRECTIONS if model.round else shape_points(model.half, np.array(model.corner))


def shape_derivatives(model: OutlineModel) -> tuple[Array, Array]:
    """Return the outline (POINTS, 2) around the centre, and its derivatives (POINTS, 2, S) by ln radius, or by ln half
    sizes (2) and the corner."""
    if model.round:
        return shape_of(model), shape_of(model)[..., None]
    step = _DIFFERENCE * np.vstack([np.zeros(3), np.eye(3)])
    at, *near = shape_points(model.half * np.exp(step[:, :2]), model.corner + step[:, 2])
    return at, np.stack([(n - at) / _DIFFERENCE for n in near], axis=-1)


def drawn(model: OutlineModel, camera: Camera) -> Array:
    """Return the outlines (N, POINTS, 2) in pixels; NaN for points behind the camera."""
    plane = model.centres[:, None] + shape_of(model)
    return camera.project(plane @ model.R[:, :2].T + model.origin)


def normals(outlines: Array) -> Array:
    """Return the unit normals (..., POINTS, 2), outwards."""
    tangent = np.roll(outlines, -1, axis=-2) - np.roll(outlines, 1, axis=-2)
    normal = np.stack([tangent[..., 1], -tangent[..., 0]], axis=-1)
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9))


def strengths(edges: Edges, points: Array, normal: Array) -> Array:
    """Return the derivative along the normals at points (..., 2) px; 0 outside of the image."""
    at = np.nan_to_num(points - edges.corner, nan=-1e4).astype(np.float32)
    # OpenCV's pictures have fewer than 2^15 columns.
    flat = [np.ascontiguousarray(at[..., k].reshape(-1, at.shape[-2])) for k in (0, 1)]
    gx, gy = (
        cv2.remap(g, *flat, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT).reshape(points.shape[:-1])
        for g in (edges.gx, edges.gy)
    )
    return np.asarray(gx * normal[..., 0] + gy * normal[..., 1])
