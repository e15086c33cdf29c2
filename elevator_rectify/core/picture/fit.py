"""The picture's say: it sharpens the fit to the boxes, settles what they leave open, or refuses it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from elevator_rectify.core.confidence import logistic_confidence, rotation_std_rad
from elevator_rectify.core.config import Config
from elevator_rectify.core.detections import Usable
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.pose import LatticePose
from elevator_rectify.core.geometry.rotations import rotation_angle_rad
from elevator_rectify.core.lattice import sizes
from elevator_rectify.core.lattice.joint import JointFit
from elevator_rectify.core.lattice.layout import LayoutFit, evaluate, pose_at
from elevator_rectify.core.lattice.refinement import jacobians, projected
from elevator_rectify.core.picture.measured import STAGES, MeasuredFit, measure
from elevator_rectify.core.picture.straight_edges import Photo, sharpened, uprightness
from elevator_rectify.core.picture.widening import widened
from elevator_rectify.core.result import judged, layout_result
from elevator_rectify.core.track import posed
from elevator_rectify.core.types import Array, FitResult, Measurement

# Written by `python3 -m elevator_rectify calibrate --pictures`.
COEFFICIENTS = Path(__file__).with_name("confidence.json")
FEATURES = (
    "ln seen",
    "seen share",
    "inlier share",
    "filled share",
    "median correlation",
    "least correlation",
    "ln residual",
    "ln rotation std",
    "turned over std",
    "boxes' logit",
    "margin",
    "tilt",
    "two lines",
    "few seen",
    "free lines a button",
    "ln boxes' distance over std",
    "ln boxes' common distance over std",
    "upright edges' share",
    "edges' turn over std",
    "ln rotation std with edges",
    *sizes.FEATURES,
)
# Poses with a margin below are all measured.
_COMPARED_NATS = 10.0
_TRACKED_STAGES = STAGES[1:]
_MARGIN_NATS = 15.0
# By so much of a button's size the template's centre is off the buttons' (rms on rendered panels, each axis).
_COMMON_SHIFT = 0.015
# Caps stand out of the plate by up to a tenth of their size: rms.
_CAP_HEIGHT = 0.05
# Fits whose rotation is known no better than this are turned to the picture's straight edges.
_WEAK_RAD = np.deg2rad(2.0)
# Two edges of one seam, or edges that nearly run along the panel, do not err independently: on real panels the rotation
# was off by so many times what independent ones would leave.
_DEPENDENT = 2.5
# A detection whose centre is so near to a button's, in half sizes, is of that button.
_ON_BUTTON = 0.9


@dataclass(frozen=True)
class PictureFit:
    """The best fit to the picture, as measured and as a result; the same of the other pose, where there is one, and the
    margin between them in nats."""

    measured: MeasuredFit
    result: FitResult
    other: FitResult | None
    other_measured: MeasuredFit | None
    margin: float


def with_picture(
    fit: JointFit,
    boxes: FitResult,
    usable: Usable,
    sigma: float,
    photo: Photo,
    config: Config,
    last: Measurement | None = None,
) -> FitResult:
    """Return the fit to the picture; `boxes`, the fit to the detections, where the picture does not show the buttons.

    sigma: of the detections in normalised units; last: of the measured fit that this one follows, which needs less.
    """
    found = picture_fit(fit, boxes, usable, sigma, photo, config, last)
    if found is None:
        return boxes
    found, score = _surer(found, boxes, usable, sigma, photo.camera, config)
    result = replace(found.result, confidence=score, margin_nats=found.margin)
    if found.other is not None and max(found.margin, fit.margin) < config.joint.ambiguity_nats:
        reason = f"two poses explain the picture, {found.margin:.2g} nats apart"
        return replace(result, status="ambiguous", reason=reason, alternatives=(found.other,))
    least = config.measurement.min_confidence
    return judged(replace(result, alternatives=()), found.measured.fit, photo.camera, config, least)


def _surer(
    found: PictureFit, boxes: FitResult, usable: Usable, sigma: float, camera: Camera, config: Config
) -> tuple[PictureFit, float]:
    """Return the fit, or the other pose where that is surely right and this one surely wrong, and its confidence.

    Likelihoods count how many places look alike and how near they are to the lattice; the confidence knows too how
    panels are filled, and how their edges run.
    """
    score = logistic_confidence(picture_features(found, boxes, usable, sigma, camera), COEFFICIENTS)
    if found.other is None or found.other_measured is None:
        return found, score
    other = PictureFit(found.other_measured, found.other, found.result, found.measured, 0.0)
    its = logistic_confidence(picture_features(other, boxes, usable, sigma, camera), COEFFICIENTS)
    odds = np.clip([its, score], 1e-6, 1.0 - 1e-6)
    nats = float(np.subtract(*np.log(odds / (1.0 - odds))))
    return (replace(other, margin=nats), its) if nats > config.joint.ambiguity_nats else (found, score)


def picture_fit(
    fit: JointFit,
    boxes: FitResult,
    usable: Usable,
    sigma: float,
    photo: Photo,
    config: Config,
    last: Measurement | None = None,
) -> PictureFit | None:
    """Return the fit to the picture, None where it does not show enough of the buttons."""
    image, camera = photo.image, photo.camera
    candidates = [fit.best] + ([fit.other] if fit.other is not None and fit.margin < _COMPARED_NATS else [])
    stages = STAGES if last is None else _TRACKED_STAGES
    found = [measure(c, usable.rays, usable.sizes_px, sigma, image, camera, config, stages) for c in candidates]
    measured = sorted((m for m in found if m is not None and _shown(m, config)), key=_misfit)
    if not measured:
        return None
    wide = measured if last is not None else [widened(m, config) for m in measured]
    results = [_result(m, boxes, usable, camera, sigma, config) for m in wide]
    results = [_with_edges(_judged_by_edges(r, photo, last), photo, config) for r in results]
    if len(measured) == 1:
        return PictureFit(measured[0], results[0], None, None, np.inf)
    return PictureFit(measured[0], results[0], results[1], measured[1], _misfit(measured[1]) - _misfit(measured[0]))


def _shown(measured: MeasuredFit, config: Config) -> bool:
    """Tell whether the picture shows enough of the detected buttons."""
    return float(measured.places.seen[measured.places.detected].mean()) >= config.measurement.min_seen_share


def _misfit(measured: MeasuredFit) -> float:
    """Return the negative log likelihood of the seen places, by their own residual."""
    seen = float(measured.places.seen.sum())
    return 2.0 * seen * float(np.log(max(measured.residual, 1e-4))) - 5.0 * seen


def _result(
    measured: MeasuredFit, boxes: FitResult, usable: Usable, camera: Camera, sigma: float, config: Config
) -> FitResult:
    """Return pose, covariance, grid and measurement."""
    fit, joint = measured.fit, config.joint
    pose, covariance = measured_pose(measured, fit.layout.nodes[0, 0], config)
    area = camera.width * camera.height / camera.focal_px**2
    explained = with_overlapping(evaluate(fit.pose, fit.layout, usable.rays, sigma, area, joint), usable, measured)
    shown = measured.places.node[measured.places.seen]
    result = layout_result(explained, pose, covariance, boxes, usable, camera, config, shown)
    return replace(result, measurement=measurement_of(measured, float(result.pitch[0]), camera))


def measured_pose(measured: MeasuredFit, origin: Array, config: Config) -> tuple[LatticePose, Array]:
    """Return the pose at a lattice point (2,) before every break, and its covariance as `pose_at` orders it."""
    pose, covariance = pose_at(measured.fit, measured.rays, origin, config.joint, measured.information)
    covariance = covariance * config.measurement.covariance_scale
    # What is taken for the middle of one button is so of all, and so is the height of their caps above the plate.
    size = 2.0 * measured.half * np.array([1.0, pose.aspect])
    common = pose.R * np.array([*(_COMMON_SHIFT * size), _CAP_HEIGHT * float(np.sqrt(size.prod()))])
    covariance[:3, :3] += common @ common.T
    return pose, covariance


def _judged_by_edges(fit: FitResult, photo: Photo, last: Measurement | None) -> FitResult:
    """Return the fit with what the picture's edges say of its pose, which stays from frame to frame."""
    if fit.measurement is None or not np.isfinite(fit.covariance).all():
        return fit
    if last is not None and np.isfinite(last.uprightness).all():
        said = last.uprightness
    else:
        said = uprightness(photo.segments, fit.R_camera_panel, fit.covariance[3:, 3:])
    return replace(fit, measurement=replace(fit.measurement, uprightness=said))


