"""From frame to frame: the last fit starts the next, and the pose is smoothed as far as the covariances allow."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from elevator_rectify.core.config import SmoothingConfig
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.panel_frame import PanelFrame
from elevator_rectify.core.lamps.lit import Lit
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.reading.hidden import SeenLabels, seen_labels
from elevator_rectify.core.types import Array, FitResult, FitT

# What lies beyond 99.9 % (so many standard deviations of a normal variable) is a jump or another panel, not noise.
_JUMP_STDS = 3.09
_SAME_LINE = 0.1
# Labels that were read are remembered for so long.
_REMEMBERED_NS = 30_000_000_000


@dataclass(frozen=True)
class Track:
    """The last accepted fit as measured; its smoothed pose and shape (S,), with their covariance (6 + S, 6 + S); the
    image's stamp. read: the last fit with labels, and the stamp of the image that they were read in; seen: the labels
    that were surely read on this panel; lit: which lamps were lit then; panel_frame: where its frame is."""

    fit: FitResult
    R: Array
    t: Array
    shape: Array
    covariance: Array
    stamp_ns: int
    read: FitResult | None = None
    read_ns: int = 0
    seen: SeenLabels | None = None
    lit: Lit | None = None
    panel_frame: PanelFrame | None = None


def with_read(
    track: Track, fit: GridFit, stamp_ns: int, before: Track | None, anew: bool, lit: Lit | None = None
) -> Track:
    """Return the track with a fit with labels; anew: whether they were read in this very frame; lit: the last lamps."""
    seen = seen_labels(fit, remembered(before, stamp_ns))
    read_ns = stamp_ns if anew or before is None else before.read_ns
    return replace(track, read=fit, read_ns=read_ns, seen=seen, lit=lit)


def remembered(track: Track | None, stamp_ns: int) -> SeenLabels | None:
    """Return the labels that were surely read on the track's panel, where that is not too long ago."""
    young = track is not None and 0 <= stamp_ns - track.read_ns < _REMEMBERED_NS
    return track.seen if track is not None and young else None


def recently_read(track: Track | None, stamp_ns: int, seconds: float) -> FitResult | None:
    """Return the last fit with labels, where they were read so little before."""
    young = track is not None and 0 <= stamp_ns - track.read_ns < 1e9 * seconds
    return track.read if track is not None and young else None


def recent(track: Track | None, stamp_ns: int, config: SmoothingConfig) -> FitResult | None:
    """Return the last fit where it is young enough to start the fit of an image with this stamp."""
    if track is None or not 0 <= stamp_ns - track.stamp_ns <= 1e9 * config.max_gap_s:
        return None
    return track.fit


def smoothed(
    track: Track | None, fit: FitT, camera: Camera, stamp_ns: int, config: SmoothingConfig
) -> tuple[Track | None, FitT]:
    """Return the new track and the fit to publish: smoothed by the track where it shows the same panel.

    A Kalman filter (Thrun, Burgard and Fox, 3.2) of pose, aspect and gaps together, since their errors belong together:
    the panel stands and keeps its shape, the camera moves by the configured speeds. The published covariance stays the
    single frame's: a detector's errors repeat from frame to frame.
    """
    if not fit.ok:
        return track, fit
    # An earlier stamp is a repeated frame, or, by far, that of a clock which was set back.
    if track is not None and 0 <= track.stamp_ns - stamp_ns <= 1e9 * config.max_gap_s:
        return track, fit
    shape, measured = shape_of(fit), fit.shape_covariance
    fresh = Track(fit, fit.R_camera_panel, fit.t_camera_panel, shape, measured, stamp_ns)
    seconds = 0.0 if track is None else 1e-9 * (stamp_ns - track.stamp_ns)
    if track is None or not 0.0 < seconds <= config.max_gap_s or not same_panel(track.fit, fit):
        return fresh, fit
    unit = 1.0 if fit.metric else 1.0 / config.usual_pitch_m
    moved = np.repeat([config.speed_m_per_s * unit, config.turn_rad_per_s], 3) * seconds
    prior = track.covariance + np.diag(np.append(moved, np.zeros(len(shape))) ** 2)
    turned = cv2.Rodrigues(fit.R_camera_panel @ track.R.T)[0].ravel()
    innovation = np.concatenate([fit.t_camera_panel - track.t, turned, shape - track.shape])
    together = prior + measured
    if innovation @ np.linalg.solve(together, innovation) > _chi2(len(innovation)):
        return fresh, fit
    gain = np.linalg.solve(together, prior).T
    step = gain @ innovation
    R, t = cv2.Rodrigues(step[3:6])[0] @ track.R, track.t + step[:3]
    new = track.shape + step[6:]
    return Track(fit, R, t, new, prior - gain @ prior, stamp_ns), posed(shaped(fit, new), R, t, camera)


def _chi2(freedom: int) -> float:
    """Return the chi-squared variable's quantile of a jump, by Wilson and Hilferty's cube of a normal variable."""
    spread = 2.0 / (9.0 * freedom)
    return float(freedom * (1.0 - spread + _JUMP_STDS * np.sqrt(spread)) ** 3)


def same_panel(one: FitResult, other: FitResult) -> bool:
    """Tell whether two fits have the same rows and columns, and one unit."""
    if one.metric != other.metric or (one.rows, one.columns) != (other.rows, other.columns):
        return False
    if len(one.shape_covariance) != len(other.shape_covariance):
        return False
    lines = ((one.row_positions, other.row_positions), (one.column_positions, other.column_positions))
    return all(bool((np.abs(a - b) < _SAME_LINE).all()) for a, b in lines)


def shape_of(fit: FitResult) -> Array:
    """Return ln(row pitch / column pitch) and the gaps between blocks in pitches (S,), as far as they are estimated."""
    if len(fit.shape_covariance) == 6:
        return np.zeros(0)
    gaps = [
        np.diff(positions)[np.diff(block) > 0]
        for positions, block in ((fit.row_positions, fit.row_block), (fit.column_positions, fit.column_block))
    ]
    return np.concatenate([[np.log(fit.pitch[1] / fit.pitch[0])], *gaps])


def shaped(fit: FitT, shape: Array) -> FitT:
    """Return the fit with another aspect and other gaps (S,), as `shape_of` has them; the pose stays."""
    if not len(shape):
        return fit
    change = shape - shape_of(fit)
    rows = int(fit.row_block[-1])
    down = np.concatenate([[0.0], np.cumsum(change[1 : 1 + rows])])[fit.row_block]
    along = np.concatenate([[0.0], np.cumsum(change[1 + rows :])])[fit.column_block]
    shift = np.stack(np.broadcast_arrays(along[None], down[:, None]), axis=-1) * fit.pitch
    stretch = np.array([1.0, float(np.exp(change[0]))])
    return replace(
        fit,
        pitch=fit.pitch * stretch,
        row_positions=fit.row_positions + down,
        column_positions=fit.column_positions + along,
        grid_panel=(fit.grid_panel + shift) * stretch,
    )


def posed(fit: FitT, R: Array, t: Array, camera: Camera) -> FitT:
    """Return the fit with another pose of its panel."""
    points = fit.grid_panel @ R[:, :2].T + t
    moved = replace(fit, R_camera_panel=R, t_camera_panel=t, grid_points=points, grid_px=camera.project(points))
    if fit.known is None:
        return moved
    buttons = fit.known.places * (fit.pitch / fit.known.pitch)
    return replace(moved, known_px=camera.project(buttons @ R[:, :2].T + t))
