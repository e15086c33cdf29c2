"""From an estimator's fit to the result that users get: pose, covariance, grid, status."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.confidence import (
    COEFFICIENTS,
    Evidence,
    confidence,
    features,
    logistic_confidence,
    refusal,
    rotation_std_rad,
)
from elevator_rectify.core.config import Config
from elevator_rectify.core.detections import Usable
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.pose import (
    LatticePose,
    in_unit,
    pose_covariance,
    pose_from_homography,
    residual_covariance_at,
    scale_pose_covariance,
)
from elevator_rectify.core.geometry.scale import neighbours_apart
from elevator_rectify.core.lattice.joint import JointFit
from elevator_rectify.core.lattice.layout import Layout, LayoutFit, pose_at
from elevator_rectify.core.lattice.refinement import ANNEALING, Poses
from elevator_rectify.core.lattice.sizes import contradiction
from elevator_rectify.core.lattice.spacing import undone_perspective
from elevator_rectify.core.paper.rounds import PaperFit
from elevator_rectify.core.types import Array, FitResult, FitT, IntArray

# A lattice of a finer pitch than so many standard deviations of the detections is near to every point.
_FINEST_PITCH_SIGMAS = 4.0
_MOST_IN_A_CELL = 1.5
# Buttons are larger than this, in pitches: lines do not come nearer, nor in another order.
_NEAREST_LINES = 0.3
# A place that is known less well, in pitches, may be the neighbour's.
_MOST_SIDEWAYS = 0.25


def failed_fit(status: str, reason: str, usable: Usable, config: Config) -> FitResult:
    """Return the result without a pose."""
    cells = np.full((usable.number, 2), -1, dtype=np.int64)
    return FitResult(status=status, reason=reason, method=config.method, cells=cells)


@dataclass(frozen=True)
class Geometry:
    """What an estimator found, in pitches of its columns.

    nodes: (rows, columns, 2) lattice coordinates (column, row) relative to cell (0, 0); cells: (M, 2) of the usable
    detections; covariance: of (t, rotation) and, as far as the method has them, of ln aspect and breaks; shown: (B,)
    further nodes where the picture shows a button.
    """

    pose: LatticePose
    nodes: Array
    cells: IntArray
    covariance: Array
    shown: IntArray | None = None


def paper_fit(fit: PaperFit, usable: Usable, camera: Camera, config: Config) -> FitResult:
    """Turn the paper's fit into a FitResult and decide its status."""
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
    cells, pose, size = _trimmed(fit.cells, pose_from_homography(fit.G))
    nodes = _lattice(int(size[0]), int(size[1]))
    if not (pose.camera_points(nodes)[..., 2] > 1e-6).all():
        return replace(found, status="no_lattice", reason="part of the fitted grid lies behind the camera")
    inlier = cells[:, 0] >= 0
    error = _errors(pose, nodes, cells, usable.rays)
    sigma = max(float(np.sqrt((error**2).mean() / 2.0)), config.noise.sigma_px / camera.focal_px)
    covariance = pose_covariance(cells[inlier][:, ::-1].astype(float), pose, np.ones(int(inlier.sum())), sigma)
    found = with_geometry(found, Geometry(pose, nodes, cells, covariance), usable, camera, config)
    evidence = _evidence(found, pose, nodes, cells, usable, covariance)
    refused = refusal(evidence, config.accept)
    status, reason = refused or ("ok", "")
    return replace(found, status=status, reason=reason, confidence=confidence(evidence, config.accept))


def joint_fit(fit: JointFit | None, usable: Usable, camera: Camera, sigma: float, config: Config) -> FitResult:
    """Turn the joint method's fit into a FitResult and decide its status."""
    if fit is None:
        return _no_lattice(usable, config)
    return decided(undecided(fit, usable, camera, sigma, config), fit, usable, camera, config)


def _no_lattice(usable: Usable, config: Config) -> FitResult:
    return failed_fit("no_lattice", "no lattice of two rows and two columns explains the detections", usable, config)


def undecided(fit: JointFit, usable: Usable, camera: Camera, sigma: float, config: Config) -> FitResult:
    """Return the geometry and the confidence of the joint method's fit, which is not accepted yet."""
    best = _layout_result(fit.best, _no_lattice(usable, config), usable, camera, config)
    score = logistic_confidence(features(fit.best, fit.margin, sigma, best, usable, camera), COEFFICIENTS)
    return replace(best, confidence=score, margin_nats=fit.margin)


def decided(best: FitResult, fit: JointFit, usable: Usable, camera: Camera, config: Config) -> FitResult:
    """Return an undecided result with its status."""
    if fit.other is not None and fit.margin < config.joint.ambiguity_nats:
        other = _layout_result(fit.other, _no_lattice(usable, config), usable, camera, config)
        reason = f"two poses explain the detections, {fit.margin:.2g} nats apart"
        return replace(best, status="ambiguous", reason=reason, alternatives=(other,))
    reason = contradiction(best, usable.index, usable.telling_sizes_px, camera)
    if reason:
        return replace(best, status="no_lattice", reason=reason)
    return judged(best, fit.best, camera, config, config.accept.min_confidence)


