"""Examples for the confidence of fits, from labelled pictures of real panels.

Nobody measured the panels' poses. But the fit to all buttons of a large panel is right more than nearly always, and
tells whether a fit to six to ten of them is: a block, a column with some others, any. Boxes of another picture are
never right.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from elevator_rectify.benchmark.end_to_end import ASPECTS, judgeable, stretched_camera, true_detections
from elevator_rectify.core import Camera, Config, Detection, GridFit, fit_panel
from elevator_rectify.core.attempts import Attempt, attempts, best_attempt
from elevator_rectify.core.confidence import features, rotation_std_rad
from elevator_rectify.core.detections import Usable
from elevator_rectify.core.geometry.rotations import rotation_angle_rad
from elevator_rectify.core.picture.fit import PictureFit, picture_features, picture_fit
from elevator_rectify.core.picture.straight_edges import Photo
from elevator_rectify.core.pipeline import admitted
from elevator_rectify.core.types import Array, FitResult, IntArray
from elevator_rectify.train.labelled import LabelledPicture, read_labelled

_CONFIG = Config()
# A panel serves as the truth from so many buttons on, if its fit is so sure, so complete and so exact.
_FEWEST_BUTTONS, _SURE, _COMPLETE, _EXACT_RAD = 9, 0.9, 0.85, np.deg2rad(2.5)
_LEAST, _MOST = 6, 10
# The truth is not known better.
_RIGHT_DEG = 4.0
# A rotation is also right where it is as far off as its covariance says, up to a bound.
_STDS, _FARTHEST_DEG = 3.0, 10.0


@dataclass(frozen=True)
class RealExample:
    """Features of a fit to real boxes, or to their picture too, and whether it was right."""

    with_picture: bool
    x: Array
    right: bool


def names_of(folder: Path) -> list[str]:
    """Return the names of the pictures of large panels that nothing is judged by."""
    pictures = read_labelled(folder, validation=False)
    return [p.name for p in pictures if p.is_button.sum() >= _FEWEST_BUTTONS and judgeable(p)]


def real_examples(task: tuple[str, str]) -> list[RealExample]:
    """Return the examples of one picture: (folder, name)."""
    folder, name = task
    (picture,) = read_labelled(Path(folder), names=(name,))
    rng = np.random.default_rng([int(name), 5])
    truth = _truth(picture)
    if truth is None:
        return []
    fit, camera = truth
    detections, photo = true_detections(picture), Photo(picture.image, camera)
    found = []
    for chosen in _subsets(fit, rng):
        found += _examples([detections[k] for k in chosen], photo, fit)
    everyone = _all_names(folder)
    other = everyone[int(rng.integers(len(everyone)))]
    if other != name:
        (stranger,) = read_labelled(Path(folder), names=(other,))
        found += _examples(true_detections(stranger), photo, None)
    return found


@cache
def _all_names(folder: str) -> list[str]:
    return sorted(p.stem for p in (Path(folder) / "pictures").glob("*.jpg"))


def _truth(picture: LabelledPicture) -> tuple[GridFit, Camera] | None:
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


def _subsets(fit: GridFit, rng: np.random.Generator) -> Iterator[IntArray]:
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


def _examples(detections: list[Detection], photo: Photo, truth: FitResult | None) -> list[RealExample]:
    """Return an example of the fit to the boxes, and one of every search's fit to the picture."""
    usable, sigma, refused = admitted(detections, photo.camera, _CONFIG)
    if refused is not None:
        return []
    found = []
    best = best_attempt(usable, photo.camera, sigma, _CONFIG)
    # The boxes of another picture may be right by themselves.
    if truth is not None and best.fit is not None and np.isfinite(best.result.covariance).all():
        x = features(best.fit.best, best.fit.margin, sigma, best.result, usable, photo.camera)
        found.append(RealExample(False, x, _right(best.result, truth)))
    for attempt, fit in searched(usable, sigma, photo):
        right = _right(fit.result, truth)
        found.append(RealExample(True, picture_features(fit, attempt.result, usable, sigma, photo.camera), right))
        if right and attempt.result.ok:
            break
    return found


def _right(fit: FitResult, truth: FitResult | None) -> bool:
    if truth is None:
        return False
    error = float(np.rad2deg(rotation_angle_rad(truth.R_camera_panel.T @ fit.R_camera_panel)))
    return as_stated(error, fit.covariance, _RIGHT_DEG)


def searched(usable: Usable, sigma: float, photo: Photo) -> Iterator[tuple[Attempt, PictureFit]]:
    """Yield every search that finds a fit, with the fit to the picture that it leads to."""
    for attempt in attempts(usable, photo.camera, sigma, _CONFIG):
        if attempt.fit is None or not np.isfinite(attempt.result.covariance).all():
            continue
        fit = picture_fit(attempt.fit, attempt.result, usable, sigma, photo, _CONFIG)
        if fit is not None and np.isfinite(fit.result.covariance).all():
            yield attempt, fit


def as_stated(error_deg: float, covariance: Array, floor_deg: float) -> bool:
    """Tell whether a rotation is off by no more than floor_deg, or than its covariance (6, 6) of the pose says."""
    own = float(np.rad2deg(rotation_std_rad(covariance)))
    return error_deg <= max(floor_deg, min(_STDS * own, _FARTHEST_DEG))
