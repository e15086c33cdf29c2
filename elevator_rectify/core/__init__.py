"""The mathematics: NumPy and OpenCV, no ROS."""

from elevator_rectify.core.config import Config
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.pipeline import fit_panel, fit_panels
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.reading.target import find_button
from elevator_rectify.core.types import Button, Detection
from elevator_rectify.core.view.warp import Rectification, rectify_image

__all__ = [
    "Button",
    "Camera",
    "Config",
    "Detection",
    "GridFit",
    "Rectification",
    "find_button",
    "fit_panel",
    "fit_panels",
    "rectify_image",
]
