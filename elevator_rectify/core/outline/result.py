"""From outlines to the result that users get: the panel of few buttons, its pose, grid and status."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from elevator_rectify.core.confidence import logistic_confidence
from elevator_rectify.core.config import Config
from elevator_rectify.core.detections import Usable
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.pose import LatticePose, on_plane
from elevator_rectify.core.geometry.rotations import rotations
from elevator_rectify.core.geometry.scale import neighbours_apart
from elevator_rectify.core.outline.pose import FewFit, fit_few
from elevator_rectify.core.outline.refinement import OutlineFit
from elevator_rectify.core.outline.shapes import OutlineModel
from elevator_rectify.core.picture.straight_edges import Segments, sharpened
from elevator_rectify.core.result import Geometry, with_geometry
from elevator_rectify.core.types import Array, FitResult, Image, IntArray, Measurement

METHOD = "outlines"
# Written by `python3 -m elevator_rectify calibrate --outlines`.
COEFFICIENTS = Path(__file__).with_name("confidence.json")
FEATURES = ("margin", "seen share", "ln residual px", "ln tilt std", "buttons", "round", "tilt", "cost a point")
_MARGIN_NATS = 20.0
_LEAST_BOX_PX = 2.0
_LEAST_SEEN, _LARGEST_RESIDUAL_PX = 0.6, 2.0
# What a circle says of its turn in the plane: nothing; cameras are held upright to this.
_UPRIGHT_STD_RAD = 0.1
_CENTRE_STD_PX = 0.5
# Of rounded squares: their edges' own.
_OUTLINE_STD_RAD = 0.03
# Buttons on one line are no further off it, in heights; centres lie off their lines by so much, or anywhere.
_SAME_LINE = 0.5
_OFF_LINE, _ANY_PLACE = 0.06, 0.002
# In a gap of a whole number of steps, to so much, lines were missed, at most so many.
_WHOLE_STEP, _MOST_MISSED = 0.12, 2
# Neighbouring columns are so many buttons' widths apart, and so many of the cells have a button (of 42 rendered panels
# of which a hand left two to five buttons, 11 of the 14 with a wrong scale are not so, and none of the right ones).
_LEAST_WIDTHS, _MOST_WIDTHS, _FILLED = 1.05, 2.6, 0.4
# Rows that run another way by more than this are another pose, unless they are less likely by so many nats.
_SAME_TURN_RAD, _TURN_NATS = np.deg2rad(8.0), 3.0


def few_fit(usable: Usable, camera: Camera, config: Config, image: Image, refused: FitResult) -> FitResult:
    """Return the pose from the buttons' outlines; `refused`, the result without, where the picture shows none."""
    boxes = np.column_stack([camera.pixels(usable.rays), usable.sizes_px])
    if not (usable.sizes_px > 0).all():
        return replace(refused, reason=f"{refused.reason}; boxes without sizes show no outlines")
    if (usable.sizes_px < _LEAST_BOX_PX).any():
        return replace(refused, reason=f"{refused.reason}; boxes of less than {_LEAST_BOX_PX:g} px show no outlines")
    if (usable.sizes_px > [camera.width, camera.height]).any():
        return replace(refused, reason=f"{refused.reason}; a box is larger than the picture")
    found = fit_few(boxes, image, camera, config)
    if found is None or not _shown(found.best):
        return replace(refused, reason=f"{refused.reason}; the picture shows no outlines")
    turn = _turned(found.best.model, usable, camera)
    result = _result(found.best, turn, usable, found.segments, refused, camera, config)
    score = logistic_confidence(few_features(found), COEFFICIENTS)
    result = replace(result, confidence=score, margin_nats=found.margin)
    if found.other is not None and found.margin < config.outline.ambiguity_nats:
        other = _result(
            found.other, _turned(found.other.model, usable, camera), usable, found.segments, refused, camera, config
        )
        reason = f"two poses explain the outlines, {found.margin:.2g} nats apart"
        return replace(result, status="ambiguous", reason=reason, alternatives=(other,))
    if turn.margin < _TURN_NATS:
        reason = f"the buttons' rows may run another way, {turn.margin:.2g} nats less likely"
        return replace(result, status="ambiguous", reason=reason)
    return _judged(result, config)


def _shown(fit: OutlineFit) -> bool:
    return fit.seen >= _LEAST_SEEN and fit.residual_px <= _LARGEST_RESIDUAL_PX


