"""Whether fits to parts of real panels are as often right, and as exact, as they say: the fit to all is the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from elevator_rectify.benchmark.end_to_end import true_detections
from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.parts_of_panels import is_large, is_right, parts, true_fit
from elevator_rectify.benchmark.reader import calibration_error
from elevator_rectify.benchmark.synthetic import CHI2_3
from elevator_rectify.core import Config, GridFit, fit_panel
from elevator_rectify.core.types import Array, FitResult
from elevator_rectify.train.labelled import read_labelled

_BOUNDS = (0.0, 0.25, 0.5, 0.75, 0.9, 0.95, 1.0)
_CONFIG = Config()


@dataclass(frozen=True)
class PartFit:
    """The fit to a part of a panel: by boxes or with the picture too, its confidence, whether it is right and accepted,
    its rotation's error in degrees, and that error's squared length in its covariance and in the residuals' alone."""

    with_picture: bool
    confidence: float
    right: bool
    accepted: bool
    error_deg: float
    mahalanobis2: float
    of_residuals: float


def run_panel(task: tuple[str, str]) -> list[PartFit]:
    """Fit parts of one picture's panel: (folder, name); nothing where the fit to all of it is not sure."""
    folder, name = task
    (picture,) = read_labelled(Path(folder), names=(name,))
    truth = true_fit(picture)
    if truth is None:
        return []
    whole, camera = truth
    detections = [replace(d, label="") for d in true_detections(picture)]
    found = []
    for chosen in parts(whole, np.random.default_rng([int(name), 6])):
        for image in (None, picture.image):
            fit = fit_panel([detections[k] for k in chosen], camera, _CONFIG, image=image)
            if np.isfinite(fit.covariance).all():
                found.append(_compared(fit, whole, image is not None))
    return found


def _compared(fit: GridFit, whole: FitResult, with_picture: bool) -> PartFit:
    w = cv2.Rodrigues(whole.R_camera_panel @ fit.R_camera_panel.T)[0].ravel()
    d2 = [float(w @ np.linalg.solve(C[3:6, 3:6], w)) for C in (fit.covariance, fit.shape_covariance)]
    error = float(np.rad2deg(np.linalg.norm(w)))
    return PartFit(with_picture, fit.confidence, is_right(fit, whole), fit.ok, error, *d2)


def reliability_table(folder: Path, figures: Figures) -> str:
    """Return the tables over the validation part."""
    names = [p.name for p in read_labelled(folder, validation=True) if is_large(p)]
    results = [r for r in parallel(run_panel, [(str(folder), name) for name in names], "parts of panels") if r]
    found = [fit for several in results for fit in several]
    lines = [f"parts of {len(results)} real panels, six to ten buttons each; right: as the fit to all buttons"]
    for title, with_picture in (("boxes", False), ("with picture", True)):
        lines += ["", *_lines(title, [f for f in found if f.with_picture == with_picture], figures)]
    return "\n".join(lines)


def _lines(title: str, found: list[PartFit], figures: Figures) -> list[str]:
    """Return the reliability of the confidence, and the coverage of what is accepted."""
    p, right = np.array([f.confidence for f in found]), np.array([f.right for f in found])
    lines = [f"{title:<14}{'fits':>6}{'says':>8}{'right':>8}"]
    place = np.clip(np.digitize(p, _BOUNDS) - 1, 0, len(_BOUNDS) - 2)
    for k in np.unique(place):
        here = place == k
        name = f"{_BOUNDS[k]:g} to {_BOUNDS[k + 1]:g}"
        lines.append(f"{name:<14}{here.sum():>6}{p[here].mean():>8.3f}{right[here].mean():>8.3f}")
    accepted = [f for f in found if f.accepted]
    figures.rate(f"parts of real panels, {title}, accepted+", [f.accepted for f in found])
    figures.rate(f"parts of real panels, {title}, accepted and right+", [f.right for f in accepted])
    lines.append(f"calibration error {calibration_error(p, right):.3f}")
    return [*lines, _accepted_line(accepted, len(found))]


def _accepted_line(accepted: list[PartFit], number: int) -> str:
    if not accepted:
        return f"accepted 0 of {number}"
    error: Array = np.array([f.error_deg for f in accepted])
    inside = np.mean([[d2 < CHI2_3 for d2 in (f.mahalanobis2, f.of_residuals)] for f in accepted], axis=0)
    return (
        f"accepted {len(accepted)} of {number}, right {np.mean([f.right for f in accepted]):.3f}; off by "
        f"{np.median(error):.2f} degrees medianly, {np.quantile(error, 0.95):.1f} for the 95th percentile; "
        f"inside the 95 % region {inside[0]:.3f}, by the residuals alone {inside[1]:.3f}"
    )
