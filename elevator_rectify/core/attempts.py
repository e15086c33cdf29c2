"""How long to search: track the last fit, else a small search, and wider ones while its fit is doubtful."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from elevator_rectify.core.config import Config, HypothesesConfig
from elevator_rectify.core.detections import Usable
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.pose import on_plane
from elevator_rectify.core.geometry.rotations import rotation_angle_rad, rotations
from elevator_rectify.core.lattice.joint import THOROUGH, USUAL, JointFit, fit_joint, track_joint, turned
from elevator_rectify.core.picture.fit import with_picture
from elevator_rectify.core.picture.straight_edges import Photo
from elevator_rectify.core.picture.witness import CONFIRMED, CONTRADICTED, contradicted, second_opinion
from elevator_rectify.core.result import decided, joint_fit, layout_of, undecided
from elevator_rectify.core.types import Array, BoolArray, FitResult, Image

# The first search's share of the hypotheses.
_QUICK = 0.125
# The last search grows less with more detections than so many.
_MANY = 30
# A fit that is accepted, but no surer than this, is worth the last search too.
_SURE = 0.9
# Detections of which no search so far made more than this confidence are no panel: so are two thirds of those without
# one, and none of the real panels that the thorough search found.
_HOPELESS = 0.005
# So many more unexplained detections than in the frame before, or a new one that is so near to the next line, in
# pitches, may be of a row that came into view; it is not new where the frame before had one so near.
_NEWCOMERS, _ON_LINE, _SAME_PLACE = 2, 0.2, 0.3
# Lines further apart than this, in pitches, may have one between them that was missed.
_GAP = 1.5
# Fits to two detectors' boxes of the same buttons are within this (13 real and rendered panels: 7 degrees at most).
_SAME_POSE_RAD = np.deg2rad(9.0)
# A button over the pitch, where its box has no size.
_USUAL_SIZE = 0.6


@dataclass(frozen=True)
class Attempt:
    """One search: what it found, the result made of it, the confidence that makes the next one needless; boxes: the
    result by the detections alone."""

    fit: JointFit | None
    result: FitResult
    enough: float
    boxes: FitResult

    @property
    def likelihood(self) -> float:
        """Return the log likelihood of the detections."""
        return -np.inf if self.fit is None else self.fit.best.support

    @property
    def rank(self) -> tuple[float, float, float]:
        """Return what the best attempt has most of; what can be no panel is not it, however alike its places look."""
        if self.result.measurement is None:
            return 0.0, 0.0, self.likelihood
        possible = self.result.status != "no_lattice"
        return 1.0, self.result.confidence if possible else 0.0, self.likelihood


def best_attempt(usable: Usable, camera: Camera, sigma: float, config: Config, image: Image | None = None) -> Attempt:
    """Return the best of as many searches as are needed. sigma: of the detections, in normalised units.

    Without image the likeliest is the best, with image the one that it confirms most.
    """
    best: Attempt | None = None
    boxes: Attempt | None = None
    for attempt in attempts(usable, camera, sigma, config, image):
        if best is None or attempt.rank > best.rank:
            best = attempt
        if boxes is None or (attempt.boxes.ok, attempt.likelihood) > (boxes.boxes.ok, boxes.likelihood):
            boxes = attempt
        if best.result.ok and best.result.confidence >= attempt.enough:
            break
    assert best is not None and boxes is not None
    if image is None or not config.measurement.witness:
        return best
    return replace(best, result=witnessed(best.result, boxes.boxes, usable, camera, sigma, image, config))


def attempts(
    usable: Usable, camera: Camera, sigma: float, config: Config, image: Image | None = None
) -> Iterator[Attempt]:
    """Search, each time among more hypotheses, the last time thoroughly, where there is any hope of a panel."""
    R_upright_camera = _upright(config)
    rays = usable.rays @ R_upright_camera[:2, :2].T
    area = camera.width * camera.height / camera.focal_px**2
    photo = None if image is None else Photo(image, camera)
    hope = 0.0
    for hypotheses, enough in _widths(config.hypotheses, len(rays)):
        effort = THOROUGH if enough == 0.0 and hope > _HOPELESS else USUAL
        fit = fit_joint(rays, usable.log_sizes, sigma, area, replace(config, hypotheses=hypotheses), effort)
        if fit is not None:
            other = turned(fit.other, R_upright_camera.T) if fit.other else None
            fit = JointFit(turned(fit.best, R_upright_camera.T), other, fit.margin)
        boxes = joint_fit(fit, usable, camera, sigma, config)
        result, hope = boxes, max(hope, boxes.confidence)
        if photo is not None and fit is not None:
            result = with_picture(fit, boxes, usable, sigma, photo, config)
        yield Attempt(fit, result, enough, boxes)


def tracked(
    usable: Usable, camera: Camera, sigma: float, config: Config, previous: FitResult, image: Image | None = None
) -> FitResult | None:
    """Return the previous fit moved to these detections, None where it does not explain them."""
    if not previous.ok or previous.method != "joint":
        return None
    R_upright_camera = _upright(config)
    share = previous.inliers / max(1, len(previous.cells))
    area = camera.width * camera.height / camera.focal_px**2
    last = turned(layout_of(previous), R_upright_camera)
    fit = track_joint(last, share, usable.rays @ R_upright_camera[:2, :2].T, usable.log_sizes, sigma, area, config)
    if fit is None:
        return None
    moved = JointFit(turned(fit, R_upright_camera.T), None, previous.margin_nats)
    boxes = undecided(moved, usable, camera, sigma, config)
    if image is None:
        return decided(boxes, moved, usable, camera, config)
    measured = previous.measurement is not None
    shown = with_picture(moved, boxes, usable, sigma, Photo(image, camera), config, previous.measurement)
    if shown.ok:
        # What the picture shows needs no verdict by the boxes.
        return shown
    result = decided(boxes, moved, usable, camera, config)
    shown = result if shown is boxes else shown
    if not config.measurement.witness:
        return shown
    # Boxes that were believed without the picture's measurement are so while they are tracked.
    if not measured and result.ok:
        return result
    return witnessed(shown, result, usable, camera, sigma, image, config)


def grew(fit: FitResult, previous: FitResult) -> bool:
    """Tell whether a row or column may have come into view, or was missed before: new detections where it would be, or
    many more that the lattice leaves out."""
    place = _left_out(fit)
    if len(place) >= len(previous.cells) - previous.inliers + _NEWCOMERS:
        return True
    known = _left_out(previous)
    new = np.linalg.norm(place[:, None] - known[None], axis=2).min(axis=1, initial=np.inf) > _SAME_PLACE
    place = place[new]
    row, row_half, row_missed = _from_lines(place[:, 1], fit.row_positions)
    column, column_half, column_missed = _from_lines(place[:, 0], fit.column_positions)
    # The next row or column may be half a pitch aside.
    next_row = row_missed & (row < _ON_LINE) & (np.minimum(column, column_half) < _ON_LINE)
    next_column = column_missed & (column < _ON_LINE) & (np.minimum(row, row_half) < _ON_LINE)
    return bool((next_row | next_column).any())


def _left_out(fit: FitResult) -> Array:
    """Return where on the panel, in pitches (N, 2), the detections are that the lattice leaves out."""
    out = (fit.cells[:, 0] < 0) & np.isfinite(fit.rays).all(axis=1)
    panel, depth = on_plane(fit.R_camera_panel, fit.t_camera_panel, fit.rays[out])
    seen = np.isfinite(panel).all(axis=1) & (depth > 0)
    return np.asarray(panel[seen] / fit.pitch)


def _from_lines(place: Array, lines: Array) -> tuple[Array, Array, BoolArray]:
    """Return how far places are from the nearest line, or one that may have been missed, from half a pitch behind one,
    and whether the nearest is a missed one: beyond the last ones, or in a gap at a whole pitch from one of its ends."""
    gaps = [(a, b) for a, b in pairwise(lines) if b - a > _GAP]
    within = [np.append(np.arange(a + 1.0, b - 0.5), np.arange(b - 1.0, a + 0.5, -1.0)) for a, b in gaps]
    more = np.concatenate([lines, [lines[0] - 1.0, lines[-1] + 1.0], *within])
    distance = np.abs(place[:, None] - more)
    half = np.abs(place[:, None] - more - 0.5).min(axis=1)
    return distance.min(axis=1), half, distance.argmin(axis=1) >= len(lines)


def witnessed(
    shown: FitResult, boxes: FitResult, usable: Usable, camera: Camera, sigma: float, image: Image, config: Config
) -> FitResult:
    """Return the fit to the picture where it confirms it, else the boxes' own, if the picture does not contradict it.

    shown: the fit with the picture; boxes: the fit to the detections alone. The picture's confidence knows the pictures
    that it was calibrated on; what it refuses or does not see, our own detector may see.
    """
    if not (boxes.ok or shown.ok):
        return shown
    believed = shown if shown.ok else boxes
    inlier = believed.cells[usable.index, 0] >= 0
    centres = camera.project(np.column_stack([usable.rays, np.ones(len(usable.rays))]))[inlier]
    steps = [np.linalg.norm(np.diff(believed.grid_px, axis=axis), axis=2) for axis in (0, 1)]
    usual = _USUAL_SIZE * min(float(np.nanmedian(step)) for step in steps)
    sizes = np.where(usable.sizes_px > 0, usable.sizes_px, usual)[inlier]
    said = second_opinion(image, centres, sizes, config.network)
    if said.verdict == CONTRADICTED:
        return contradicted(believed, said)
    if said.verdict != CONFIRMED or shown.ok:
        return shown
    assert said.seen_px is not None
    return agreed(boxes, said.seen_px, camera, sigma, config)


def agreed(boxes: FitResult, seen_px: Array, camera: Camera, sigma: float, config: Config) -> FitResult:
    """Return the fit to boxes; as ambiguous where our own detector's boxes (N, 4) at the same buttons give another one.

    Boxes that lie on the buttons more or less, as a mirrored picture's may, have a pose that is not the panel's.
    """
    own = seen_px[np.isfinite(seen_px).all(axis=1)]
    usable = Usable(len(own), np.arange(len(own)), camera.rays(own[:, :2]), own[:, 2:], {})
    if len(own) < config.input.min_detections:
        return boxes
    other = best_attempt(usable, camera, sigma, config).result
    apart = rotation_angle_rad(other.R_camera_panel.T @ boxes.R_camera_panel) if other.ok else 0.0
    if apart < _SAME_POSE_RAD:
        return boxes
    reason = f"our own detector's boxes at the same buttons give a pose {np.rad2deg(apart):.0f} degrees off"
    return replace(boxes, status="ambiguous", reason=reason)


def _upright(config: Config) -> Array:
    """Return the rotation to a camera turned upright, in which the panel's rows point to the right."""
    return np.asarray(rotations(np.array([[0.0, 0.0, -config.joint.camera_roll_rad]]))[0])


def _widths(config: HypothesesConfig, detections: int) -> list[tuple[HypothesesConfig, float]]:
    """Return the searches, each wider than the one before, and the confidence that makes the next one needless."""

    # The more detections, the more true neighbours there are, and the more a hypothesis costs.
    last = config.last_attempt * min(1.0, _MANY / detections)
    widths = [(config.scaled(_QUICK), config.quick_confidence), (config, _SURE), (config.scaled(last), 0.0)]
    return widths[config.quick_confidence >= 1.0 : 3 if last >= 2.0 else 2]
