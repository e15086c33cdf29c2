"""The metric scale from an aligned depth image: one picture of a grid gives lengths in pitches only."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.config import ScaleConfig
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.pose import in_unit, scale_pose_covariance
from elevator_rectify.core.types import Array, FitResult, FitT, IntArray

# Places across the grid, per axis, at which the depth is read.
_PLACES = 24
_FEWEST = 24
# Depth cameras are off by about this share; caps stand out from the plate as much.
_SYSTEMATIC_SHARE = 0.01
_WIDEST_SPREAD = 0.1
_DISAGREEMENT_STDS = 4.0
# Columns of buttons are no nearer to each other than a finger's width, and no further apart than a hand.
_SMALLEST_PITCH_M, _LARGEST_PITCH_M = 0.01, 0.2
# Buttons are a column apart within this.
_ONE_APART = 0.1


@dataclass(frozen=True)
class Scale:
    """Metres per unit of a fit, with its standard deviation; NaN and the reason where it is not known."""

    metres: float
    std: float
    reason: str = ""

    @property
    def known(self) -> bool:
        """Tell whether there is a scale."""
        return bool(np.isfinite(self.metres))


def scale_from_depth(fit: FitResult, camera: Camera, depth_m: Array) -> Scale:
    """Return how many metres one unit of the fit is, by an aligned depth image (height, width), NaN where it has holes.

    The depth over the plane's own is the scale, at every place; the median resists holes, caps and a hand before them.
    """
    if depth_m.shape != (camera.height, camera.width):
        size = f"{depth_m.shape[1]} x {depth_m.shape[0]}"
        return _unknown(f"the depth image is {size}, not aligned to the image's {camera.width} x {camera.height}")
    low, high = fit.grid_panel.reshape(-1, 2).min(axis=0), fit.grid_panel.reshape(-1, 2).max(axis=0)
    share = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, _PLACES)] * 2), axis=-1).reshape(-1, 2)
    points = (low + share * (high - low)) @ fit.R_camera_panel[:, :2].T + fit.t_camera_panel
    pixels = np.nan_to_num(camera.project(points), nan=-1.0).round().astype(int)
    inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1) & (points[:, 2] > 0)
    ratios = depth_m[pixels[inside, 1], pixels[inside, 0]] / points[inside, 2]
    ratios = ratios[np.isfinite(ratios)]
    if len(ratios) < _FEWEST:
        return _unknown(f"the depth image has {len(ratios)} readings on the panel, {_FEWEST} needed")
    metres = float(np.median(ratios))
    spread = 1.4826 * float(np.median(np.abs(ratios - metres))) / metres
    if spread > _WIDEST_SPREAD:
        return _unknown(f"the depth image does not show the fitted plane: it deviates by {spread:.0%}")
    if not _SMALLEST_PITCH_M <= metres <= _LARGEST_PITCH_M:
        return _unknown(f"a column pitch of {metres:.4g} m by the depth is no panel's: is the depth in another unit?")
    return Scale(metres, metres * float(np.hypot(_SYSTEMATIC_SHARE, spread / np.sqrt(len(ratios)))))


def neighbours_apart(nodes: Array, cells: IntArray, shown: IntArray | None = None) -> float:
    """Return how many columns of the lattice neighbouring buttons of a row are apart; 1 where no row has two.

    nodes: (R, C, 2) lattice coordinates (column, row); cells: (N, 2) row and column of the detections, -1 beside the
    lattice; shown: (B,) further nodes with a button. A single column of floors above the middle of a pair of controls,
    as one real panel in fifteen has it, is a lattice of half the pairs' distance; that is no pitch of columns.
    """
    rows, columns = nodes.shape[:2]
    filled = np.zeros((rows, columns), dtype=bool)
    if shown is not None:
        filled.ravel()[shown] = True
    row, column = cells[cells[:, 0] >= 0].T
    filled[row, column] = True
    row, column = np.nonzero(filled)
    apart = np.diff(nodes[row, column, 0])[np.diff(row) == 0]
    if not len(apart) or (np.abs(apart - 1.0) < _ONE_APART).any():
        return 1.0
    return float(apart.min())


def _unknown(reason: str) -> Scale:
    return Scale(float("nan"), float("nan"), reason)


def with_scale(fit: FitT, camera: Camera, depth_m: Array, config: ScaleConfig) -> tuple[FitT, str]:
    """Return the fit (in pitches) with a metric scale, and where that is from: depth, column pitch or both.

    Where the two contradict each other, the scale is unknown, and the text says why.
    """
    depth = scale_from_depth(fit, camera, depth_m)
    pitch, pitch_std = config.column_pitch_m, max(config.column_pitch_std_m, 1e-9)
    if pitch <= 0:
        if depth.known:
            return scaled(fit, depth.metres, depth.std), "depth"
        return fit, f"unknown: {depth.reason}"
    if not depth.known:
        return scaled(fit, pitch, pitch_std), f"column pitch: {depth.reason}"
    if abs(depth.metres - pitch) > _DISAGREEMENT_STDS * float(np.hypot(depth.std, pitch_std)):
        return fit, f"unknown: the column pitch is {depth.metres:.4f} m by the depth, {pitch:.4f} m by the parameter"
    weights = np.array([depth.std, pitch_std]) ** -2.0
    metres = float(weights @ [depth.metres, pitch] / weights.sum())
    return scaled(fit, metres, float(weights.sum() ** -0.5)), "column pitch and depth"


def scaled(fit: FitT, metres: float, std: float) -> FitT:
    """Return the fit, in pitches, in metres: one pitch is `metres`, with standard deviation `std`."""
    return replace(
        resized(fit, metres),
        metric=True,
        covariance=scale_pose_covariance(fit.covariance, fit.t_camera_panel, metres, std),
        scale_std_share=std / metres,
    )


def resized(fit: FitT, factor: float) -> FitT:
    """Return the fit with all lengths multiplied by a factor."""
    seen = fit.measurement
    response = fit.common_response.copy()
    response[:3] *= factor
    return replace(
        fit,
        measurement=None if seen is None else replace(seen, half_size=seen.half_size * factor),
        t_camera_panel=fit.t_camera_panel * factor,
        pitch=fit.pitch * factor,
        covariance=in_unit(fit.covariance, factor),
        shape_covariance=in_unit(fit.shape_covariance, factor),
        common_response=response,
        grid_panel=fit.grid_panel * factor,
        grid_points=fit.grid_points * factor,
    )


def as_far_apart(fit: FitT, before: FitResult) -> FitT:
    """Return the fit of the same lattice by the neighbours that the frame before showed, where this one shows none as
    near: they are hidden now."""
    if (fit.rows, fit.columns) != (before.rows, before.columns) or not fit.apart > before.apart:
        return fit
    return replace(resized(fit, fit.apart / before.apart), apart=before.apart)
