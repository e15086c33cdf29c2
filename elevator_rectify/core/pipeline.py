"""From detections to the panel's pose: the stages in their order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from elevator_rectify.core.attempts import best_attempt, grew, tracked
from elevator_rectify.core.config import Config
from elevator_rectify.core.detections import Usable, usable_detections
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.common_errors import with_common_errors
from elevator_rectify.core.geometry.same_places import stayed
from elevator_rectify.core.geometry.scale import as_far_apart
from elevator_rectify.core.known.file import known_panel
from elevator_rectify.core.known.fit import fit_known
from elevator_rectify.core.lattice.marks import MARK, marks_as_before, second_lines
from elevator_rectify.core.left_out import undoubted
from elevator_rectify.core.outline.result import few_fit
from elevator_rectify.core.paper.rounds import fit_paper
from elevator_rectify.core.picture.witness import contradicted, second_opinion
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.reading.reader import no_buttons
from elevator_rectify.core.reading.upright import way_up
from elevator_rectify.core.result import failed_fit, paper_fit
from elevator_rectify.core.types import Array, Detection, FitResult, Image, KnownPanel

DEFAULT_CONFIG = Config()
# The ratio of the pitches is not known better, as a share; poses have none that is larger.
_LEAST_RATIO_STD, _MOST_LOG_ASPECT = 1e-3, 1.5


def fit_panel(
    detections: Array | Sequence[Detection],
    camera: Camera,
    config: Config = DEFAULT_CONFIG,
    previous: FitResult | None = None,
    image: Image | None = None,
    known: KnownPanel | None = None,
) -> GridFit:
    """Fit the button grid and the panel's pose to one image's detections.

    detections: (N, 2) pixels of the (distorted) image, or a list of Detection. previous: an accepted fit of the frame
    before, from which the joint method starts; where it does not explain this frame, the fit is made from scratch.
    image: (height, width[, 3]) uint8, in which the joint method measures the buttons: several times as exact as boxes.
    known: a taught panel, by default that of `config.panel.file`: then only its pose is sought, and another panel is
    refused as 'unknown_panel'.
    Never raises for what a detector may send: "no panel" is a result whose status and reason say why. Raises
    ValueError for an array of a wrong shape, an image of another size than the camera, a panel file that is none.
    """
    if image is not None and (image.dtype != np.uint8 or image.shape[:2] != (camera.height, camera.width)):
        size = f"{camera.width} x {camera.height}"
        raise ValueError(f"image must be uint8 of the camera's {size}, not {image.dtype} of shape {image.shape}")
    given, known = _as_given(detections), known or known_panel(config.panel)
    if known is not None:
        usable = usable_detections(detections, camera, config.input)
        sigma = sigma_px(usable, camera, config) / camera.focal_px
        fit = fit_known(usable, given, camera, sigma, config, known, previous, image)
        fit = with_common_errors(fit, config.joint)
        return GridFit.of(fit, detections=given)
    config = with_pitches(config)
    fit = _fit(detections, camera, config, previous, image)
    if image is not None and config.measurement.witness:
        fit = _upright(fit, camera, previous, image, given, not config.target.camera_is_upright)
        fit = replace(fit, undetected=_no_buttons(fit, camera, previous, image))
    fit = with_common_errors(fit, config.joint)
    return GridFit.of(fit, detections=given, plates_on_left=config.labels.plates_on_left)


def with_pitches(config: Config) -> Config:
    """Return the settings with the ratio of the pitches where both are known: it tells much of the tilt."""
    scale = config.scale
    if not (scale.row_pitch_m > 0 and scale.column_pitch_m > 0):
        return config
    spread = np.hypot(scale.row_pitch_std_m / scale.row_pitch_m, scale.column_pitch_std_m / scale.column_pitch_m)
    ratio = float(np.clip(np.log(scale.row_pitch_m / scale.column_pitch_m), -_MOST_LOG_ASPECT, _MOST_LOG_ASPECT))
    std = float(np.clip(spread, _LEAST_RATIO_STD, config.joint.log_aspect_std))
    return replace(config, joint=replace(config.joint, log_aspect=ratio, log_aspect_std=std))


def _upright(
    fit: FitResult,
    camera: Camera,
    previous: FitResult | None,
    image: Image,
    detections: tuple[Detection, ...],
    on_head: bool,
) -> FitResult:
    """Return the fit, as ambiguous where the panel's labels lie on their side, stand on their head (on_head), or are
    mirrored.

    Those that were seen upright in the frame before are not asked.
    """
    if not fit.ok or not detections:
        return fit
    if previous is not None and previous.ok and _same_grid(fit, previous):
        return replace(fit, labels_upright=previous.labels_upright)
    labels = way_up(image, camera, fit, detections, on_head)
    if labels.mirrored:
        return replace(fit, status="ambiguous", reason="the labels are mirrored: it is a panel's image in a mirror")
    if not labels.quarter_turns:
        return replace(fit, labels_upright=labels.upright)
    along = fit.R_camera_panel[:2, 0]
    roll = np.arctan2(along[1], along[0]) + labels.quarter_turns * np.pi / 2
    roll = float(np.arctan2(np.sin(roll), np.cos(roll)))
    way_out = f"set joint.camera_roll_rad to {roll:.2f}, or turn the camera"
    reason = f"the labels are turned by {90 * labels.quarter_turns} degrees: {way_out}"
    return replace(fit, status="ambiguous", reason=reason)


def _no_buttons(
    fit: FitResult, camera: Camera, previous: FitResult | None, image: Image
) -> dict[tuple[int, int], Detection | None]:
    """Return the cells that look like the buttons to the template, but to our own reader like none."""
    if previous is not None and previous.ok and _same_grid(fit, previous):
        # What is no button stays none; what was one in the frame before is not asked again.
        return {cell: None for cell, button in previous.undetected.items() if button is None}
    return dict.fromkeys(no_buttons(image, camera, fit))


def _same_grid(fit: FitResult, previous: FitResult) -> bool:
    """Tell whether the cells are the previous frame's, and nothing was seen in them that was not seen then."""
    if not stayed(fit, previous) or fit.measurement is None or previous.measurement is None:
        return False
    new = np.isfinite(fit.measurement.correlation) & ~np.isfinite(previous.measurement.correlation)
    return not new.any()