def _judged(result: FitResult, config: Config) -> FitResult:
    """Return the result with its status, by its tilt's covariance and its confidence."""
    tilt = result.R_camera_panel[:, :2]
    spread = float(np.sqrt(np.linalg.eigvalsh(tilt.T @ result.covariance[3:, 3:] @ tilt)[-1]))
    if spread > config.accept.max_rotation_std_rad:
        reason = f"the tilt is known to {spread:.3f} rad only, {config.accept.max_rotation_std_rad:g} allowed"
        return replace(result, status="uncertain", reason=reason)
    if result.confidence < config.accept.min_confidence:
        reason = f"confidence {result.confidence:.3f} < {config.accept.min_confidence:g}"
        return replace(result, status="low_confidence", reason=reason)
    return replace(result, status="ok", reason="")


def few_features(found: FewFit) -> Array:
    """Return what the confidence of a fit to outlines is computed from, in the order of FEATURES."""
    fit = found.best
    number = float(len(fit.model.centres))
    return np.array(
        [
            min(found.margin, _MARGIN_NATS) / _MARGIN_NATS,
            fit.seen,
            np.log(np.clip(fit.residual_px, 0.05, 5.0)),
            0.5 * np.log(np.clip(np.linalg.eigvalsh(_tilt_covariance(fit))[-1], 1e-8, 9.0)),
            number,
            float(fit.model.round),
            np.arccos(min(1.0, abs(fit.model.R[2, 2]))),
            fit.cost / number,
        ]
    )


def _tilt_covariance(fit: OutlineFit) -> Array:
    """Return the covariance (2, 2) of the tilt about the plane's axes."""
    regular = fit.information + 1e-9 * np.diag(np.diag(fit.information)) + 1e-12 * np.eye(len(fit.information))
    return np.asarray(np.linalg.inv(regular)[:2, :2])


@dataclass(frozen=True)
class Turn:
    """How rows run in the outlines' plane: turned by angle_rad, known to std_rad; margin in nats to any other way."""

    angle_rad: float
    std_rad: float
    margin: float


def _result(
    fit: OutlineFit, turn: Turn, usable: Usable, segments: Segments, refused: FitResult, camera: Camera, config: Config
) -> FitResult:
    """Return pose, covariance and grid."""
    model = fit.model
    R, height = model.R @ rotations(np.array([[0.0, 0.0, turn.angle_rad]]))[0], 2.0 * float(model.half[-1])
    axes, turned = model.R[:, :2], turn.std_rad**2 * np.outer(R[:, 2], R[:, 2])
    covariance = axes @ _tilt_covariance(fit) @ axes.T + turned
    covariance = covariance * config.accept.covariance_scale
    if len(segments.normal):
        R, covariance = sharpened(R, covariance, segments)
    plane = on_plane(R, model.origin, usable.rays)[0]
    rows, row = _lines(plane[:, 1], height)
    columns, column = _lines(plane[:, 0], height)
    (rows, row), (columns, column) = _with_missed(rows, row), _with_missed(columns, column)
    pitch, aspect = _pitch(rows, columns, height)
    nodes = np.stack(np.meshgrid((columns - columns[0]) / pitch, (rows - rows[0]) / (pitch * aspect)), axis=-1)
    cells = np.column_stack([row, column])
    size, apart = config.outline.button_size_m, pitch * neighbours_apart(nodes, cells)
    known = _neighbours(apart / (2.0 * float(model.half[0])), len(row) / (len(rows) * len(columns)), len(columns))
    scale = replace(config.scale, column_pitch_m=config.scale.column_pitch_m if known else 0.0)
    if size > 0:
        std = config.outline.button_size_std_m * apart / height
        scale = replace(scale, column_pitch_m=size * apart / height, column_pitch_std_m=std)
    t = (model.origin + R[:, :2] @ np.array([columns[0], rows[0]])) / pitch
    whole = np.zeros((6, 6))
    whole[:3, :3] = (_CENTRE_STD_PX / camera.focal_px * t[2]) ** 2 * np.eye(3) + _size_std(fit) ** 2 * np.outer(t, t)
    whole[3:, 3:] = covariance
    geometry = Geometry(LatticePose(R, t, aspect), nodes, cells, whole)
    result = with_geometry(
        replace(refused, status="ok", reason=""), geometry, usable, camera, replace(config, scale=scale)
    )
    seen = np.full((len(rows), len(columns)), np.nan)
    seen[row, column] = fit.seen
    centre = np.where(np.isfinite(seen)[..., None], result.grid_px, np.nan)
    half = model.half / pitch * result.pitch[0]
    nothing = np.full((len(rows), len(columns), 2, 2), np.nan)
    measurement = Measurement(centre, nothing, seen, half, fit.residual_px / camera.focal_px / pitch, 0.0)
    return replace(
        result,
        method=METHOD,
        converged=True,
        row_positions=nodes[:, 0, 1],
        column_positions=nodes[0, :, 0],
        measurement=measurement,
    )


