"""How honest the covariance is where the camera's calibration is wrong: rendered panels, fitted with another camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.pictures import pictured
from elevator_rectify.benchmark.synthetic import CHI2_3, judged
from elevator_rectify.core import Camera, fit_panel

# What is wrong: the focal length over the true one, and the lens's first radial coefficient.
CALIBRATIONS = {
    "exact": (1.0, 0.0),
    "f 5 % too long": (1.05, 0.0),
    "f 5 % too short": (0.95, 0.0),
    "k1 too high by .05": (1.0, 0.05),
    "k1 too low by .05": (1.0, -0.05),
}


@dataclass(frozen=True)
class Outcome:
    """One fit with a wrong camera: the error in degrees, and its squared length in the fit's own covariance."""

    calibration: str
    with_picture: bool
    accepted: bool
    error_deg: float
    mahalanobis2: float


def wrong_camera(camera: Camera, focal_share: float, k1: float) -> Camera:
    """Return a camera without distortion as a calibration that is off knows it."""
    K = camera.matrix * np.array([[focal_share, 1.0, 1.0], [1.0, focal_share, 1.0], [1.0, 1.0, 1.0]])
    return Camera.from_matrix(K, camera.width, camera.height, [k1, 0.0, 0.0, 0.0])


def run_scene(task: tuple[str, int, int]) -> list[Outcome]:
    """Fit one rendered panel with every calibration: (level, seed, number)."""
    given = pictured(*task, held_out=True)
    found = []
    for name, wrong in CALIBRATIONS.items():
        camera = wrong_camera(given.scene.camera, *wrong)
        for image in (None, given.image):
            fit = fit_panel(given.scene.detections, camera, image=image)
            trial = judged(given.scene, fit, 0.0)
            found.append(Outcome(name, image is not None, fit.ok, trial.error_deg, trial.mahalanobis2))
    return found


def inexact_table(levels: list[str], scenes: int, seed: int, figures: Figures) -> str:
    """Return the table over so many rendered panels of every level."""
    lines = [f"{'':<29}{'boxes: accept med deg   cover':>30}{'picture: accept med deg   cover':>34}"]
    for level in levels:
        tasks = [(level, seed, number) for number in range(scenes)]
        found = [o for several in parallel(run_scene, tasks, level) for o in several]
        for name in CALIBRATIONS:
            mine = [o for o in found if o.calibration == name]
            boxes, picture = ([o for o in mine if o.with_picture == shown] for shown in (False, True))
            by_boxes = _columns(boxes, f"{level} boxes, calibration {name}", figures)
            by_picture = _columns(picture, f"{level} picture, calibration {name}", figures)
            lines.append(f"{level:<8}{name:<21}{by_boxes:>30}{by_picture:>33}")
    return "\n".join(lines)


def _columns(found: list[Outcome], name: str, figures: Figures) -> str:
    """Return the share of the accepted, their median error, and the coverage, which is kept as a figure."""
    good = [o for o in found if o.accepted]
    inside = [o.mahalanobis2 < CHI2_3 for o in good]
    figures.rate(f"{name}, coverage+", inside)
    if not good:
        return f"{0.0:.3f}{np.nan:>8.2f}{np.nan:>8.3f}"
    return f"{len(good) / len(found):.3f}{np.median([o.error_deg for o in good]):>8.2f}{np.mean(inside):>8.3f}"