def judged(found: FitResult, fit: LayoutFit, camera: Camera, config: Config, least: float) -> FitResult:
    """Return the fit with its status, by its plausibility, covariance and confidence, of which `least` is needed."""
    implausible = _implausible(found, fit, camera)
    if implausible:
        return replace(found, status="no_lattice", reason=implausible)
    return known_well(found, config, least)


def known_well(found: FitT, config: Config, least: float) -> FitT:
    """Return the fit with its status, by its covariance and confidence, of which `least` is needed."""
    spread, limit = rotation_std_rad(found.covariance), config.accept.max_rotation_std_rad
    if spread > limit:
        reason = f"the rotation is known to {spread:.3f} rad only, {limit:g} allowed"
        return replace(found, status="uncertain", reason=reason)
    sideways = sideways_std(found)
    if sideways > _MOST_SIDEWAYS * float(found.pitch.min()):
        reason = f"the place is known to {sideways / float(found.pitch.min()):.2f} pitches sideways only"
        return replace(found, status="uncertain", reason=reason)
    if found.confidence < least:
        reason = f"confidence {found.confidence:.3f} < {least:g}"
        return replace(found, status="low_confidence", reason=reason)
    return replace(found, status="ok", reason="")


def sideways_std(found: FitResult) -> float:
    """Return the largest standard deviation across the line of sight of any filled cell, in the fit's unit.

    An error of the camera's calibration moves all cells alike: none is taken for its neighbour by it.
    """
    places = found.grid_panel[found.filled]
    point = places @ found.R_camera_panel[:, :2].T + found.t_camera_panel
    sight = point / np.linalg.norm(point, axis=1, keepdims=True)
    across = np.eye(3) - sight[:, :, None] * sight[:, None, :]
    covariance = across @ residual_covariance_at(found, places)[:, :3, :3] @ across
    if not np.isfinite(covariance).all():
        return float("inf")
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(covariance)[:, -1].max())))


def _implausible(found: FitResult, fit: LayoutFit, camera: Camera) -> str:
    """Return why the fit cannot be a panel: its cells are as small as the noise, hold none or several detections."""
    if not found.inliers:
        return "no detection lies on the lattice that the picture shows"
    steps = [np.linalg.norm(np.diff(found.grid_px, axis=axis), axis=2) for axis in (0, 1)]
    pitch_px, sigma_px = min(float(np.nanmedian(step)) for step in steps), fit.sigma * camera.focal_px
    if not pitch_px >= _FINEST_PITCH_SIGMAS * sigma_px:
        return f"a pitch of {pitch_px:.1f} px fits any detections that are known to {sigma_px:.1f} px"
    apart = min(np.diff(lines).min(initial=np.inf) for lines in (found.row_positions, found.column_positions))
    if not apart > _NEAREST_LINES:
        return f"two rows or columns are {apart:.2f} pitches apart, less than a button"
    on = fit.node[fit.inlier > 0.5]
    shared = len(on) / max(1, int(np.count_nonzero(np.bincount(on))))
    return f"{shared:.1f} detections in every filled cell" if shared > _MOST_IN_A_CELL else undone_perspective(found)


def _layout_result(fit: LayoutFit, found: FitResult, usable: Usable, camera: Camera, config: Config) -> FitResult:
    """Return the geometry of a fit to detections."""
    pose, covariance = pose_at(fit, usable.rays, fit.layout.nodes[0, 0], config.joint, log_sizes=usable.log_sizes)
    return layout_result(fit, pose, covariance * config.accept.covariance_scale, found, usable, camera, config)


def layout_result(
    fit: LayoutFit,
    pose: LatticePose,
    covariance: Array,
    found: FitResult,
    usable: Usable,
    camera: Camera,
    config: Config,
    shown: IntArray | None = None,
) -> FitResult:
    """Return the geometry of a layout fit; pose and covariance are those of its first node; shown (B,): the nodes where
    the picture shows a button."""
    layout = fit.layout
    origin = layout.nodes[0, 0]
    nodes = layout.nodes - origin
    found = with_geometry(found, Geometry(pose, nodes, fit.cells, covariance, shown), usable, camera, config)
    error = _errors(pose, nodes, fit.cells, usable.rays)
    depth = float(pose.t[2])
    return replace(
        found,
        converged=True,
        iterations=len(ANNEALING),
        # The paper's metric: mean squared distance in the corrected plane at the panel's depth.
        cost_x1000=float(1e3 * (error**2).sum() / max(1, len(usable.rays))) if depth > 0 else float("nan"),
        row_positions=layout.rows - layout.rows[0],
        column_positions=layout.columns - layout.columns[0],
        row_staggered=layout.row_stagger > 0.5,
        column_staggered=layout.column_stagger > 0.5,
        row_block=_blocks(len(layout.rows), layout.row_breaks),
        column_block=_blocks(len(layout.columns), layout.column_breaks),
    )


