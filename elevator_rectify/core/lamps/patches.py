"""Buttons as they look in the panel's plane, in colour, so that two moments can be compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.types import Array, Button, FitResult, Image

# Samples along a patch's side, what it shows over the button's own size, and the blur that forgives half a sample.
SIDE, MARGIN, _BLUR = 24, 1.5, 0.8
# A patch is sampled so many times finer at most, then averaged.
_FINEST = 4
_SQUARE = 0.5 * MARGIN * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


@dataclass(frozen=True)
class Patches:
    """K buttons: patches (K, n, n, 3) BGR float32, places on the panel (K, 2) in column pitches, canonical labels (K,),
    the smaller side (K,) of each in the picture in pixels; whole: (K,) whether it is all in the picture."""

    colour: Image
    places: Array
    labels: tuple[str, ...]
    side_px: Array
    whole: Array


def patches_of(image: Image, camera: Camera, fit: FitResult, buttons: Sequence[Button]) -> Patches:
    """Return the patches of those buttons of an accepted fit that were detected, in a picture (height, width[, 3])."""
    buttons = [button for button in buttons if button.detection >= 0]
    colour = image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    corners = [camera.project(b.point + (_SQUARE * b.size) @ fit.R_camera_panel[:, :2].T) for b in buttons]
    corners_px = np.array(corners).reshape(-1, 4, 2)
    inside = (corners_px >= 0.0) & (corners_px <= np.array([camera.width - 1.0, camera.height - 1.0]))
    sides = np.linalg.norm(np.diff(corners_px, axis=1), axis=-1).reshape(len(corners_px), 3)
    return Patches(
        np.array([_patch(colour, c) for c in corners_px], dtype=np.float32).reshape(-1, SIDE, SIDE, 3),
        np.array([b.panel for b in buttons]).reshape(-1, 2) / fit.column_pitch,
        tuple(b.label for b in buttons),
        np.asarray(sides.min(axis=1) / MARGIN),
        np.asarray(inside.all(axis=(1, 2))),
    )


def _patch(colour: Image, corners_px: Array) -> Image:
    """Return the patch (n, n, 3) within four corners (4, 2), averaged where the picture is finer."""
    side = np.sqrt(max(1.0, abs(cv2.contourArea(corners_px.astype(np.float32)))))
    fine = int(np.clip(np.ceil(side / SIDE), 1, _FINEST))
    target = (_CORNERS * SIDE * fine - 0.5).astype(np.float32)
    M = cv2.getPerspectiveTransform(corners_px.astype(np.float32), target)
    patch = cv2.warpPerspective(colour, M, (SIDE * fine, SIDE * fine), borderMode=cv2.BORDER_REPLICATE)
    small = cv2.resize(patch, (SIDE, SIDE), interpolation=cv2.INTER_AREA).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(small, (0, 0), _BLUR))
