"""The camera's calibration from a panel that is seen from several sides.

Plane-based calibration (Zhang, "A Flexible New Technique for Camera Calibration", 2000) with what is unknown of a
panel, the ratio of its pitches and its gaps, estimated along; the normal equations are sparse (Hartley and Zisserman,
Appendix 6).

Parameters that all views share: ln of the focal length over camera_info's, ln(fy / fx), the first coefficient of
distortion, ln(row pitch / column pitch), and the gaps; every view has its own pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.types import Array, FitResult, IntArray

FEWEST_VIEWS, _FEWEST_BUTTONS = 3, 6
# Of the panel's own scatter, in column pitches, and what is no better known of a button in the picture, in pixels.
_SCATTER_PITCH, _LEAST_STD_PX = 0.003, 0.1
# Standard deviations of what is known before: of ln f, ln(fy / fx), the coefficient, ln aspect, a gap in pitches.
_PRIOR = (0.5, 0.05, 0.5, 0.4, 0.5)
_EXACT = 1e-7
_STEPS, _SETTLED, _HUBER = 25, 1e-6, 2.5
# A button is off alike in all views: on rendered panels the errors of the focal lengths and of the coefficient were so
# many times those that independent errors would leave.
_DEPENDENT_FOCAL, _DEPENDENT_K1 = 1.5, 3.5
# A focal length further off than this, and more than so many standard deviations, is worth a warning.
_WORTH, _SURE_STDS = 0.02, 3.0
_NEAR = 1e-5


@dataclass(frozen=True)
class Sighting:
    """One view of a panel: cells (M, 2) row and column, where they are in the picture (M, 2) with std_px (M,), and the
    pose (rotation vector and translation, in column pitches) from which the estimate starts."""

    cells: IntArray
    pixels: Array
    std_px: Array
    pose: Array


@dataclass(frozen=True)
class PanelShape:
    """Positions of rows (R,) and columns (C,) in pitches, what is staggered of them, and their blocks."""

    rows: Array
    columns: Array
    row_stagger: Array
    column_stagger: Array
    row_block: IntArray
    column_block: IntArray
    aspect: float

    @property
    def gaps(self) -> int:
        """Return how many gaps of unknown size there are."""
        return int(self.row_block[-1] + self.column_block[-1])

    def places(self, cells: IntArray, log_aspect: float, gaps: Array) -> Array:
        """Return the places (M, 3) of cells (M, 2) on the panel, in column pitches."""
        row, column = cells.T
        of_rows = np.append(0.0, np.cumsum(gaps[: self.row_block[-1]]))[self.row_block]
        of_columns = np.append(0.0, np.cumsum(gaps[self.row_block[-1] :]))[self.column_block]
        u = (self.columns + of_columns)[column] + 0.5 * self.row_stagger[row]
        v = (self.rows + of_rows)[row] + 0.5 * self.column_stagger[column]
        return np.column_stack([u, v * self.aspect * np.exp(log_aspect), np.zeros(len(cells))])


@dataclass(frozen=True)
class CameraEstimate:
    """The camera as the panel says, and how sure that is.

    focal_share: of its focal length over the given one; ratio: of fy / fx over the given one; k1: change of the first
    coefficient; each with its standard deviation, which is infinite where the views do not tell. rms_px: of the buttons
    before and after; residual_px: (M, 4) where all of them are and by how much they are off, after.
    """

    camera: Camera
    focal_share: float
    focal_std: float
    ratio: float
    ratio_std: float
    k1: float
    k1_std: float
    rms_px: tuple[float, float]
    residual_px: Array
    views: int

    @property
    def significant(self) -> bool:
        """Tell whether the given focal length is surely wrong, by an amount that matters."""
        off = abs(float(np.log(self.focal_share)))
        return off > max(_WORTH, _SURE_STDS * self.focal_std)

    def __str__(self) -> str:
        """Return the finding as it is logged."""
        return f"focal length {self.focal_share:.3f} +- {self.focal_std:.3f} of camera_info's, by {self.views} views"


def sighting_of(fit: FitResult) -> Sighting | None:
    """Return what an accepted fit with a picture says of the camera; None where too few buttons are seen in it."""
    seen = fit.measurement
    if not fit.ok or seen is None:
        return None
    shown = np.isfinite(seen.centre_px).all(axis=-1)
    if shown.sum() < _FEWEST_BUTTONS:
        return None
    cells = np.argwhere(shown)
    pitch_px = float(np.nanmedian(np.linalg.norm(np.diff(fit.grid_px, axis=1), axis=-1))) if fit.columns > 1 else 0.0
    variance = seen.covariance_px2[shown].trace(axis1=1, axis2=2) / 2.0
    std = np.sqrt(variance + (_SCATTER_PITCH * pitch_px) ** 2 + _LEAST_STD_PX**2)
    pose = np.concatenate([cv2.Rodrigues(fit.R_camera_panel)[0].ravel(), fit.t_camera_panel / float(fit.pitch[0])])
    return Sighting(cells, seen.centre_px[shown], std, pose)


def shape_of_panel(fit: FitResult) -> PanelShape:
    """Return the shape from which the estimate starts."""
    return PanelShape(
        fit.row_positions,
        fit.column_positions,
        fit.row_staggered.astype(float),
        fit.column_staggered.astype(float),
        fit.row_block,
        fit.column_block,
        float(fit.pitch[1] / fit.pitch[0]),
    )


def calibrated(
    sightings: Sequence[Sighting], shape: PanelShape, camera: Camera, pixel_ratio: bool = False
) -> CameraEstimate:
    """Return the camera that explains all sightings of one panel best. pixel_ratio: estimate fy / fx, too.

    Raises ValueError for fewer than three views.
    """
    if len(sightings) < FEWEST_VIEWS:
        raise ValueError(f"{len(sightings)} views, {FEWEST_VIEWS} needed")
    prior = np.array([*_PRIOR[:4], *[_PRIOR[4]] * shape.gaps])
    if not pixel_ratio:
        prior[1] = _EXACT
    shared, poses = np.zeros(len(prior)), np.array([s.pose for s in sightings])
    before = _rms(sightings, shape, camera, shared, _settled_poses(sightings, shape, camera, shared, poses))
    for _ in range(_STEPS):
        step, steps, _ = _newton_step(sightings, shape, camera, shared, poses, prior)
        shared, poses = shared + step, poses + steps
        if np.abs(step).max() < _SETTLED:
            break
    _, _, covariance = _newton_step(sightings, shape, camera, shared, poses, prior)
    residual = np.concatenate([_residual(s, shape, camera, shared, p) for s, p in zip(sightings, poses, strict=True)])
    weights = np.concatenate([s.std_px for s in sightings])
    freedom = max(1.0, 2.0 * len(residual) - 6.0 * len(sightings) - len(shared))
    chi2 = float(((residual / weights[:, None]) ** 2).sum()) / freedom
    std = np.sqrt(np.diag(covariance)[:3] * max(1.0, chi2)) * [_DEPENDENT_FOCAL, _DEPENDENT_FOCAL, _DEPENDENT_K1]
    at = np.concatenate([s.pixels for s in sightings])
    return CameraEstimate(
        camera=with_parameters(camera, shared),
        focal_share=float(np.exp(shared[0])),
        focal_std=float(std[0]),
        ratio=float(np.exp(shared[1])),
        ratio_std=float(std[1]) if pixel_ratio else float("inf"),
        k1=float(shared[2]),
        k1_std=float(std[2]),
        rms_px=(before, float(np.sqrt((residual**2).sum(axis=1).mean()))),
        residual_px=np.concatenate([at, residual], axis=1),
        views=len(sightings),
    )


def with_parameters(camera: Camera, shared: Array) -> Camera:
    """Return the camera with ln f, ln(fy / fx) and the first coefficient changed by shared[:3]."""
    K = camera.matrix.copy()
    K[0, 0] *= np.exp(shared[0] - 0.5 * shared[1])
    K[1, 1] *= np.exp(shared[0] + 0.5 * shared[1])
    D = camera.distortion.copy() if camera.distorted else np.zeros(5)
    D[0] += shared[2]
    return Camera(K, camera.width, camera.height, D, camera.model)


def _residual(s: Sighting, shape: PanelShape, camera: Camera, shared: Array, pose: Array) -> Array:
    """Return where the buttons are seen less where they should be (M, 2), in pixels."""
    places = shape.places(s.cells, float(shared[3]), shared[4:])
    points = places @ cv2.Rodrigues(pose[:3])[0].T + pose[3:]
    return s.pixels - with_parameters(camera, shared).project(points)


def _newton_step(
    sightings: Sequence[Sighting], shape: PanelShape, camera: Camera, shared: Array, poses: Array, prior: Array
) -> tuple[Array, Array, Array]:
    """Return the Gauss-Newton step of the shared parameters (P,) and of the poses (V, 6), and the covariance (P, P)."""
    normal, gradient = np.diag(prior**-2.0), -shared / prior**2
    own = []
    for s, pose in zip(sightings, poses, strict=True):
        error, J, weight = _linear(s, shape, camera, shared, pose)
        A, B = J[:, :6], J[:, 6:]
        U = (A * weight[:, None]).T @ A + 1e-9 * np.eye(6)
        W, a = (A * weight[:, None]).T @ B, A.T @ (weight * error)
        solved = np.linalg.solve(U, np.column_stack([W, a]))
        normal = normal + (B * weight[:, None]).T @ B - W.T @ solved[:, :-1]
        gradient = gradient + B.T @ (weight * error) - W.T @ solved[:, -1]
        own.append(solved)
    step = np.linalg.solve(normal, gradient)
    steps = np.array([s[:, -1] - s[:, :-1] @ step for s in own], dtype=float)
    return np.asarray(step, dtype=float), steps, np.asarray(np.linalg.inv(normal), dtype=float)


def _linear(s: Sighting, shape: PanelShape, camera: Camera, shared: Array, pose: Array) -> tuple[Array, Array, Array]:
    """Return error (2 M,), its Jacobian (2 M, 6 + P) of the prediction by differences, and weights (2 M,)."""
    error = _residual(s, shape, camera, shared, pose)
    columns = []
    for k in range(6 + len(shared)):
        at = np.concatenate([pose, shared])
        at[k] += _NEAR
        columns.append((error - _residual(s, shape, camera, at[6:], at[:6])).ravel() / _NEAR)
    distance = np.linalg.norm(error, axis=1) / s.std_px
    weight = np.minimum(1.0, _HUBER / np.maximum(distance, 1e-9)) / s.std_px**2
    return error.ravel(), np.column_stack(columns), np.repeat(weight, 2)


def _settled_poses(
    sightings: Sequence[Sighting], shape: PanelShape, camera: Camera, shared: Array, poses: Array
) -> Array:
    """Return the poses (V, 6) that fit best with the camera as it is given."""
    exact = np.full(len(shared), _EXACT)
    for _ in range(_STEPS):
        _, steps, _ = _newton_step(sightings, shape, camera, shared, poses, exact)
        poses = poses + steps
        if np.abs(steps).max() < _SETTLED:
            break
    return poses


def _rms(sightings: Sequence[Sighting], shape: PanelShape, camera: Camera, shared: Array, poses: Array) -> float:
    """Return the rms distance of the buttons from where they should be, in pixels."""
    errors = [_residual(s, shape, camera, shared, p) for s, p in zip(sightings, poses, strict=True)]
    return float(np.sqrt((np.concatenate(errors) ** 2).sum(axis=1).mean()))


def same_shape(one: FitResult, other: FitResult) -> bool:
    """Tell whether two fits have the same rows, columns, blocks and staggered lines, so that cells can be compared."""
    lines = ("row_staggered", "column_staggered", "row_block", "column_block")
    return (one.rows, one.columns) == (other.rows, other.columns) and all(
        bool(np.array_equal(getattr(one, name), getattr(other, name))) for name in lines
    )
