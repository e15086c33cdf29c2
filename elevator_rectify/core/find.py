"""From a picture alone: find the buttons, fit the panel, read the labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from elevator_rectify.core.config import Config
from elevator_rectify.core.detector.detect import detect_buttons
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.pipeline import DEFAULT_CONFIG, fit_panel
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.reading.reader import labelled, read_boxes, read_in_plane, read_undetected
from elevator_rectify.core.types import Detection, FitResult, Image, KnownPanel


def find_panel(
    image: Image,
    camera: Camera,
    config: Config = DEFAULT_CONFIG,
    previous: FitResult | None = None,
    known: KnownPanel | None = None,
) -> GridFit:
    """Find and fit the panel in a picture (height, width[, 3]) uint8, with labels by our own reader.

    The arguments are those of `fit_panel`, which raises ValueError for the same.
    """
    found = detect_buttons(image, config.network)
    return with_labels(fit_panel(found, camera, config, previous, image, known), image, camera)


def with_labels(fit: GridFit, image: Image, camera: Camera) -> GridFit:
    """Return the fit with labels where its detections bring none: read in the panel's plane, else as the boxes are.

    Buttons that the picture shows and nobody detected are read, too.
    """
    if fit.known is not None:
        return fit
    fit = read_undetected(image, camera, fit)
    sizes = _have_sizes(fit.detections) or (fit.ok and fit.measurement is not None)
    if not fit.detections or all(d.label for d in fit.detections) or not sizes:
        return fit
    reads = read_in_plane(image, camera, fit) if fit.ok else read_boxes(image, fit.detections)
    return replace(fit, detections=labelled(fit.detections, reads))


def _have_sizes(detections: Sequence[Detection]) -> bool:
    return all(d.width_px > 0 and d.height_px > 0 for d in detections)
