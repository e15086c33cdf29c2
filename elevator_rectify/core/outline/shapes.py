"""Outlines of a few buttons in one plane: circles and rounded rectangles, fitted to the edges in the picture.

The model is one plane (R, through a point at depth 1), one shape for all buttons (half sizes and corner radius), and a
centre for each; the parameters are fitted to the edges found along the outlines' normals (Harris and Stennett's RAPID).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.rotations import rotations
from elevator_rectify.core.types import Array, Image

# Points on an outline.
POINTS = 48
_DIRECTIONS = np.column_stack([np.cos(a := np.linspace(0, 2 * np.pi, POINTS, endpoint=False)), np.sin(a)])
_BLUR_PX = 1.0
# Grey values per pixel: weaker edges are noise.
_WEAKEST = 2.0
_SEARCH_STEP_PX = 0.5
# Half widths of the search for edges, in shares of the button's half size, round by round.
SEARCHES = (0.2, 0.12, 0.07, 0.05, 0.05, 0.05)
_NARROWEST_PX, _WIDEST_PX = 1.5, 40.0
_DIFFERENCE = 1e-5
# Standard deviations of ln(width / height) of buttons that are meant to be square, and of the others.
_SQUARE_STD, _OBLONG_STD, _OBLONG_NATS = 0.03, 0.3, 3.0
# Of the rotation in the plane, against the camera's upright.
_UPRIGHT_STD = 0.2
_EDGE_STD_PX = 0.7
# Neighbouring points of an outline share their errors.
INDEPENDENT_SHARE = 0.25


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


@dataclass(frozen=True)
class OutlineFit:
    """A fitted model; cost in nats, the share of points that have an edge, the robust rms distance in pixels."""

    model: OutlineModel
    cost: float
    seen: float
    residual_px: float
    information: Array


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


def shape_points(half: Array, corner: float) -> Array:
    """Return points (POINTS, 2) of the outline of a rounded rectangle, in equal steps of angle."""
    radius = corner * float(half.min())
    t = np.full(POINTS, float(half.min()))
    # The signed distance is convex along a ray from the centre: Newton's method finds its root.
    for _ in range(6):
        q = np.abs(t[:, None] * _DIRECTIONS) - half + radius
        outside = np.maximum(q, 0.0)
        length = np.linalg.norm(outside, axis=1)
        distance = length + np.minimum(q.max(axis=1), 0.0) - radius
        towards = np.where(
            length[:, None] > 0, outside / np.maximum(length, 1e-12)[:, None], q == q.max(axis=1, keepdims=True)
        )
        t = t - distance / np.maximum((towards * np.abs(_DIRECTIONS)).sum(axis=1), 0.1)
    return np.asarray(t[:, None] * _DIRECTIONS)


def unit_shape(model: OutlineModel) -> Array:
    """Return the outline (POINTS, 2) of a model whose half sizes are 1."""
    return _DIRECTIONS if model.round else shape_points(np.ones(2), model.corner)


def drawn(model: OutlineModel, camera: Camera) -> Array:
    """Return the outlines (N, POINTS, 2) in pixels; NaN for points behind the camera."""
    half = np.full(2, model.half[0]) if model.round else model.half
    shape = half[0] * _DIRECTIONS if model.round else shape_points(half, model.corner)
    plane = model.centres[:, None] + shape
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


def fit_outlines(model: OutlineModel, edges: Edges) -> OutlineFit:
    """Fit the model to the edges near it, searched in ever narrower bands."""
    result = None
    for share in SEARCHES:
        outlines = drawn(model, edges.camera)
        if not np.isfinite(outlines).all():
            break
        normal = normals(outlines)
        size = 0.5 * float(np.sqrt(np.prod(np.ptp(outlines, axis=1), axis=1)).mean())
        offset, strength = _nearest_edges(
            edges, outlines, normal, float(np.clip(share * size, _NARROWEST_PX, _WIDEST_PX))
        )
        result = _stepped(model, edges.camera, offset, strength, normal)
        model = result.model
    if result is None:
        return OutlineFit(model, np.inf, 0.0, np.inf, np.zeros((model.parameters,) * 2))
    return result


def _nearest_edges(edges: Edges, outlines: Array, normal: Array, reach_px: float) -> tuple[Array, Array]:
    """Return distance along the normal (N, K) and strength (N, K) of the strongest edge, near ones preferred."""
    count = max(3, int(np.ceil(reach_px / _SEARCH_STEP_PX)))
    along = np.linspace(-reach_px, reach_px, 2 * count + 1)
    points = outlines[..., None, :] + along[:, None] * normal[..., None, :]
    profile = strengths(edges, points, normal[..., None, :])
    # A button is brighter or darker than what surrounds it: the inner edge of a dark ring is no outer edge.
    fading = np.exp(-0.5 * (along / reach_px) ** 2)
    sums = [(np.maximum(sign * profile, 0.0) * fading).max(axis=-1).sum(axis=-1) for sign in (1.0, -1.0)]
    profile = np.maximum(np.where(sums[0] >= sums[1], 1.0, -1.0)[:, None, None] * profile, 0.0)
    score = profile * fading
    best = np.clip(score.argmax(axis=-1), 1, 2 * count - 1)
    left, middle, right = (np.take_along_axis(profile, (best + d)[..., None], -1)[..., 0] for d in (-1, 0, 1))
    bend = left - 2.0 * middle + right
    sub = np.where(bend < -1e-6, 0.5 * (left - right) / np.where(bend < -1e-6, bend, 1.0), 0.0)
    return along[best] + np.clip(sub, -1.0, 1.0) * (along[1] - along[0]), middle


def _moved(model: OutlineModel, step: Array) -> OutlineModel:
    """Apply a step: tilt (2), centres (2 N), then ln radius, or ln half sizes (2), corner and turn in the plane."""
    number = model.centres.size
    turn = 0.0 if model.round else float(step[-1])
    R = model.R @ rotations(np.array([[step[0], step[1], turn]]))[0]
    centres = model.centres + step[2 : 2 + number].reshape(-1, 2)
    rest = step[2 + number :]
    half = model.half * np.exp(rest[0] if model.round else rest[:2])
    corner = model.corner if model.round else float(np.clip(model.corner + rest[2], 0.02, 1.0))
    return replace(model, R=R, centres=centres, half=half, corner=corner)


def _stepped(model: OutlineModel, camera: Camera, offset: Array, strength: Array, normal: Array) -> OutlineFit:
    """Return the model after two Gauss-Newton steps towards the edges found, with what it costs then."""
    start = drawn(model, camera)
    target = start + offset[..., None] * normal
    weight = strength / (strength + 4.0 * _WEAKEST) * (strength > _WEAKEST)
    for _ in range(2):
        error, J = _system(model, camera, target, normal)
        robust = weight / (1.0 + (error / (2.0 * _EDGE_STD_PX)) ** 2)
        information, gradient = _normal_equations(model, error, J, robust)
        step = np.linalg.solve(information + np.diag(1e-9 + 1e-4 * np.diag(information)), gradient)
        step[:2] = np.clip(step[:2], -0.3, 0.3)
        model = _moved(model, np.clip(step, -0.5, 0.5))
    error = _errors(model, camera, target, normal)
    seen = weight > 0
    # What is not seen costs as much as what is far off.
    cost = 0.5 * np.log1p((error / _EDGE_STD_PX) ** 2)
    total = INDEPENDENT_SHARE * float(np.where(seen, cost, np.log1p(9.0)).sum()) + _prior_cost(model)
    residual = 1.4826 * float(np.median(np.abs(error[seen]))) if seen.any() else np.inf
    return OutlineFit(model, total, float(seen.mean()), residual, information)


def _errors(model: OutlineModel, camera: Camera, target: Array, normal: Array) -> Array:
    return np.asarray(((target - np.nan_to_num(drawn(model, camera), nan=1e4)) * normal).sum(axis=-1))


def _system(model: OutlineModel, camera: Camera, target: Array, normal: Array) -> tuple[Array, Array]:
    """Return the errors (N, K) along the normals and their derivatives (N, K, P), by differences."""
    error = _errors(model, camera, target, normal)
    columns = [
        (error - _errors(_moved(model, d), camera, target, normal)) / _DIFFERENCE
        for d in _DIFFERENCE * np.eye(model.parameters)
    ]
    return error, np.stack(columns, axis=-1)


def _normal_equations(model: OutlineModel, error: Array, J: Array, weight: Array) -> tuple[Array, Array]:
    """Return J' W J and J' W e in nats, with the priors."""
    w = (INDEPENDENT_SHARE * weight / _EDGE_STD_PX**2).ravel()
    flat = J.reshape(-1, J.shape[-1])
    information, gradient = (flat * w[:, None]).T @ flat, flat.T @ (w * error.ravel())
    if not model.round:
        aspect, std = _aspect_prior(model)
        d = np.zeros(model.parameters)
        d[-4], d[-3] = 1.0, -1.0
        information += np.outer(d, d) / std**2
        gradient -= d * aspect / std**2
        information[-2, -2] += 4.0
        turn = np.arctan2(model.R[1, 0], model.R[0, 0])
        information[-1, -1] += _UPRIGHT_STD**-2
        gradient[-1] -= turn / _UPRIGHT_STD**2
    return np.asarray(information), np.asarray(gradient)


def _aspect_prior(model: OutlineModel) -> tuple[float, float]:
    """Return ln(width / height) and the standard deviation that it has by what it seems to be, square or oblong."""
    aspect = float(np.log(model.half[0] / model.half[1]))
    square = 0.5 * (aspect / _SQUARE_STD) ** 2 < _OBLONG_NATS + 0.5 * (aspect / _OBLONG_STD) ** 2
    return aspect, _SQUARE_STD if square else _OBLONG_STD


def _prior_cost(model: OutlineModel) -> float:
    if model.round:
        return 0.0
    aspect, std = _aspect_prior(model)
    turn = float(np.arctan2(model.R[1, 0], model.R[0, 0]))
    oblong = _OBLONG_NATS if std == _OBLONG_STD else 0.0
    return float(0.5 * (aspect / std) ** 2 + oblong + 0.5 * (turn / _UPRIGHT_STD) ** 2 + 1.5 * np.log(POINTS))