def _with_edges(fit: FitResult, photo: Photo, config: Config) -> FitResult:
    """Return the fit turned about its grid's centre as the straight edges that agree with it say, if it is weak itself
    (a column of floors with some controls), or if that is asked for."""
    known = np.isfinite(fit.covariance).all()
    if not known or not (config.measurement.edges or rotation_std_rad(fit.covariance) > _WEAK_RAD):
        return fit
    segments = replace(photo.segments, std_rad=_DEPENDENT * photo.segments.std_rad)
    if not len(segments.normal):
        return fit
    R, covariance = sharpened(fit.R_camera_panel, fit.covariance[3:, 3:], segments)
    centre = fit.grid_panel.mean(axis=(0, 1))
    t = fit.t_camera_panel + (fit.R_camera_panel - R)[:, :2] @ centre
    turned = posed(fit, R, t, photo.camera)
    # What place and shape owe to the rotation shrinks with it.
    return replace(
        turned,
        covariance=_with_rotation(fit.covariance, covariance),
        shape_covariance=_with_rotation(fit.shape_covariance, covariance),
    )


def _with_rotation(whole: Array, rotation: Array) -> Array:
    """Return the covariance of the pose (6 + S, 6 + S) where that of its rotation (3, 3) has become known better."""
    share = np.linalg.solve(whole[3:6, 3:6], whole[3:6]).T
    return np.asarray(whole - share @ (whole[3:6, 3:6] - rotation) @ share.T)


