"""Messages to values. Works on rclpy messages and on rosbags' alike: their attribute names are the same."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from elevator_rectify.core.camera import Camera
from elevator_rectify.core.types import Detection, Image

# Encoding: channels, and the conversion to the BGR (or grey) that the core draws and warps.
ENCODINGS: dict[str, tuple[int, int | None]] = {
    "bgr8": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "mono8": (1, None),
}


class BadMessage(ValueError):
    """A message that cannot be used; its text names topic, field and value."""

    def __init__(self, topic: str, field: str, value: object, meaning: str) -> None:
        super().__init__(f"{topic}: {field} = {value!s:.120} {meaning}")


def stamp_ns(header: Any) -> int:
    """Return a header's stamp in nanoseconds."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def image_from_message(message: Any, topic: str = "image") -> Image:
    """Return the picture of a sensor_msgs/Image (or CompressedImage): (height, width, 3) BGR or (height, width) grey.

    bgr8 and mono8 are views of the message's data. Raises BadMessage.
    """
    if hasattr(message, "format"):
        return _decompressed(message, topic)
    if message.encoding not in ENCODINGS:
        raise BadMessage(topic, "encoding", message.encoding, f"is not one of {', '.join(ENCODINGS)}")
    channels, conversion = ENCODINGS[message.encoding]
    height, width, step = int(message.height), int(message.width), int(message.step)
    if height <= 0 or width <= 0:
        raise BadMessage(topic, "width x height", f"{width} x {height}", "is an empty image")
    if step < width * channels:
        raise BadMessage(topic, "step", step, f"is shorter than a row of {width} x {channels} bytes")
    data = np.frombuffer(message.data, np.uint8)
    if data.size < step * height:
        raise BadMessage(topic, "data", f"{data.size} bytes", f"is shorter than step x height = {step * height}")
    rows = data[: step * height].reshape(height, step)[:, : width * channels]
    picture = rows.reshape(height, width, channels) if channels > 1 else rows
    return picture if conversion is None else cv2.cvtColor(picture, conversion)


def _decompressed(message: Any, topic: str) -> Image:
    """Decode a CompressedImage."""
    data = np.frombuffer(message.data, np.uint8)
    try:
        picture = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    except cv2.error:
        picture = None
    if picture is None:
        raise BadMessage(topic, "data", f"{data.size} bytes of {message.format!r}", "is no picture that OpenCV decodes")
    if picture.dtype != np.uint8:
        picture = (picture >> 8).astype(np.uint8)
    return picture[:, :, :3] if picture.ndim == 3 else picture


def camera_from_message(message: Any, topic: str = "camera_info") -> Camera:
    """Return the camera of a sensor_msgs/CameraInfo. Raises BadMessage."""
    roi = message.roi
    if message.binning_x > 1 or message.binning_y > 1 or roi.x_offset or roi.y_offset:
        raise BadMessage(
            topic,
            "binning, roi",
            (message.binning_x, message.binning_y, roi.x_offset, roi.y_offset),
            "is not supported",
        )
    try:
        return Camera.from_matrix(
            np.array(message.k), int(message.width), int(message.height), np.array(message.d), message.distortion_model
        )
    except ValueError as error:
        raise BadMessage(topic, "k", np.array(message.k).tolist(), f"cannot be used: {error}") from error


def detections_from_message(message: Any, topic: str = "detections") -> list[Detection]:
    """Return the detections of a geometry_msgs/PoseArray: position x, y is a box's centre in pixels."""
    return [Detection(float(pose.position.x), float(pose.position.y)) for pose in message.poses]
