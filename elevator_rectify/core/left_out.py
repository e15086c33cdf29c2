"""Buttons that the picture shows and the detections left out: with them, is the panel still the same one?

Of a third of a panel's buttons another lattice can be as good as the true one, a diagonal one mostly: it is sparse, or
it leans.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elevator_rectify.core.attempts import best_attempt
from elevator_rectify.core.config import Config
from elevator_rectify.core.detections import Usable
from elevator_rectify.core.detector.detect import find_boxes
from elevator_rectify.core.detector.peaks import centres_of
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.rotations import rotation_angle_rad
from elevator_rectify.core.types import Array, FitResult, Image

# Fits that fill fewer of their cells, or lean by more, are looked at again.
_SPARSE, _LEANING_RAD = 0.7, np.deg2rad(25.0)
# So many buttons must have been left out, this hot, and as far from every box, in sizes, to ask what they say.
_LEAST, _HEAT, _APART = 2, 0.25, 0.6
# Another lattice differs by so much; the same one, from boxes alone, by less.
_OTHER_RAD = np.deg2rad(15.0)


def undoubted(
    fit: FitResult, usable: Usable, camera: Camera, sigma: float, config: Config, image: Image | None
) -> FitResult:
    """Return the fit; as ambiguous where it is doubtful, and the detections with the buttons that our own detector sees
    beside them give another lattice."""
    if not fit.ok or image is None or not config.measurement.witness or not _doubtful(fit, config):
        return fit
    boxes = _left_out(usable, camera, image, config)
    if len(boxes) < _LEAST:
        return fit
    other = best_attempt(_with_boxes(usable, boxes, camera), camera, sigma, config).result
    if not other.ok or rotation_angle_rad(other.R_camera_panel.T @ fit.R_camera_panel) < _OTHER_RAD:
        return fit
    reason = f"with the {len(boxes)} buttons that the picture shows beside the boxes the grid is another one"
    return replace(fit, status="ambiguous", reason=reason)


def _doubtful(fit: FitResult, config: Config) -> bool:
    """Tell whether the grid is sparse, or leans against the camera's upright."""
    filled = len(np.unique(fit.cells[fit.cells[:, 0] >= 0], axis=0)) / float(fit.rows * fit.columns)
    lean = np.arctan2(fit.R_camera_panel[1, 0], fit.R_camera_panel[0, 0]) - config.joint.camera_roll_rad
    return bool(filled < _SPARSE or abs(np.arctan2(np.sin(lean), np.cos(lean))) > _LEANING_RAD)


def _left_out(usable: Usable, camera: Camera, image: Image, config: Config) -> Array:
    """Return centres and sizes (M, 4) in pixels of the buttons that our own detector sees and no box has."""
    found = find_boxes(image, config.network)
    boxes = found.boxes_px[found.is_button & (found.heat > _HEAT)]
    centres, sizes = centres_of(boxes), np.maximum(boxes[:, 2:] - boxes[:, :2], 1.0)
    off = np.abs(centres[:, None] - camera.pixels(usable.rays)[None]) / sizes[:, None]
    apart = off.max(axis=2).min(axis=1, initial=np.inf) > _APART
    return np.asarray(np.column_stack([centres, sizes])[apart])


def _with_boxes(usable: Usable, boxes: Array, camera: Camera) -> Usable:
    more = np.arange(usable.number, usable.number + len(boxes))
    return replace(
        usable,
        number=usable.number + len(boxes),
        index=np.append(usable.index, more),
        rays=np.vstack([usable.rays, camera.rays(boxes[:, :2])]),
        sizes_px=np.vstack([usable.sizes_px, boxes[:, 2:]]),
    )
