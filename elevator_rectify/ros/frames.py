"""Poses in a frame that the user names: by tf2_ros, where it is installed."""

from __future__ import annotations

import importlib
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.clock import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time

from elevator_rectify.core.types import Array
from elevator_rectify.ros.convert import stamp_ns
from elevator_rectify.ros.poses import rotation_of

# A moving frame is known at the time of an image once its next transform came, usually a little after the image.
_PATIENCE = Duration(seconds=0.1)
# What is known of a frame is there so long after one began to listen.
_FILLED_SECONDS = 1.0


@dataclass(frozen=True)
class Transform:
    """The way from the camera to the frame `name`: x_frame = R x_camera + t."""

    name: str
    R: Array
    t: Array

    def covariance(self, of_camera: Array) -> Array:
        """Return a (6, 6) covariance of place and rotation about the camera's axes, in the frame."""
        both = np.zeros((6, 6))
        both[:3, :3] = both[3:, 3:] = self.R
        return np.asarray(both @ of_camera @ both.T)


class Frames:
    """Looks transforms up; it listens to /tf only from the first time that another frame than the camera's is named."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._tf2: Any = None
        self._buffer: Any = None
        self._listener: Any = None
        self._began = -float("inf")

    @property
    def filling(self) -> bool:
        """Tell whether it listens since a moment only: what is unknown now may be known of the next image."""
        return time.monotonic() - self._began < _FILLED_SECONDS

    def listen(self) -> str:
        """Begin to listen; return why that cannot be, or ''."""
        if self._buffer is not None:
            return ""
        try:
            self._tf2 = importlib.import_module("tf2_ros")
        except ImportError:
            return "another frame than the camera's needs tf2_ros: sudo apt install ros-jazzy-tf2-ros-py"
        self._buffer = self._tf2.Buffer()
        self._listener = self._tf2.TransformListener(self._buffer, self._node)
        self._began = time.monotonic()
        return ""

    def at(self, name: str, header: Any) -> Transform | str:
        """Return the transform from a message's frame to the frame `name` at its stamp, or why there is none."""
        camera = str(header.frame_id)
        if name in ("", camera):
            return Transform(camera, np.eye(3), np.zeros(3))
        if problem := self.listen():
            return problem
        # The stamp of an image that is read from its bytes is no message of rclpy's.
        at_image = Time(nanoseconds=stamp_ns(header), clock_type=ClockType.ROS_TIME)
        try:
            found = self._looked_up(name, camera, at_image).transform
        except self._tf2.TransformException as error:
            return f"frame_id {name}: {error}"
        at, turn = found.translation, found.rotation
        return Transform(name, rotation_of(turn.x, turn.y, turn.z, turn.w), np.array([at.x, at.y, at.z]))

    def _looked_up(self, name: str, camera: str, at_image: Time) -> Any:
        """Look the transform up; wait a little for one that is known up to just before the time."""
        try:
            return self._buffer.lookup_transform(name, camera, at_image)
        except self._tf2.ExtrapolationException:
            return self._buffer.lookup_transform(name, camera, at_image, _PATIENCE)


def panel_frame(node: Node, name: str) -> str:
    """Return the name of the panel's frame: below the node's namespace, so that two cameras have one each."""
    return name if name.startswith("/") else f"{node.get_namespace()}/{name}".lstrip("/")
