"""From a taught panel's pose to the result that users get."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elevator_rectify.core.config import Config
from elevator_rectify.core.geometry.pose import LatticePose, in_unit, scale_pose_covariance
from elevator_rectify.core.known.matches import Scene
from elevator_rectify.core.lattice.layout import Layout, LayoutFit, evaluate, pose_at
from elevator_rectify.core.lattice.refinement import projected
from elevator_rectify.core.picture.fit import measured_pose, measurement_of, with_overlapping
from elevator_rectify.core.picture.measured import MeasuredFit
from elevator_rectify.core.result import failed_fit
from elevator_rectify.core.types import Array, FitResult, IntArray, KnownPanel, Measurement

# The gaps between blocks are known as the buttons' places are.
_BREAK_VARIANCE = 1e-10
_ORIGIN = np.zeros(2)


def by_boxes(fit: LayoutFit, scene: Scene) -> FitResult:
    """Return pose, covariance and grid of a fit to detections."""
    pose, covariance = pose_at(fit, scene.usable.rays, _ORIGIN, scene.config.joint)
    return _result(fit, pose, covariance * scene.config.accept.covariance_scale, scene)


def by_picture(measured: MeasuredFit, boxes: FitResult, scene: Scene) -> FitResult:
    """Return pose, covariance and grid of a fit to the picture; status and confidence are those of the boxes."""
    usable, joint = scene.usable, scene.config.joint
    pose, covariance = measured_pose(measured, _ORIGIN, scene.config)
    explained = evaluate(measured.fit.pose, measured.fit.layout, usable.rays, scene.sigma, scene.area, joint)
    found = _result(with_overlapping(explained, usable, measured), pose, covariance, scene)
    seen = measurement_of(measured, float(found.pitch[0]), scene.camera)
    shown = found.shown.copy()
    shown[measured.places.node[measured.places.seen]] = True
    return replace(
        found,
        status=boxes.status,
        reason=boxes.reason,
        confidence=boxes.confidence,
        margin_nats=boxes.margin_nats,
        measurement=_by_cell(seen, scene.known),
        shown=shown,
    )


def _by_cell(seen: Measurement, known: KnownPanel) -> Measurement:
    """Return what is seen of the K buttons (1, K) by their cells."""
    on = known.cells[:, 0] >= 0
    rows, columns = known.cells[on].T
    shape = len(known.row_positions), len(known.column_positions)
    parts = []
    for part in (seen.centre_px, seen.covariance_px2, seen.correlation):
        by_cell = np.full((*shape, *part.shape[2:]), np.nan)
        by_cell[rows, columns] = part[0, on]
        parts.append(by_cell)
    return replace(seen, centre_px=parts[0], covariance_px2=parts[1], correlation=parts[2])


def _result(fit: LayoutFit, pose: LatticePose, covariance: Array, scene: Scene) -> FitResult:
    """Return a fit's geometry in the user's unit; covariance: of (t, rotation, ln aspect) in column pitches."""
    usable, camera, config, known = scene.usable, scene.camera, scene.config, scene.known
    scale, std, metric = _unit(known, config)
    unit = scale * float(known.pitch[0])
    stretch = np.array([1.0, pose.aspect])
    lattice = Layout(
        known.row_positions,
        known.column_positions,
        known.row_staggered.astype(float),
        known.column_staggered.astype(float),
    )
    grid = lattice.nodes * known.pitch * scale * stretch
    points = grid @ pose.R[:, :2].T + pose.t * unit
    breaks = int(np.count_nonzero(np.diff(known.row_block)) + np.count_nonzero(np.diff(known.column_block)))
    shape_covariance = np.eye(7 + breaks) * _BREAK_VARIANCE
    shape_covariance[:7, :7] = covariance
    inlier = fit.inlier > 0.5
    matched = np.full(usable.number, -1, dtype=np.int64)
    matched[usable.index] = np.where(inlier, fit.node, -1)
    rays = np.full((usable.number, 2), np.nan)
    rays[usable.index] = usable.rays
    error = np.linalg.norm(usable.rays - projected(fit.pose, fit.layout.nodes)[0][0][fit.node], axis=1)[inlier]
    return replace(
        failed_fit("ok", "", usable, config),
        converged=True,
        metric=metric,
        R_camera_panel=pose.R,
        t_camera_panel=pose.t * unit,
        pitch=known.pitch * scale * stretch,
        covariance=scale_pose_covariance(covariance[:6, :6], pose.t, unit, std * unit),
        shape_covariance=in_unit(shape_covariance, unit),
        scale_std_share=std,
        cells=_cells(matched, known),
        rays=rays,
        rows=len(known.row_positions),
        columns=len(known.column_positions),
        row_positions=known.row_positions,
        column_positions=known.column_positions,
        row_staggered=known.row_staggered,
        column_staggered=known.column_staggered,
        row_block=known.row_block,
        column_block=known.column_block,
        grid_panel=grid,
        grid_points=points,
        grid_px=camera.project(points),
        rms_px=float(np.sqrt((error**2).mean())) * camera.focal_px if len(error) else np.nan,
        inliers=int(inlier.sum()),
        known=known,
        matched=matched,
        shown=np.isin(np.arange(len(known.labels)), matched),
        known_px=camera.project(known.places * scale * stretch @ pose.R[:, :2].T + pose.t * unit),
    )


def _cells(matched: IntArray, known: KnownPanel) -> IntArray:
    """Return (N, 2) the cell of each detection, -1 beside the lattice and for none."""
    return np.asarray(np.where(matched[:, None] >= 0, known.cells[matched], -1))


def _unit(known: KnownPanel, config: Config) -> tuple[float, float, bool]:
    """Return the user's unit over the panel's, its standard deviation over itself, and whether it is the metre."""
    pitch = config.scale.column_pitch_m
    if known.metric or pitch <= 0:
        return 1.0, known.scale_std_share, known.metric
    return pitch, config.scale.column_pitch_std_m / pitch, True