def _neighbours(widths: float, filled: float, columns: int) -> bool:
    """Tell whether the columns of few buttons are a pitch apart, which gives the scale: those between may be hidden.

    widths: their distance in buttons' widths; filled: share of the cells with a button.
    """
    return columns > 1 and _LEAST_WIDTHS <= widths <= _MOST_WIDTHS and filled >= _FILLED


def _size_std(fit: OutlineFit) -> float:
    """Return the standard deviation of ln size, by which distances are known."""
    index = 2 + fit.model.centres.size
    regular = fit.information + 1e-9 * np.diag(np.diag(fit.information)) + 1e-12 * np.eye(len(fit.information))
    return float(np.sqrt(max(0.0, np.linalg.inv(regular)[index, index])))


def turn_of(plane: Array, height: float, upright_std_rad: float, centre_std: float) -> Turn:
    """Return how rows and columns run: along the lines that buttons at (N, 2) share, near upright.

    Every pair of buttons may be of one row, of one column, or of neither. height: of a button, centre_std: of the
    places, both in the unit of the places.
    """
    one, other = np.triu_indices(len(plane), 1)
    apart = plane[other] - plane[one]
    length, angle = np.linalg.norm(apart, axis=1), _quarter(np.arctan2(apart[:, 1], apart[:, 0]))
    tried = np.append(angle, 0.0)
    off = _quarter(angle - tried[:, None])
    aligned = np.exp(-0.5 * (np.sin(off) * length / (_OFF_LINE * height)) ** 2)
    nats = np.log(_ANY_PLACE + aligned).sum(axis=1) - 0.5 * (tried / upright_std_rad) ** 2
    best = int(nats.argmax())
    different = np.abs(_quarter(tried - tried[best])) > _SAME_TURN_RAD
    margin = float(nats[best] - nats[different].max()) if different.any() else np.inf
    weight = (aligned[best] > 0.5) * length**2
    if not weight.any():
        return Turn(0.0, upright_std_rad, margin)
    turn = float(tried[best] + (weight * off[best]).sum() / weight.sum())
    return Turn(turn, 1.5 * centre_std / float(np.sqrt(weight.max())), margin)


def _quarter(angle: Array) -> Array:
    """Return angles of lines, of rows or columns alike: within an eighth of a turn."""
    return np.asarray(angle - np.pi / 2 * np.round(angle / (np.pi / 2)))


def _turned(model: OutlineModel, usable: Usable, camera: Camera) -> Turn:
    """Return how rows run in the outlines' plane; edges of squares say it too, circles are upright as the camera is."""
    plane = on_plane(model.R, model.origin, usable.rays)[0]
    upright = _UPRIGHT_STD_RAD if model.round else _OUTLINE_STD_RAD
    return turn_of(plane, 2.0 * float(model.half[-1]), upright, _CENTRE_STD_PX / camera.focal_px)


def _lines(coordinate: Array, height: float) -> tuple[Array, IntArray]:
    """Return the lines' places, ascending, and the line of each button."""
    order = np.argsort(coordinate, kind="stable")
    line = np.zeros(len(order), dtype=np.int64)
    line[order] = np.concatenate([[0], np.cumsum(np.diff(coordinate[order]) > _SAME_LINE * height)])
    return np.array([coordinate[line == k].mean() for k in range(line.max() + 1)]), line


def _with_missed(lines: Array, line: IntArray) -> tuple[Array, IntArray]:
    """Return lines and the line of each button with those that were missed: gaps of some whole steps, where all are."""
    gaps = np.diff(lines)
    if len(gaps) < 2:
        return lines, line
    steps = np.round(gaps / gaps.min())
    step = float(gaps.sum() / steps.sum())
    if steps.max() > _MOST_MISSED + 1 or (np.abs(gaps / step - steps) > _WHOLE_STEP).any():
        return lines, line
    number = np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)
    return np.interp(np.arange(number[-1] + 1), number, lines), number[line]


def _pitch(rows: Array, columns: Array, height: float) -> tuple[float, float]:
    """Return the column pitch and the row pitch over it; the one that there is for both, a button's height for none."""
    known = [float(np.median(np.diff(lines))) if len(lines) > 1 else 0.0 for lines in (columns, rows)]
    across = known[0] or known[1] or height
    return across, (known[1] or across) / across
