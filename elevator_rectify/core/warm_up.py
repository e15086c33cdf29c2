"""Lets the first frame find everything compiled and loaded: the kernels, the models, the networks."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from elevator_rectify.core.config import Config
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.lamps.lit import lamps_of
from elevator_rectify.core.pipeline import fit_panel
from elevator_rectify.core.types import Detection, Image

_PITCH_PX, _BUTTON_PX = 60.0, 36.0


def warm_up(config: Config, with_picture: bool = True) -> None:
    """Fit a drawn panel of 12 buttons by its boxes, and by its picture if asked for, from scratch and tracked."""
    camera = Camera(np.array([[600.0, 0.0, 160.0], [0.0, 600.0, 160.0], [0.0, 0.0, 1.0]]), 320, 320)
    detections = [
        Detection(70.0 + _PITCH_PX * column, 70.0 + _PITCH_PX * row, _BUTTON_PX, _BUTTON_PX)
        for row in range(4)
        for column in range(3)
    ]
    # A panel that was taught is another one.
    config = replace(config, panel=replace(config.panel, file=""))
    for image in (None, _drawn(detections)) if with_picture else (None,):
        fit = fit_panel(detections, camera, config, image=image)
        fit_panel(detections, camera, config, previous=fit, image=image)
        if image is not None and fit.ok:
            lamps_of(image, camera, fit, fit.buttons)


def _drawn(detections: list[Detection]) -> Image:
    picture = np.full((320, 320, 3), 90, np.uint8)
    for button in detections:
        cv2.circle(picture, (round(button.x_px), round(button.y_px)), round(_BUTTON_PX / 2.0), (180, 200, 200), -1)
    return picture