def layout_of(fit: FitResult) -> LayoutFit:
    """Return pose and layout of a result, as the start of the next frame's fit."""
    unit = float(fit.pitch[0])
    layout = Layout(
        fit.row_positions,
        fit.column_positions,
        fit.row_staggered.astype(float),
        fit.column_staggered.astype(float),
        tuple(int(k) + 1 for k in np.flatnonzero(np.diff(fit.row_block))),
        tuple(int(k) + 1 for k in np.flatnonzero(np.diff(fit.column_block))),
    )
    nodes = layout.nodes
    centre = nodes.reshape(-1, 2).mean(axis=0)
    aspect = float(fit.pitch[1]) / unit
    t = fit.t_camera_panel / unit + fit.R_camera_panel[:, :2] @ ((centre - nodes[0, 0]) * np.array([1.0, aspect]))
    pose = Poses(fit.R_camera_panel[None], t[None], np.array([np.log(aspect)]), centre[None], np.zeros(1))
    return LayoutFit(pose, layout, np.zeros(0, dtype=np.int64), np.zeros(0), 0.0, 0.0)


def _blocks(number: int, breaks: tuple[int, ...]) -> IntArray:
    """Return the block of each line."""
    return np.searchsorted(np.array(breaks, dtype=np.int64), np.arange(number), side="right").astype(np.int64)


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


def with_geometry(found: FitResult, geometry: Geometry, usable: Usable, camera: Camera, config: Config) -> FitResult:
    """Fill in pose, covariance and grid in the user's units."""
    metric = config.scale.column_pitch_m > 0
    pose, nodes, cells = geometry.pose, geometry.nodes, geometry.cells
    apart = neighbours_apart(nodes, cells, geometry.shown)
    unit = (config.scale.column_pitch_m if metric else 1.0) / apart
    std = config.scale.column_pitch_std_m / apart if metric else 0.0
    points = pose.camera_points(nodes) * unit
    all_cells = np.full((usable.number, 2), -1, dtype=np.int64)
    all_cells[usable.index] = cells
    rays = np.full((usable.number, 2), np.nan)
    # What the picture's border cuts off is somewhere else than its box: no button beside the grid.
    beside = cells[:, 0] < 0
    rays[usable.index] = np.where((beside & usable.cut_off(camera))[:, None], np.nan, usable.rays)
    error = _errors(pose, nodes, cells, usable.rays)
    rows, columns = nodes.shape[:2]
    return replace(
        found,
        metric=metric,
        R_camera_panel=pose.R,
        t_camera_panel=pose.t * unit,
        pitch=np.array([1.0, pose.aspect]) * unit,
        apart=apart,
        covariance=scale_pose_covariance(geometry.covariance[:6, :6], pose.t, unit, std),
        shape_covariance=in_unit(geometry.covariance, unit),
        scale_std_share=std / unit,
        cells=all_cells,
        rays=rays,
        rows=rows,
        columns=columns,
        row_positions=np.arange(rows, dtype=float),
        column_positions=np.arange(columns, dtype=float),
        row_staggered=np.zeros(rows, dtype=bool),
        column_staggered=np.zeros(columns, dtype=bool),
        row_block=np.zeros(rows, dtype=np.int64),
        column_block=np.zeros(columns, dtype=np.int64),
        grid_panel=nodes * np.array([1.0, pose.aspect]) * unit,
        grid_points=points,
        grid_px=camera.project(points),
        rms_px=float(np.sqrt((error**2).mean())) * camera.focal_px if len(error) else np.nan,
        inliers=len(error),
    )


def _errors(pose: LatticePose, nodes: Array, cells: IntArray, rays: Array) -> Array:
    """Return the distance of each inlier from its node, in normalised units."""
    inlier = cells[:, 0] >= 0
    points = pose.camera_points(nodes[cells[inlier, 0], cells[inlier, 1]])
    return np.asarray(np.linalg.norm(rays[inlier] - points[:, :2] / points[:, 2:], axis=1))


def _evidence(
    found: FitResult, pose: LatticePose, nodes: Array, cells: IntArray, usable: Usable, covariance: Array
) -> Evidence:
    """Return what speaks for the paper's fit."""
    inlier = cells[:, 0] >= 0
    depth = pose.camera_points(nodes[cells[inlier, 0], cells[inlier, 1]])[:, 2]
    pitches = _errors(pose, nodes, cells, usable.rays) * depth / min(1.0, pose.aspect)
    return Evidence(
        inlier_share=float(inlier.mean()),
        occupancy=len(np.unique(cells[inlier], axis=0)) / float(found.rows * found.columns),
        rms_pitch=float(np.sqrt((pitches**2).mean())),
        rotation_std_rad=rotation_std_rad(covariance),
    )
