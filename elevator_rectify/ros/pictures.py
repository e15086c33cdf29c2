"""Image messages to pictures: every encoding of a colour or grey camera, as BGR or grey bytes.

Works on rclpy messages and on rosbags' alike: their attribute names are the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from elevator_rectify.core.types import Array, Image


class BadMessage(ValueError):
    """A message that cannot be used; its text names topic, field and value."""

    def __init__(self, topic: str, field: str, value: object, meaning: str) -> None:
        super().__init__(f"{topic}: {field} = {value!s:.120} {meaning}")


@dataclass(frozen=True)
class Encoding:
    """Channels, bytes per channel, and OpenCV's conversion to BGR (None: it is BGR or grey already)."""

    channels: int
    size: int = 1
    conversion: int | None = None


# OpenCV names a Bayer pattern by its second row and column, ROS by its first.
_BAYER = {
    "rggb": cv2.COLOR_BayerBG2BGR,
    "bggr": cv2.COLOR_BayerRG2BGR,
    "gbrg": cv2.COLOR_BayerGR2BGR,
    "grbg": cv2.COLOR_BayerGB2BGR,
}
# Names of sensor_msgs/image_encodings.
ENCODINGS: dict[str, Encoding] = {
    "mono8": Encoding(1),
    "8UC1": Encoding(1),
    "mono16": Encoding(1, 2),
    "bgr8": Encoding(3),
    "8UC3": Encoding(3),
    "rgb8": Encoding(3, 1, cv2.COLOR_RGB2BGR),
    "bgra8": Encoding(4, 1, cv2.COLOR_BGRA2BGR),
    "rgba8": Encoding(4, 1, cv2.COLOR_RGBA2BGR),
    "bgr16": Encoding(3, 2),
    "rgb16": Encoding(3, 2, cv2.COLOR_RGB2BGR),
    "yuv422": Encoding(2, 1, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": Encoding(2, 1, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": Encoding(2, 1, cv2.COLOR_YUV2BGR_YUY2),
    "yuyv": Encoding(2, 1, cv2.COLOR_YUV2BGR_YUY2),
    **{f"bayer_{pattern}8": Encoding(1, 1, code) for pattern, code in _BAYER.items()},
    **{f"bayer_{pattern}16": Encoding(1, 2, code) for pattern, code in _BAYER.items()},
}


def image_from_message(message: Any, topic: str = "image") -> Image:
    """Return the picture of a sensor_msgs/Image (or CompressedImage): (height, width, 3) BGR or (height, width) grey.

    Bytes that are BGR or grey already are a view of the message's data. Of 16 bits the upper eight are kept.
    Raises BadMessage.
    """
    if hasattr(message, "format"):
        return _decompressed(message, topic)
    encoding = _encoding(message, topic)
    samples = _samples(message, encoding, topic)
    if encoding.size == 2:
        samples = (samples >> 8).astype(np.uint8)
    if encoding.conversion is None:
        return samples
    if min(samples.shape[:2]) < 2 or (encoding.channels == 2 and samples.shape[1] % 2):
        size = f"{message.width} x {message.height}"
        raise BadMessage(topic, "width x height", size, f"cannot hold an image of encoding {message.encoding}")
    return cv2.cvtColor(np.ascontiguousarray(samples), encoding.conversion)


def check_image(message: Any, topic: str = "image") -> tuple[int, int] | None:
    """Return (height, width) of an image that is not needed as a picture; None where only decoding would tell.

    Raises BadMessage as `image_from_message` does, but for a compressed one that only decoding would find broken.
    """
    if hasattr(message, "format"):
        if not len(message.data):
            raise BadMessage(topic, "data", "0 bytes", "is no picture")
        return None
    rows, columns = _samples(message, _encoding(message, topic), topic).shape[:2]
    return int(rows), int(columns)


def _encoding(message: Any, topic: str) -> Encoding:
    if message.encoding not in ENCODINGS:
        raise BadMessage(topic, "encoding", message.encoding, f"is not one of {', '.join(ENCODINGS)}")
    return ENCODINGS[message.encoding]


def _samples(message: Any, encoding: Encoding, topic: str) -> Image:
    """Return the message's samples (height, width[, channels]), bytes or 16-bit numbers in the machine's order."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    if height <= 0 or width <= 0:
        raise BadMessage(topic, "width x height", f"{width} x {height}", "is an empty image")
    row = width * encoding.channels * encoding.size
    if step < row:
        raise BadMessage(topic, "step", step, f"is shorter than a row of {width} pixels, {row} bytes")
    data = np.frombuffer(message.data, np.uint8)
    if data.size < step * height:
        raise BadMessage(topic, "data", f"{data.size} bytes", f"is shorter than step x height = {step * height}")
    rows = data[: step * height].reshape(height, step)[:, :row]
    if encoding.size == 2:
        order = ">u2" if message.is_bigendian else "<u2"
        rows = np.ascontiguousarray(rows).view(order).astype(np.uint16)
    return rows.reshape(height, width, encoding.channels) if encoding.channels > 1 else rows


def _decompressed(message: Any, topic: str) -> Image:
    """Decode a CompressedImage (jpeg, png)."""
    data = np.frombuffer(message.data, np.uint8)
    try:
        # By default OpenCV turns a picture by its Exif orientation, which camera_info knows nothing of.
        flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION
        picture = cv2.imdecode(data, flags) if data.size else None
    except cv2.error:
        picture = None
    if picture is None:
        raise BadMessage(topic, "data", f"{data.size} bytes of {message.format!r}", "is no picture that OpenCV decodes")
    if picture.dtype == np.uint16:
        picture = (picture >> 8).astype(np.uint8)
    if picture.dtype != np.uint8:
        raise BadMessage(topic, "format", repr(message.format), f"has samples of {picture.dtype}, not of 8 or 16 bits")
    return picture


def depth_from_message(message: Any, topic: str = "depth") -> Array:
    """Return metres (height, width) of a depth image, NaN where there is none. Raises BadMessage.

    16UC1 (or mono16) is in millimetres, 32FC1 in metres (REP-118).
    """
    if message.encoding in ("16UC1", "mono16"):
        millimetres = _samples(message, Encoding(1, 2), topic)
        return np.where(millimetres > 0, millimetres * 1e-3, np.nan)
    if message.encoding != "32FC1":
        raise BadMessage(topic, "encoding", message.encoding, "is not one of 16UC1, 32FC1")
    words = _samples(message, Encoding(4, 1), topic)
    # A signalling NaN among the bits is a hole like any other.
    with np.errstate(invalid="ignore"):
        metres = np.ascontiguousarray(words).view(">f4" if message.is_bigendian else "<f4")[..., 0].astype(float)
    return np.where(np.isfinite(metres) & (metres > 0), metres, np.nan)
