"""Checks the camera's calibration while the node runs: the panels themselves say what the focal length is."""

from __future__ import annotations

import threading

import cv2
import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.rotations import rotation_angle_rad
from elevator_rectify.core.self_calibration import (
    CameraEstimate,
    PanelShape,
    Sighting,
    calibrated,
    same_shape,
    shape_of_panel,
    sighting_of,
)
from elevator_rectify.core.types import FitResult

# Views that differ less, in rotation or in distance over itself, tell nothing new.
_TURNED_RAD, _NEARER = 0.12, 0.2
# The camera is estimated at so many views; more are not kept.
_AT_VIEWS = (5, 8, 12)
# So many frames on end show another panel, or another part of it, before it begins anew.
_ANOTHER = 10


class CameraCheck:
    """Gathers views of one panel from different sides, and estimates the focal length in a thread of its own."""

    def __init__(self) -> None:
        self.estimate: CameraEstimate | None = None
        self._told = False
        self._others = 0
        self._first: FitResult | None = None
        self._camera: Camera | None = None
        self._sightings: list[Sighting] = []
        self._thread: threading.Thread | None = None

    def add(self, fit: FitResult, camera: Camera) -> None:
        """Look at an accepted frame."""
        continues = self._continues(fit, camera)
        self._others = 0 if continues else self._others + 1
        if not continues and self._first is not None and self._others < _ANOTHER:
            return
        if continues and len(self._sightings) == _AT_VIEWS[-1]:
            return
        sighting = sighting_of(fit)
        if sighting is None:
            return
        if not continues:
            self._first, self._camera, self._sightings, self.estimate = fit, camera, [], None
        if any(not _differs(sighting, other) for other in self._sightings):
            return
        self._sightings.append(sighting)
        if len(self._sightings) in _AT_VIEWS and not (self._thread and self._thread.is_alive()):
            given = list(self._sightings), shape_of_panel(fit), camera
            self._thread = threading.Thread(target=self._estimate, args=given, daemon=True)
            self._thread.start()

    def _continues(self, fit: FitResult, camera: Camera) -> bool:
        """Tell whether a fit is of the same panel and camera as those before."""
        if self._first is None or self._camera is None:
            return False
        same = self._camera.width == camera.width and np.array_equal(self._camera.matrix, camera.matrix)
        return bool(same) and same_shape(self._first, fit)

    def _estimate(self, sightings: list[Sighting], shape: PanelShape, camera: Camera) -> None:
        self.estimate = calibrated(sightings, shape, camera)

    def settled(self, seconds: float) -> bool:
        """Wait for an estimate that is being made; tell whether none is any more."""
        if self._thread is not None:
            self._thread.join(seconds)
        return self._thread is None or not self._thread.is_alive()

    @property
    def text(self) -> str:
        """Return the finding for /diagnostics, or how far the check is."""
        if self.estimate is not None:
            return str(self.estimate)
        return f"not yet known: {len(self._sightings)} views from different sides, {_AT_VIEWS[0]} needed"

    @property
    def found(self) -> str:
        """Return the finding, '' while the views do not tell."""
        return "" if self.estimate is None else str(self.estimate)

    def warning(self) -> str:
        """Return once what is wrong with the calibration, '' where nothing surely is."""
        if self._told or self.estimate is None or not self.estimate.significant:
            return ""
        self._told = True
        return f"camera_info looks wrong: {self.estimate}; calibrate the camera (the program calibrate_camera may do)"


def _differs(one: Sighting, other: Sighting) -> bool:
    """Tell whether two views are from different sides or distances."""
    R, S = (cv2.Rodrigues(s.pose[:3])[0] for s in (one, other))
    nearer = abs(float(np.log(max(one.pose[5], 1e-9) / max(other.pose[5], 1e-9))))
    return rotation_angle_rad(R.T @ S) > _TURNED_RAD or nearer > _NEARER