def with_overlapping(fit: LayoutFit, usable: Usable, measured: MeasuredFit) -> LayoutFit:
    """Return the fit with every detection an inlier that lies on a button which the picture shows, however inexact."""
    lattice = fit.layout.nodes.reshape(-1, 2)[fit.node]
    predicted, _, d_uv = jacobians(fit.pose, lattice[None])
    off = np.linalg.solve(d_uv[0], (usable.rays - predicted[0])[..., None])[..., 0] / measured.half
    shown = np.zeros(len(fit.layout.nodes.reshape(-1, 2)), dtype=bool)
    shown[measured.places.node[measured.places.seen]] = True
    on = shown[fit.node] & (np.hypot(*off.T) < _ON_BUTTON)
    return replace(fit, inlier=np.where(on, 1.0, fit.inlier))


def measurement_of(measured: MeasuredFit, unit: float, camera: Camera) -> Measurement:
    """Return what is seen, by cell."""
    fit, places = measured.fit, measured.places
    rows, columns = fit.layout.nodes.shape[:2]
    seen, node = places.seen, places.node[places.seen]
    at = (fit.layout.nodes.reshape(-1, 2)[places.node] + places.offset)[seen]
    d_px = jacobians(fit.pose, at[None])[2][0] * camera.focal_px
    centre, covariance = np.full((rows * columns, 2), np.nan), np.full((rows * columns, 2, 2), np.nan)
    correlation = np.full(rows * columns, np.nan)
    centre[node] = camera.pixels(projected(fit.pose, at[None])[0][0])
    covariance[node] = d_px @ places.covariance[seen] @ np.swapaxes(d_px, 1, 2)
    correlation[node] = places.correlation[seen]
    metric = np.array([1.0, float(np.exp(fit.pose.log_aspect[0]))]) * unit
    return Measurement(
        centre.reshape(rows, columns, 2),
        covariance.reshape(rows, columns, 2, 2),
        correlation.reshape(rows, columns),
        measured.half * metric,
        measured.residual,
        measured.scatter,
    )


def _boxes_apart(measured: MeasuredFit, usable: Usable, sigma: float) -> tuple[float, float]:
    """Return ln of how far the boxes are from where the picture shows their buttons, each and all alike, over what the
    detector's noise explains: a picture of another moment shows them elsewhere."""
    places = measured.places
    own = places.seen & places.detected
    at = measured.rays[own]
    distance = np.linalg.norm(usable.rays[:, None] - at[None], axis=-1)
    nearest = distance.argmin(axis=0)
    apart = (usable.rays[nearest] - at) / sigma
    if not len(apart):
        return 3.0, 3.0
    each = float(np.sqrt(0.5 * (apart**2).sum(axis=1).mean()))
    together = float(np.linalg.norm(apart.mean(axis=0)) * np.sqrt(0.5 * len(apart)))
    return float(np.log(np.clip(each, 0.1, 20.0))), float(np.log(np.clip(together, 0.1, 20.0)))


def picture_features(found: PictureFit, boxes: FitResult, usable: Usable, sigma: float, camera: Camera) -> Array:
    """Return what the confidence of a fit to the picture is computed from, in the order of FEATURES."""
    measured, result = found.measured, found.result
    places, layout = measured.places, measured.fit.layout
    detected, seen = places.detected, places.seen
    own = rotation_std_rad(boxes.covariance)
    turned = rotation_angle_rad(boxes.R_camera_panel.T @ result.R_camera_panel)
    correlation = places.correlation[detected]
    free = len(layout.row_breaks) + len(layout.column_breaks) + layout.row_stagger.sum() + layout.column_stagger.sum()
    number = float(seen.sum())
    apart = _boxes_apart(measured, usable, sigma)
    said = np.zeros(3) if result.measurement is None else result.measurement.uprightness
    p = float(np.clip(boxes.confidence, 1e-3, 1.0 - 1e-3))
    return np.array(
        [
            np.log(number),
            seen[detected].mean(),
            result.inliers / max(1, len(result.cells)),
            len(places.node) / layout.cells,
            np.median(correlation),
            np.quantile(correlation, 0.15),
            np.log(np.clip(measured.residual, 1e-3, 1.0)),
            np.log(np.clip(rotation_std_rad(result.covariance), 1e-4, 3.0)),
            min(turned / max(own, 1e-3), 10.0),
            np.log(p / (1.0 - p)),
            min(found.margin, _MARGIN_NATS) / _MARGIN_NATS,
            np.arccos(min(1.0, abs(result.R_camera_panel[2, 2]))),
            float(min(len(layout.rows), len(layout.columns)) == 2),
            1.0 / max(number - 3.0, 1.0),
            free / number,
            *apart,
            *said,
            *sizes.size_features(result, usable.index, usable.telling_sizes_px, camera),
        ]
    )
