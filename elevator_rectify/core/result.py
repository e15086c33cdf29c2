"""From an estimator's map of the lattice to the result that users get: pose, covariance, grid, status."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.camera import Camera
from elevator_rectify.core.confidence import Evidence, confidence, refusal
from elevator_rectify.core.config import Config
from elevator_rectify.core.detections import Usable
from elevator_rectify.core.paper import PaperFit
from elevator_rectify.core.pose import LatticePose, pose_covariance, pose_from_homography, scale_pose_covariance
from elevator_rectify.core.types import Array, GridFit, IntArray


def failed_fit(status: str, reason: str, usable: Usable, config: Config) -> GridFit:
    """Return the result without a pose."""
    cells = np.full((usable.number, 2), -1, dtype=np.int64)
    return GridFit(status=status, reason=reason, method=config.method, cells=cells)


@dataclass(frozen=True)
class _Residuals:
    rms_px: float
    rms_pitch: float
    on_grid: IntArray


def grid_fit(fit: PaperFit, usable: Usable, camera: Camera, config: Config) -> GridFit:
    """Turn the paper's fit into a GridFit and decide its status."""
    found = replace(
        failed_fit("ok", "", usable, config),
        iterations=fit.iterations,
        converged=fit.converged,
        cost_x1000=1e3 * fit.cost,
    )
    if not fit.converged or not np.isfinite(fit.G).all():
        return replace(found, status="not_converged", reason="the rounds of grid fit and motion did not settle")
    rows, columns = (len(np.unique(fit.cells[fit.cells[:, 0] >= 0, k])) for k in (0, 1))
    if rows < 2 or columns < 2:
        return replace(found, status="collinear", reason=f"{rows} row(s) x {columns} column(s) do not determine a pose")
    pose = pose_from_homography(fit.G)
    cells, pose, size = _trimmed(fit.cells, pose)
    shape = (int(size[0]), int(size[1]))
    if not (pose.camera_points(_lattice(*shape))[..., 2] > 1e-6).all():
        return replace(found, status="no_lattice", reason="part of the fitted grid lies behind the camera")
    return _with_geometry(found, pose, cells, shape, usable, camera, config)


def _trimmed(cells: IntArray, pose: LatticePose) -> tuple[IntArray, LatticePose, IntArray]:
    """Drop outer rows and columns that no inlier fills: cells are relative, (0, 0) is the first seen."""
    inlier = cells[:, 0] >= 0
    low, high = cells[inlier].min(axis=0), cells[inlier].max(axis=0)
    moved = np.where(inlier[:, None], cells - low, -1)
    origin = pose.camera_points(low[::-1].astype(float))
    return moved, replace(pose, t=origin), high - low + 1


def _lattice(rows: int, columns: int) -> Array:
    """Return (rows, columns, 2) lattice coordinates (column, row)."""
    j, i = np.meshgrid(np.arange(columns, dtype=float), np.arange(rows, dtype=float))
    return np.stack([j, i], axis=-1)


def _with_geometry(
    found: GridFit,
    pose: LatticePose,
    cells: IntArray,
    shape: tuple[int, int],
    usable: Usable,
    camera: Camera,
    config: Config,
) -> GridFit:
    """Fill in pose, covariance and grid in the user's units, and refuse what misses a limit."""
    metric = config.scale.column_pitch_m > 0
    unit = config.scale.column_pitch_m if metric else 1.0
    residuals = _residuals(pose, cells, usable.rays)
    inlier = cells[:, 0] >= 0
    sigma = max(residuals.rms_px / np.sqrt(2.0), config.noise.sigma_px / camera.focal_px)
    covariance = pose_covariance(cells[inlier][:, ::-1].astype(float), pose, np.ones(int(inlier.sum())), sigma)
    std = config.scale.column_pitch_std_m if metric else 0.0
    lattice = _lattice(*shape)
    points = pose.camera_points(lattice) * unit
    all_cells = np.full((usable.number, 2), -1, dtype=np.int64)
    all_cells[usable.index] = cells
    evidence = Evidence(
        inlier_share=float(inlier.mean()),
        occupancy=len(np.unique(cells[inlier], axis=0)) / float(np.prod(shape)),
        rms_pitch=residuals.rms_pitch,
        rotation_std_rad=float(np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:])[-1]))
        if np.isfinite(covariance).all()
        else np.inf,
    )
    refused = refusal(evidence, config.accept)
    return replace(
        found,
        status=refused[0] if refused else "ok",
        reason=refused[1] if refused else "",
        confidence=confidence(evidence, config.accept),
        metric=metric,
        R_camera_panel=pose.R,
        t_camera_panel=pose.t * unit,
        pitch=np.array([1.0, pose.aspect]) * unit,
        covariance=scale_pose_covariance(covariance, pose.t, unit, std),
        cells=all_cells,
        rows=shape[0],
        columns=shape[1],
        grid_panel=lattice * np.array([1.0, pose.aspect]) * unit,
        grid_points=points,
        grid_px=camera.project(points),
        rms_px=residuals.rms_px * camera.focal_px,
        inliers=int(inlier.sum()),
    )


def _residuals(pose: LatticePose, cells: IntArray, rays: Array) -> _Residuals:
    """Return the rms distance of the inliers from their grid centres, in normalised units and in local pitches."""
    inlier = cells[:, 0] >= 0
    at = cells[inlier][:, ::-1].astype(float)
    points = pose.camera_points(at)
    centres = points[:, :2] / points[:, 2:]
    error = np.linalg.norm(rays[inlier] - centres, axis=1)
    pitch = min(1.0, pose.aspect) / points[:, 2]
    return _Residuals(
        float(np.sqrt((error**2).mean())), float(np.sqrt(((error / pitch) ** 2).mean())), np.flatnonzero(inlier)
    )
