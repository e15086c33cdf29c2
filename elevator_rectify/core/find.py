"""From a picture alone: find the buttons, fit the panel, read the labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from elevator_rectify.core.config import Config
from elevator_rectify.core.detector.detect import detect_buttons
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.outline.result import METHOD as OUTLINES
from elevator_rectify.core.pipeline import DEFAULT_CONFIG, fit_panel
from elevator_rectify.core.reading.carried import as_before, same_buttons
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.reading.reader import labelled, read_boxes, read_in_plane, read_undetected
from elevator_rectify.core.result import known_well
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
    fit = of_own_boxes(fit_panel(found, camera, config, previous, image, known), config)
    return with_labels(fit, image, camera)


def of_own_boxes(fit: GridFit, config: Config) -> GridFit:
    """Return the fit to our own detector's boxes: of few, by their outlines, as sure as that one of them is a button.

    A single box may be a screw. Our detector's scores are probabilities; what other detectors' are, nobody knows.
    """
    if not fit.ok or fit.method != OUTLINES:
        return fit
    used = [d.score for d, cell in zip(fit.detections, fit.cells, strict=True) if cell[0] >= 0]
    button = 1.0 - float(np.prod([1.0 - score for score in used]))
    return known_well(replace(fit, confidence=fit.confidence * button), config, config.accept.min_confidence)


def with_labels(fit: GridFit, image: Image, camera: Camera, last: FitResult | None = None) -> GridFit:
    """Return the fit with labels where its detections bring none: read in the panel's plane, else as the boxes are.

    Buttons that the picture shows and nobody detected are read, too. last: a fit with labels to a frame just before;
    buttons that are where they were then are not read again.
    """
    if fit.known is not None:
        return fit
    fit = read_undetected(image, camera, fit, last)
    sizes = _have_sizes(fit.detections) or (fit.ok and fit.measurement is not None)
    if not fit.detections or all(d.label for d in fit.detections) or not sizes:
        return fit
    given: dict[int, Detection] = {}
    if last is not None:
        before = same_buttons(fit, last)
        given = {k: as_before(fit.detections[k], last.detections[n]) for k, n in before.items()}
        given = {k: d for k, d in given.items() if not fit.detections[k].label}
    unread = [k for k, d in enumerate(fit.detections) if not d.label and k not in given]
    boxes = [fit.detections[k] for k in unread]
    reads = read_in_plane(image, camera, fit, unread) if fit.ok else read_boxes(image, boxes)
    given |= dict(zip(unread, labelled(boxes, reads), strict=True))
    return replace(fit, detections=tuple(given.get(k, d) for k, d in enumerate(fit.detections)))


def _have_sizes(detections: Sequence[Detection]) -> bool:
    return all(d.width_px > 0 and d.height_px > 0 for d in detections)
