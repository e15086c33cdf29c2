"""An outline model fitted to the edges in the picture, found along the outlines' normals (Harris and Stennett, "RAPID",
1990)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.rotations import rotations
from elevator_rectify.core.outline.shapes import (
    POINTS,
    Edges,
    OutlineModel,
    drawn,
    normals,
    shape_derivatives,
    strengths,
)
from elevator_rectify.core.types import Array

# Grey values per pixel: weaker edges are noise.
_WEAKEST = 2.0
_SEARCH_STEP_PX = 0.5
# Half widths of the search for edges, in shares of the button's half size, round by round.
SEARCHES = (0.2, 0.12, 0.07, 0.05, 0.05, 0.05)
_NARROWEST_PX, _WIDEST_PX = 1.5, 40.0
# Of a normalised ray, for the derivative of its pixel.
_DIFFERENCE = 1e-6
# Standard deviations of ln(width / height) of buttons that are meant to be square, and of the others.
_SQUARE_STD, _OBLONG_STD, _OBLONG_NATS = 0.03, 0.3, 3.0
# Of the rotation in the plane, against the camera's upright.
_UPRIGHT_STD = 0.2
_EDGE_STD_PX = 0.7
# Neighbouring points of an outline share their errors.
INDEPENDENT_SHARE = 0.25


@dataclass(frozen=True)
class OutlineFit:
    """A fitted model; cost in nats, the share of points that have an edge, the robust rms distance in pixels."""

    model: OutlineModel
    cost: float
    seen: float
    residual_px: float
    information: Array


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
        result = _stepped(model, edges.camera, outlines + offset[..., None] * normal, strength, normal)
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


def moved(model: OutlineModel, step: Array) -> OutlineModel:
    """Apply a step: tilt (2), centres (2 N), then ln radius, or ln half sizes (2), corner and turn in the plane."""
    number = model.centres.size
    turn = 0.0 if model.round else float(step[-1])
    R = model.R @ rotations(np.array([[step[0], step[1], turn]]))[0]
    centres = model.centres + step[2 : 2 + number].reshape(-1, 2)
    rest = step[2 + number :]
    half = model.half * np.exp(rest[0] if model.round else rest[:2])
    corner = model.corner if model.round else float(np.clip(model.corner + rest[2], 0.02, 1.0))
    return replace(model, R=R, centres=centres, half=half, corner=corner)


def _stepped(model: OutlineModel, camera: Camera, target: Array, strength: Array, normal: Array) -> OutlineFit:
    """Return the model after two Gauss-Newton steps towards the edges found, with what it costs then."""
    weight = strength / (strength + 4.0 * _WEAKEST) * (strength > _WEAKEST)
    for _ in range(2):
        error, J = system(model, camera, target, normal)
        robust = weight / (1.0 + (error / (2.0 * _EDGE_STD_PX)) ** 2)
        information, gradient = _normal_equations(model, error, J, robust)
        step = np.linalg.solve(information + np.diag(1e-9 + 1e-4 * np.diag(information)), gradient)
        step[:2] = np.clip(step[:2], -0.3, 0.3)
        model = moved(model, np.clip(step, -0.5, 0.5))
    error = _errors(drawn(model, camera), target, normal)
    seen = weight > 0
    # What is not seen costs as much as what is far off.
    cost = 0.5 * np.log1p((error / _EDGE_STD_PX) ** 2)
    total = INDEPENDENT_SHARE * float(np.where(seen, cost, np.log1p(9.0)).sum()) + _prior_cost(model)
    residual = 1.4826 * float(np.median(np.abs(error[seen]))) if seen.any() else np.inf
    return OutlineFit(model, total, float(seen.mean()), residual, information)


def _errors(outlines: Array, target: Array, normal: Array) -> Array:
    """Return how far (N, K) the edges are from the outlines along the normals; far off behind the camera."""
    return np.asarray(((target - np.nan_to_num(outlines, nan=1e4)) * normal).sum(axis=-1))


def system(model: OutlineModel, camera: Camera, target: Array, normal: Array) -> tuple[Array, Array]:
    """Return the errors (N, K) along the normals, and the derivatives (N, K, P) of what the model says instead, by the
    parameters of `moved`; 0 behind the camera."""
    shape, d_shape = shape_derivatives(model)
    plane = model.centres[:, None] + shape
    outlines, d_point = _seen(plane @ model.R[:, :2].T + model.origin, normal, camera)
    d_plane, d_normal = d_point @ model.R[:, :2], d_point @ model.R[:, 2]
    J = np.zeros((*d_normal.shape, model.parameters))
    J[..., 0], J[..., 1] = d_normal * plane[..., 1], -d_normal * plane[..., 0]
    button, first = np.arange(len(plane)), 2 + model.centres.size
    for axis in (0, 1):
        J[button, :, 2 + 2 * button + axis] = d_plane[..., axis]
    J[..., first : first + d_shape.shape[-1]] = np.einsum("nkc,kcs->nks", d_plane, d_shape)
    if not model.round:
        J[..., -1] = d_plane[..., 1] * plane[..., 0] - d_plane[..., 0] * plane[..., 1]
    return _errors(outlines, target, normal), np.nan_to_num(J)


def _seen(points: Array, normal: Array, camera: Camera) -> tuple[Array, Array]:
    """Return the pixels (N, K, 2) of points (N, K, 3), and the derivatives (N, K, 3) by the point of the pixel along
    the normal (N, K, 2); NaN behind the camera."""
    depth = np.where(points[..., 2:] > 0, points[..., 2:], np.nan)
    rays = points[..., :2] / depth
    near = rays + _DIFFERENCE * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])[:, None, None]
    at, *moved = camera.pixels(near).reshape(near.shape)
    d_ray = np.stack([((m - at) * normal).sum(axis=-1) for m in moved], axis=-1) / _DIFFERENCE
    d_depth = -(d_ray * rays).sum(axis=-1, keepdims=True)
    return at, np.concatenate([d_ray, d_depth], axis=-1) / depth


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
