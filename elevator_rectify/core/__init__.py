"""The mathematics: NumPy and OpenCV, no ROS."""

from elevator_rectify.core.config import (
    AcceptConfig,
    Config,
    EmConfig,
    HypothesesConfig,
    InputConfig,
    JointConfig,
    LabelsConfig,
    MeasurementConfig,
    MotionConfig,
    NetworkConfig,
    NoiseConfig,
    OutlineConfig,
    PanelConfig,
    RoundsConfig,
    ScaleConfig,
    SizeConfig,
    SmoothingConfig,
    TargetConfig,
    ViewConfig,
)
from elevator_rectify.core.detector.detect import detect_buttons
from elevator_rectify.core.find import find_panel
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.lamps.lit import lamps_of, with_lit
from elevator_rectify.core.pipeline import fit_panel, fit_panels
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.reading.target import find_button
from elevator_rectify.core.types import Button, Detection, KnownPanel
from elevator_rectify.core.view.warp import Rectification, rectify_image

__all__ = [
    "AcceptConfig",
    "Button",
    "Camera",
    "Config",
    "Detection",
    "EmConfig",
    "GridFit",
    "HypothesesConfig",
    "InputConfig",
    "JointConfig",
    "KnownPanel",
    "LabelsConfig",
    "MeasurementConfig",
    "MotionConfig",
    "NetworkConfig",
    "NoiseConfig",
    "OutlineConfig",
    "PanelConfig",
    "Rectification",
    "RoundsConfig",
    "ScaleConfig",
    "SizeConfig",
    "SmoothingConfig",
    "TargetConfig",
    "ViewConfig",
    "detect_buttons",
    "find_button",
    "find_panel",
    "fit_panel",
    "fit_panels",
    "lamps_of",
    "rectify_image",
    "with_lit",
]
