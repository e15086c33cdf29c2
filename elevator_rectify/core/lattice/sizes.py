"""What the boxes' sizes say of a pose: on the panel buttons are of one size, so boxes shrink with the distance.

Centres alone do not tell a panel with gaps that is seen askew from a trapezoid that faces the camera. A line is fitted
to ln size over what the pose predicts of it: its slope is 1 where the pose is right, 0 where the panel faces the
camera.
"""

from __future__ import annotations

import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.pose import jacobians_px
from elevator_rectify.core.lattice.kernels import FARTHEST_SIZE, FEWEST_SIZES, MARGIN_SHARE, SIZE_STD, SLOPE_STD
from elevator_rectify.core.robust import median
from elevator_rectify.core.types import Array, FitResult, IntArray

FEATURES = ("sizes' slope off over std", "sizes' slope known", "ln sizes' scatter")
_ROUNDS = 4
# A detector's boxes are not known better, as a share.
_LEAST_SCATTER = 0.03
# On real panels no right fit had a slope that was surely less; ln(width / height) changed along the rows by less than
# this from end to end.
_LEAST_SLOPE, _FOLD, _SURE_STDS = 0.5, 0.35, 4.0
_MOST_STDS, _USUAL_SCATTER = 5.0, 0.05


def size_features(fit: FitResult, index: IntArray, sizes_px: Array, camera: Camera) -> Array:
    """Return (3,) what the sizes (M, 2) px of the detections `index` (M,) say of a fit to them, as FEATURES names it.

    Without sizes they say nothing: neither for the pose nor against it.
    """
    pairs = _expected_and_seen(fit, index, sizes_px, camera)
    if pairs is None:
        return np.array([0.0, 0.0, np.log(_USUAL_SCATTER)])
    expected, seen, _ = pairs
    slope, std, scatter = _line(expected.mean(axis=1), seen.mean(axis=1))
    std = float(np.hypot(std, SLOPE_STD))
    off = np.clip((slope - 1.0) / std, -_MOST_STDS, _MOST_STDS)
    return np.array([off, 1.0 / std, np.log(scatter)])


def contradiction(fit: FitResult, index: IntArray, sizes_px: Array, camera: Camera) -> str:
    """Return why boxes of these sizes are surely no panel in the fit's pose, '' where they may be one: a fan or a
    trapezoid that faces the camera, or two walls."""
    pairs = _expected_and_seen(fit, index, sizes_px, camera)
    if pairs is None:
        return ""
    expected, seen, places = pairs
    slope, std, _ = _line(expected.mean(axis=1), seen.mean(axis=1))
    if slope + 2.0 * std < _LEAST_SLOPE:
        return "the boxes' sizes do not change over the panel as the tilt would have it that their places ask for"
    across = places[:, 0] / fit.pitch[0]
    turn, std, _ = _line(across, (seen - expected) @ np.array([1.0, -1.0]))
    if abs(turn) * np.ptp(across) > _FOLD and abs(turn) > _SURE_STDS * std:
        return "the boxes grow narrower along the rows, as over a corner of two walls"
    return ""


def _expected_and_seen(
    fit: FitResult, index: IntArray, sizes_px: Array, camera: Camera
) -> tuple[Array, Array, Array] | None:
    """Return ln of width and height (K, 2) as the fit predicts them, but for a factor, and as seen, and the places
    (K, 2) on the panel; None for few."""
    on = (fit.cells[index, 0] >= 0) & (sizes_px > 0).all(axis=1)
    if on.sum() < FEWEST_SIZES or not np.isfinite(fit.grid_panel).all():
        return None
    cells = fit.cells[index[on]]
    places = fit.grid_panel[cells[:, 0], cells[:, 1]]
    expected = np.log(disc_sizes_px(fit, places, camera))
    known = np.isfinite(expected).all(axis=1)
    return (expected[known], np.log(sizes_px[on])[known], places[known]) if known.sum() >= FEWEST_SIZES else None


def size_nats(depth: Array, log_sizes: Array, inlier: Array) -> float:
    """Return the log likelihood of the boxes' sizes at depths (N,), less that of sizes which are as the pose predicts.

    log_sizes (N,): ln of the root of the boxes' area, in any unit, NaN for unknown; inlier (N,) in 0..1. A small part
    of a plane is seen with an area that falls with the cube of its depth.
    """
    on = (inlier > 0.5) & np.isfinite(log_sizes)
    if on.sum() < FEWEST_SIZES:
        return 0.0
    expected = -1.5 * np.log(depth[on])
    expected -= np.median(expected)
    off = log_sizes[on] - (1.0 - MARGIN_SHARE) * expected
    off -= np.median(off)
    variance = SIZE_STD**2 + (SLOPE_STD * expected) ** 2
    return -0.5 * float(np.minimum(off**2 / variance, FARTHEST_SIZE**2).sum())


def size_information(depth: Array, d_depth: Array, log_sizes: Array, inlier: Array) -> tuple[Array, Array]:
    """Return information (P, P) and gradient (P,) of what the sizes say of parameters on which the depths (N,) depend
    by d_depth (N, P): log_sizes = common + slope (-3/2) ln depth, common free and slope known to SLOPE_STD.
    """
    on = (inlier > 0.5) & np.isfinite(log_sizes)
    number = d_depth.shape[1]
    if on.sum() < FEWEST_SIZES:
        return np.zeros((number, number)), np.zeros(number)
    slope = 1.0 - MARGIN_SHARE
    expected = -1.5 * np.log(depth[on])
    expected -= expected.mean()
    off = log_sizes[on] - slope * expected
    off -= np.median(off)
    J = -1.5 * slope * d_depth[on] / depth[on, None]
    nuisance = np.column_stack([np.ones(int(on.sum())), expected])
    # Some buttons are larger than the others: what is far off counts little (Geman and McClure).
    weight = inlier[on] / (1.0 + (off / (FARTHEST_SIZE * SIZE_STD)) ** 2) ** 2 / SIZE_STD**2
    weighted, cross = J.T * weight, nuisance.T * weight
    own = cross @ nuisance + np.diag([0.0, SLOPE_STD**-2])
    share = np.linalg.solve(own, cross @ J).T
    return weighted @ J - share @ (cross @ J), weighted @ off - share @ (cross @ off)


def disc_sizes_px(fit: FitResult, places: Array, camera: Camera) -> Array:
    """Return width and height (K, 2) px of the upright boxes about small discs at places (K, 2) of the panel, all of
    one size; NaN behind the camera."""
    # The box about an ellipse J u, |u| = 1: half its width is the length of J's first row.
    return np.asarray(np.linalg.norm(jacobians_px(fit, places, camera), axis=2))


def _line(x: Array, y: Array) -> tuple[float, float, float]:
    """Return slope, its standard deviation and the scatter of a line through points (N,), robustly: some buttons are
    larger than the others."""
    weight = np.ones(len(x))
    for _ in range(_ROUNDS):
        total = float(weight.sum())
        dx, dy = x - float(weight @ x) / total, y - float(weight @ y) / total
        spread = max(float(weight @ dx**2), 1e-9)
        slope = float((weight * dx) @ dy) / spread
        residual = dy - slope * dx
        usual = max(1.4826 * float(median(np.abs(residual))), _LEAST_SCATTER)
        scatter = np.sqrt(float(weight @ residual**2) / max(1.0, total - 2.0) + _LEAST_SCATTER**2)
        weight = 1.0 / (1.0 + (residual / (2.0 * usual)) ** 2)
    return slope, float(scatter / np.sqrt(spread)), float(scatter)
