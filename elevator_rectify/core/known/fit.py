"""The pose of a taught panel: which of its buttons the detections are, and whether it is this panel at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from elevator_rectify.core.config import Config
from elevator_rectify.core.detections import Usable
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.known.evidence import reading_nats
from elevator_rectify.core.known.matches import Matches, Scene, ranked, scored, searched, tracked
from elevator_rectify.core.known.placed import placed_layout, with_shape_known
from elevator_rectify.core.known.result import by_boxes, by_picture
from elevator_rectify.core.known.verdict import FEWEST, identified, places
from elevator_rectify.core.lattice.layout import LayoutFit, evaluate, refine_layout
from elevator_rectify.core.picture.measured import measure
from elevator_rectify.core.reading.reader import labelled, read_in_plane
from elevator_rectify.core.result import failed_fit, known_well
from elevator_rectify.core.types import Detection, FitResult, Image, KnownPanel

# A tracked match whose margin is above needs no reading.
_CLEAR_NATS = 12.0
# So far, in pitches, the picture may show the buttons from where they were taught: in 99 of 100 real views it was less.
_MOST_RESIDUAL = 0.035
# Such a share of the detections may be taken for another button in the picture than by their places.
_MOST_SLIPPED = 0.05


def fit_known(
    usable: Usable,
    detections: Sequence[Detection],
    camera: Camera,
    sigma: float,
    config: Config,
    known: KnownPanel,
    previous: FitResult | None = None,
    image: Image | None = None,
) -> FitResult:
    """Fit the pose of a taught panel. sigma: of the usable detections in normalised units; detections: all, as given.

    Detections without a label are read in the picture, but where they follow the frame before and no other part of the
    panel explains them nearly as well.
    """
    scene = Scene(usable, camera, sigma, with_shape_known(config, known), placed_layout(known), known)
    refused = failed_fit("too_few_detections", "", usable, config)
    if len(usable.index) < FEWEST:
        return replace(refused, reason=f"{len(usable.index)} usable detections, {FEWEST} needed on '{known.name}'")
    read = [detections[k] if detections else Detection(0.0, 0.0) for k in usable.index]
    evidence = reading_nats(read, known.labels)
    matches = tracked(scene, evidence, previous)
    follows = matches is not None
    matches = matches or searched(scene, evidence)
    if matches is None:
        return replace(refused, status="unknown_panel", reason=f"no pose of '{known.name}' explains the detections")
    if image is not None and detections and not (follows and matches.margin > _CLEAR_NATS):
        read = _read(scene, matches, detections, image)
        matches = ranked(scored(scene, matches.poses, reading_nats(read, known.labels)))
    best = _refined(scene, matches)
    fit = identified(scene, matches, by_boxes(best, scene), read, follows)
    if fit.ok and image is not None:
        fit = _in_picture(scene, best, fit, image)
    return known_well(fit, config, config.accept.min_confidence) if fit.ok else fit


def _in_picture(scene: Scene, best: LayoutFit, boxes: FitResult, image: Image) -> FitResult:
    """Return the fit to the picture; the boxes' own where it does not show enough of the buttons."""
    usable, config = scene.usable, scene.config
    measured = measure(best, usable.rays, usable.sizes_px, scene.sigma, image, scene.camera, config, halve=False)
    if measured is None or measured.places.seen[measured.places.detected].mean() < config.measurement.min_seen_share:
        return boxes
    fit = by_picture(measured, boxes, scene)
    both = (fit.matched >= 0) & (boxes.matched >= 0)
    # Where buttons are small, the picture may slip to their neighbours.
    if both.any() and (fit.matched != boxes.matched)[both].mean() > _MOST_SLIPPED:
        return boxes
    if measured.residual <= _MOST_RESIDUAL:
        return fit
    reason = f"this is not '{scene.known.name}': the picture shows its buttons {measured.residual:.2f} pitches off"
    return replace(fit, status="unknown_panel", reason=reason)


def _read(scene: Scene, matches: Matches, detections: Sequence[Detection], image: Image) -> list[Detection]:
    """Return the usable detections with what our own reader reads where they bring no label."""
    fit = by_boxes(_refined(scene, matches), scene)
    given, rays = tuple(detections), fit.rays.copy()
    if not all(d.label for d in given):
        # What lies elsewhere may even be beyond the plane's horizon.
        rays[scene.usable.index[~places(scene, matches)[0]]] = np.nan
        given = labelled(given, read_in_plane(image, scene.camera, replace(fit, rays=rays, detections=given)))
    return [given[k] for k in scene.usable.index]


def _refined(scene: Scene, matches: Matches) -> LayoutFit:
    """Return the best match fitted to the end."""
    usable, joint = scene.usable, scene.config.joint
    fit = evaluate(matches.best, scene.layout, usable.rays, scene.sigma, scene.area, joint)
    return refine_layout(fit, usable.rays, scene.sigma, scene.area, joint)