def _fit(
    detections: Array | Sequence[Detection],
    camera: Camera,
    config: Config,
    previous: FitResult | None,
    image: Image | None,
) -> FitResult:
    """Run the stages in their order."""
    usable, sigma, refused = admitted(detections, camera, config)
    if refused is not None:
        return _by_outlines(usable, camera, config, image, refused)
    if config.method == "joint":
        last = _tracked(usable, camera, sigma, config, previous, image) if previous is not None else None
        if last is not None and previous is not None and not grew(last, previous):
            return last
        # A picture is worth searching where more of the boxes are on a lattice than before.
        if last is not None and last.ok and image is not None and not _more(last, usable, camera, sigma, config):
            return last
        fresh = undoubted(_searched(usable, camera, sigma, config, image), usable, camera, sigma, config, image)
        return last if last is not None and last.ok and not (fresh.ok and fresh.inliers > last.inliers) else fresh
    fit = fit_paper(usable.rays, camera, config, printed=config.method == "paper_as_printed")
    return paper_fit(fit, usable, camera, config)


def _tracked(
    usable: Usable, camera: Camera, sigma: float, config: Config, previous: FitResult, image: Image | None
) -> FitResult | None:
    """Return the previous fit moved to the buttons, without the marks beside them; None where it explains them not."""
    buttons = usable.without(marks_as_before(previous, usable.rays, usable.log_sizes))
    fit = tracked(buttons, camera, sigma, config, previous, image)
    return None if fit is None else as_far_apart(fit, previous)


def _more(last: FitResult, usable: Usable, camera: Camera, sigma: float, config: Config) -> bool:
    """Tell whether a search by the boxes alone explains one that the tracked fit leaves out."""
    boxes = _searched(usable, camera, sigma, config, None)
    return bool((boxes.cells[last.cells[:, 0] < 0, 0] >= 0).any())


def _searched(usable: Usable, camera: Camera, sigma: float, config: Config, image: Image | None) -> FitResult:
    """Return the best fit to the buttons, without the marks beside every one that would double the grid."""
    fit = best_attempt(usable, camera, sigma, config, image).result
    smaller, by = second_lines(fit, usable.index, usable.log_sizes)
    if by > MARK and (~smaller).sum() >= config.input.min_detections:
        return best_attempt(usable.without(smaller), camera, sigma, config, image).result
    if by > 0.0 and fit.ok:
        reason = "boxes are smaller on every second line: marks beside the buttons? see detections.ignore"
        return replace(fit, status="ambiguous", reason=reason)
    return fit


