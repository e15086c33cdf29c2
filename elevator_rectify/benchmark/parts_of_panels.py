"""Parts of large real panels, of which the fit to all buttons is the truth.

Nobody measured the panels' poses. But the fit to all buttons of a large panel is right more than nearly always, and
tells whether a fit to six to ten of them is: a block, a column with some others, any.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from elevator_rectify.benchmark.end_to_end import ASPECTS, judgeable, stretched_camera, true_detections
from elevator_rectify.core import Camera, Config, GridFit, fit_panel
from elevator_rectify.core.confidence import rotation_std_rad
from elevator_rectify.core.geometry.rotations import rotation_angle_rad
from elevator_rectify.core.types import Array, FitResult, IntArray
from elevator_rectify.train.labelled import LabelledPicture

_CONFIG = Config()
# A panel serves as the truth from so many buttons on, if its fit is so sure, so complete and so exact.
_FEWEST_BUTTONS, _SURE, _COMPLETE, _EXACT_RAD = 9, 0.9, 0.85, np.deg2rad(2.5)
_LEAST, _MOST = 6, 10
# The truth is not known better.
_RIGHT_DEG = 4.0
# A rotation is also right where it is as far off as its covariance says, up to a bound.
_STDS, _FARTHEST_DEG = 3.0, 10.0


def is_large(picture: LabelledPicture) -> bool:
    """Tell whether a picture's panel may serve as the truth."""
    return bool(picture.is_button.sum() >= _FEWEST_BUTTONS and judgeable(picture))


def true_fit(picture: LabelledPicture) -> tuple[GridFit, Camera] | None:
    """Return the fit to all buttons, by the aspect of the pixels that it is surest with; None where it is not sure."""
    detections, best = true_detections(picture), None
    for aspect in ASPECTS:
        camera = stretched_camera(aspect, picture.image.shape[1])
        fit = fit_panel(detections, camera, _CONFIG, image=picture.image)
        if fit.ok and fit.measurement is not None and (best is None or fit.confidence > best[0].confidence):
            best = fit, camera
    if best is None or best[0].confidence < _SURE or best[0].inliers < _COMPLETE * len(detections):
        return None
    return best if rotation_std_rad(best[0].shape_covariance[:6, :6]) < _EXACT_RAD else None


def parts(fit: GridFit, rng: np.random.Generator) -> Iterator[IntArray]:
    """Yield indices of detections: blocks, a column with some others (as floors with controls), any."""
    on = np.flatnonzero(fit.cells[:, 0] >= 0)
    row, column = fit.cells[on].T
    for _ in range(2):
        top, left = rng.integers(0, max(1, fit.rows - 2)), rng.integers(0, max(1, fit.columns - 1))
        high, wide = rng.integers(3, 6), rng.integers(2, 4)
        block = on[(row >= top) & (row < top + high) & (column >= left) & (column < left + wide)]
        if _LEAST <= len(block) <= _MOST:
            yield block
    for _ in range(3):
        chosen = _column_and_others(on, row, column, int(rng.integers(0, fit.columns)), rng)
        if len(chosen) >= _LEAST:
            yield chosen
    for _ in range(2):
        yield rng.choice(on, min(len(on), int(rng.integers(_LEAST, _MOST + 1))), replace=False)


def _column_and_others(on: IntArray, row: IntArray, column: IntArray, which: int, rng: np.random.Generator) -> IntArray:
    """Return three to six buttons of a column and two or three of a row at its end, none where there are too few."""
    own = np.flatnonzero(column == which)
    own = own[np.argsort(row[own])]
    number = int(rng.integers(3, 7))
    first = int(rng.integers(0, max(1, len(own) - number + 1)))
    own = own[first : first + number]
    others = np.flatnonzero(column != which)
    if len(own) < 3 or len(others) < 2:
        return np.zeros(0, dtype=np.int64)
    below = bool(rng.random() < 0.7)
    outer = others[row[others] >= row[own[-1]] if below else row[others] <= row[own[0]]]
    outer = outer if len(outer) >= 2 else others
    same = outer[row[outer] == rng.choice(row[outer])]
    same = same if len(same) >= 2 else outer
    some = rng.choice(same, min(len(same), int(rng.integers(2, 4))), replace=False)
    return np.asarray(on[np.concatenate([own, some])], dtype=np.int64)


def is_right(fit: FitResult, truth: FitResult) -> bool:
    """Tell whether a part's fit has the rotation of the fit to all buttons."""
    error = float(np.rad2deg(rotation_angle_rad(truth.R_camera_panel.T @ fit.R_camera_panel)))
    # By the residuals' covariance: a fit is not right because it says that it may be mistaken.
    return as_stated(error, fit.shape_covariance[:6, :6], _RIGHT_DEG)


def as_stated(error_deg: float, covariance: Array, floor_deg: float) -> bool:
    """Tell whether a rotation is off by no more than floor_deg, or than its covariance (6, 6) of the pose says."""
    own = float(np.rad2deg(rotation_std_rad(covariance)))
    return error_deg <= max(floor_deg, min(_STDS * own, _FARTHEST_DEG))
