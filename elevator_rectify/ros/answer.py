"""One frame's messages through the core: what the live node and the bag replay do with every frame."""

from __future__ import annotations

import time
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from elevator_rectify.core.camera import Camera
from elevator_rectify.core.config import Config
from elevator_rectify.core.draw import draw_overlay
from elevator_rectify.core.pipeline import fit_panel
from elevator_rectify.core.types import Array, GridFit, Image, Rectification
from elevator_rectify.core.warp import rectify_image
from elevator_rectify.ros.convert import BadMessage, camera_from_message, detections_from_message, image_from_message
from elevator_rectify.ros.pairing import Frame


@dataclass
class Stopwatch:
    """Milliseconds by stage."""

    milliseconds: dict[str, float] = field(default_factory=dict)
    _last: float = field(default_factory=time.perf_counter)

    def lap(self, stage: str) -> None:
        """Book the time since the last lap on `stage`."""
        now = time.perf_counter()
        self.milliseconds[stage] = self.milliseconds.get(stage, 0.0) + 1e3 * (now - self._last)
        self._last = now


@dataclass(frozen=True)
class Answer:
    """What is published for one frame; `header` is the image's."""

    header: Any
    fit: GridFit
    detections: int = 0
    camera: Camera | None = None
    view: Rectification | None = None
    overlay: Image | None = None
    stopwatch: Stopwatch = field(default_factory=Stopwatch)


def answer_frame(frame: Frame, config: Config, wanted: Collection[str] = ("rectified", "overlay")) -> Answer:
    """Convert, fit, draw. A frame with a bad message gets the status 'bad_input' and the reason; nothing is raised.

    wanted: which pictures to make, of 'rectified' and 'overlay'.
    """
    watch = Stopwatch()
    try:
        image = image_from_message(frame.image)
        camera = _matching_camera(frame, image)
        detections = detections_from_message(frame.detections)
    except BadMessage as error:
        return Answer(
            frame.image.header, GridFit(status="bad_input", reason=str(error), method=config.method), stopwatch=watch
        )
    watch.lap("convert")
    fit = fit_panel(detections, camera, config)
    watch.lap("fit")
    view = rectify_image(image, camera, fit, config.view) if fit.ok and "rectified" in wanted else None
    watch.lap("warp")
    centres = np.array([[d.x_px, d.y_px] for d in detections]).reshape(-1, 2)
    overlay = draw_overlay(image, _finite(centres), fit) if "overlay" in wanted else None
    watch.lap("overlay")
    return Answer(frame.image.header, fit, len(detections), camera, view, overlay, watch)


def _matching_camera(frame: Frame, image: Image) -> Camera:
    """Return the frame's camera, which must be of the image's size."""
    camera = camera_from_message(frame.camera_info)
    if (camera.height, camera.width) != image.shape[:2]:
        size = f"{camera.width} x {camera.height}"
        raise BadMessage(
            "camera_info", "width x height", size, f"is not the image's {image.shape[1]} x {image.shape[0]}"
        )
    return camera


def _finite(points: Array) -> Array:
    return points[np.isfinite(points).all(axis=1)]