def admitted(
    detections: Array | Sequence[Detection], camera: Camera, config: Config
) -> tuple[Usable, float, FitResult | None]:
    """Return the usable detections, the standard deviation of their rays, and why their centres carry no pose, or None.

    The fit and the calibration of its confidence admit the same detections by this.
    """
    usable = usable_detections(detections, camera, config.input)
    sigma = sigma_px(usable, camera, config) / camera.focal_px
    if len(usable.index) < config.input.min_detections:
        reason = f"{len(usable.index)} usable detections, {config.input.min_detections} needed{_dropped(usable)}"
        return usable, sigma, failed_fit("too_few_detections", reason, usable, config)
    if _is_line(usable.rays, 2.0 * sigma):
        reason = "all detections lie on one line: one row or column has no pose by its centres"
        return usable, sigma, failed_fit("collinear", reason, usable, config)
    return usable, sigma, None


def _by_outlines(usable: Usable, camera: Camera, config: Config, image: Image | None, refused: FitResult) -> FitResult:
    """Return the fit to the few buttons' outlines, where there is a picture of them."""
    if image is None or config.method != "joint" or not len(usable.index):
        return refused
    fit = few_fit(usable, camera, config, image, refused)
    if not (fit.ok and config.measurement.witness):
        return fit
    centres = camera.project(np.column_stack([usable.rays, np.ones(len(usable.rays))]))
    return contradicted(fit, second_opinion(image, centres, usable.sizes_px, config.network))


def fit_panels(
    detections: Array | Sequence[Detection],
    camera: Camera,
    config: Config = DEFAULT_CONFIG,
    image: Image | None = None,
) -> list[GridFit]:
    """Fit all panels of one image, the best supported first; each with its own status, the last one may be none.

    Every further panel is fitted to the detections that the ones before left out; `cells` index the whole input.
    """
    fits: list[GridFit] = []
    left = np.arange(len(detections))
    while True:
        subset = [detections[int(k)] for k in left]
        points = subset if subset and isinstance(subset[0], Detection) else np.array(subset).reshape(-1, 2)
        fit = fit_panel(points, camera, config, image=image)
        if fits and not np.isfinite(fit.t_camera_panel).all():
            return _apart(fits)
        cells = np.full((len(detections), 2), -1, dtype=np.int64)
        rays = np.full((len(detections), 2), np.nan)
        cells[left], rays[left[: len(fit.rays)]] = fit.cells, fit.rays
        fits.append(replace(fit, cells=cells, rays=rays, detections=_as_given(detections)))
        taken = fit.cells[:, 0] >= 0
        if not taken.any() or len(left) - taken.sum() < config.input.min_detections:
            return _apart(fits)
        left = left[~taken]


def _apart(fits: list[GridFit]) -> list[GridFit]:
    """Return the fits, none of which takes another's buttons for its own."""
    taken = np.array([fit.cells[:, 0] >= 0 for fit in fits])
    return [
        replace(fit, rays=np.where((taken.any(axis=0) & ~own)[:, None], np.nan, fit.rays))
        for fit, own in zip(fits, taken, strict=True)
    ]


def _as_given(detections: Array | Sequence[Detection]) -> tuple[Detection, ...]:
    """Return a list's detections; none for an array of points."""
    given = tuple(d for d in detections if isinstance(d, Detection))
    return given if len(given) == len(detections) else ()


def sigma_px(usable: Usable, camera: Camera, config: Config) -> float:
    """Return the standard deviation of the detected centres: of boxes a share of their size, else by the image's."""
    sizes = np.sqrt(usable.sizes_px).prod(axis=1)
    if len(sizes) and (sizes > 0).all():
        return max(config.noise.min_sigma_px, config.noise.sigma_per_size * float(np.median(sizes)))
    return config.noise.sigma_px * max(1.0, max(camera.width, camera.height) / 640.0)


def _is_line(rays: Array, tolerance: float) -> bool:
    """Tell whether the points' spread across their main direction is below the noise."""
    spread = np.linalg.svd(rays - rays.mean(axis=0), compute_uv=False)
    return bool(spread[1] / np.sqrt(len(rays)) < tolerance)


def _dropped(usable: Usable) -> str:
    listed = ", ".join(f"{count} {reason}" for reason, count in usable.dropped.items())
    return f" ({listed})" if listed else ""
