"""From detections to the panel's pose: the stages in their order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from elevator_rectify.core.camera import Camera
from elevator_rectify.core.config import Config
from elevator_rectify.core.detections import Usable, usable_detections
from elevator_rectify.core.paper import fit_paper
from elevator_rectify.core.result import failed_fit, grid_fit
from elevator_rectify.core.types import Array, Detection, GridFit

DEFAULT_CONFIG = Config()


def fit_panel(detections: Array | Sequence[Detection], camera: Camera, config: Config = DEFAULT_CONFIG) -> GridFit:
    """Fit the button grid and the panel's pose to one image's detections.

    detections: (N, 2) pixels of the (distorted) image, or a list of Detection. Never raises for what a detector may
    send: "no panel" is a result whose status and reason say why. Raises ValueError for an array of a wrong shape.
    """
    usable = usable_detections(detections, camera, config.input)
    if len(usable.index) < config.input.min_detections:
        reason = f"{len(usable.index)} usable detections, {config.input.min_detections} needed{_dropped(usable)}"
        return failed_fit("too_few_detections", reason, usable, config)
    if _is_line(usable.rays, 2.0 * config.noise.sigma_px / camera.focal_px):
        return failed_fit("collinear", "all detections lie on one line: one row or column has no pose", usable, config)
    fit = fit_paper(usable.rays, camera, config, printed=config.method == "paper_as_printed")
    return grid_fit(fit, usable, camera, config)


def _is_line(rays: Array, tolerance: float) -> bool:
    """Tell whether the points' spread across their main direction is below the noise."""
    spread = np.linalg.svd(rays - rays.mean(axis=0), compute_uv=False)
    return bool(spread[1] / np.sqrt(len(rays)) < tolerance)


def _dropped(usable: Usable) -> str:
    listed = ", ".join(f"{count} {reason}" for reason, count in usable.dropped.items())
    return f" ({listed})" if listed else ""
