"""Examples for the confidence of fits, from labelled pictures of real panels: parts of large ones, and boxes of another
picture, which are never right."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from elevator_rectify.benchmark.end_to_end import true_detections
from elevator_rectify.benchmark.parts_of_panels import is_large, is_right, parts, true_fit
from elevator_rectify.core import Config, Detection
from elevator_rectify.core.attempts import Attempt, attempts, best_attempt
from elevator_rectify.core.confidence import features
from elevator_rectify.core.detections import Usable
from elevator_rectify.core.picture.fit import PictureFit, picture_features, picture_fit
from elevator_rectify.core.picture.straight_edges import Photo
from elevator_rectify.core.pipeline import admitted
from elevator_rectify.core.types import Array, FitResult
from elevator_rectify.train.labelled import read_labelled

_CONFIG = Config()


@dataclass(frozen=True)
class RealExample:
    """Features of a fit to real boxes, or to their picture too, and whether it was right."""

    with_picture: bool
    x: Array
    right: bool


def names_of(folder: Path) -> list[str]:
    """Return the names of the pictures of large panels that nothing is judged by."""
    pictures = read_labelled(folder, validation=False)
    return [p.name for p in pictures if is_large(p)]


def real_examples(task: tuple[str, str]) -> list[RealExample]:
    """Return the examples of one picture: (folder, name)."""
    folder, name = task
    (picture,) = read_labelled(Path(folder), names=(name,))
    rng = np.random.default_rng([int(name), 5])
    truth = true_fit(picture)
    if truth is None:
        return []
    fit, camera = truth
    detections, photo = true_detections(picture), Photo(picture.image, camera)
    found = []
    for chosen in parts(fit, rng):
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
        found.append(RealExample(False, x, is_right(best.result, truth)))
    for attempt, fit in searched(usable, sigma, photo):
        right = truth is not None and is_right(fit.result, truth)
        found.append(RealExample(True, picture_features(fit, attempt.result, usable, sigma, photo.camera), right))
        if right and attempt.result.ok:
            break
    return found


def searched(usable: Usable, sigma: float, photo: Photo) -> Iterator[tuple[Attempt, PictureFit]]:
    """Yield every search that finds a fit, with the fit to the picture that it leads to."""
    for attempt in attempts(usable, photo.camera, sigma, _CONFIG):
        if attempt.fit is None or not np.isfinite(attempt.result.covariance).all():
            continue
        fit = picture_fit(attempt.fit, attempt.result, usable, sigma, photo, _CONFIG)
        if fit is not None and np.isfinite(fit.result.covariance).all():
            yield attempt, fit
