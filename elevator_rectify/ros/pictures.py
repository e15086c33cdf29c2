"""Image messages to pictures: every encoding of a colour or grey camera, as BGR or grey bytes.

Works on rclpy messages and on rosbags' alike: their attribute names are the same.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from elevator_rectify.core.types import Array, Image


class BadMessage(ValueError):
    """A message that cannot be used; its text names topic, field and value."""

    def __init__(self, topic: str, field: str, value: object, meaning: str) -> None:
        super().__init__(f"{topic}: {field} = {printable(str(value))} {meaning}")


def printable(text: str, longest: int = 120) -> str:
    """Return text of a message as it may go to a terminal: control characters escaped, of bounded length."""
    shown = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text[: longest + 1])
    return shown if len(shown) <= longest else shown[: longest - 3] + "..."


@dataclass(frozen=True)
class Encoding:
    """Channels, bytes per channel, OpenCV's conversion to BGR (None: it is BGR or grey already), and the rows of
    samples per row of pixels: half a row more where colours follow in a plane of their own."""

    channels: int
    size: int = 1
    conversion: int | None = None
    rows: float = 1.0


# More pixels than any camera on a robot has.
MAX_MEGAPIXELS = 100
MAX_PIXELS = MAX_MEGAPIXELS * 1_000_000
# Markers of the segments that hold a JPEG's size (ITU T.81, table B.1).
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
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
    "16UC1": Encoding(1, 2),
    "bgra8": Encoding(4, 1, cv2.COLOR_BGRA2BGR),
    "8UC4": Encoding(4, 1, cv2.COLOR_BGRA2BGR),
    "rgba8": Encoding(4, 1, cv2.COLOR_RGBA2BGR),
    "bgr16": Encoding(3, 2),
    "rgb16": Encoding(3, 2, cv2.COLOR_RGB2BGR),
    "bgra16": Encoding(4, 2, cv2.COLOR_BGRA2BGR),
    "rgba16": Encoding(4, 2, cv2.COLOR_RGBA2BGR),
    "yuv422": Encoding(2, 1, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": Encoding(2, 1, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": Encoding(2, 1, cv2.COLOR_YUV2BGR_YUY2),
    "yuyv": Encoding(2, 1, cv2.COLOR_YUV2BGR_YUY2),
    "nv12": Encoding(1, 1, cv2.COLOR_YUV2BGR_NV12, rows=1.5),
    "nv21": Encoding(1, 1, cv2.COLOR_YUV2BGR_NV21, rows=1.5),
    **{f"bayer_{pattern}8": Encoding(1, 1, code) for pattern, code in _BAYER.items()},
    **{f"bayer_{pattern}16": Encoding(1, 2, code) for pattern, code in _BAYER.items()},
}


def image_from_message(message: Any, topic: str = "image", max_pixels: int = MAX_PIXELS) -> Image:
    """Return the picture of a sensor_msgs/Image (or CompressedImage): (height, width, 3) BGR or (height, width) grey.

    Bytes that are BGR or grey already are a view of the message's data. Of 16, 12 or 10 bits the upper eight are kept.
    max_pixels: more are not decompressed. Raises BadMessage.
    """
    if hasattr(message, "format"):
        return _decompressed(message, topic, max_pixels)
    encoding = _encoding(message, topic)
    samples = _samples(message, encoding, topic)
    if encoding.size == 2:
        samples = _upper_bits(samples)
    if encoding.conversion is None:
        return samples
    odd = encoding.channels == 2 and samples.shape[1] % 2
    if min(samples.shape[:2]) < 2 or odd or (encoding.rows != 1.0 and (message.width % 2 or message.height % 2)):
        size = f"{message.width} x {message.height}"
        raise BadMessage(topic, "width x height", size, f"cannot hold an image of encoding {message.encoding}")
    return cv2.cvtColor(np.ascontiguousarray(samples), encoding.conversion)


def _upper_bits(samples: Image) -> Image:
    """Return 16-bit samples as bytes: many cameras fill ten or twelve bits only, from the lowest on."""
    used = int(samples.max(initial=0)).bit_length()
    return np.asarray(samples >> (8 if used > 12 else 4 if used > 10 else 2), dtype=np.uint8)


def check_image(message: Any, topic: str = "image") -> tuple[int, int] | None:
    """Return (height, width) of an image that is not needed as a picture; None where only decoding would tell.

    Raises BadMessage as `image_from_message` does, but for a compressed one that only decoding would find broken.
    """
    if hasattr(message, "format"):
        if not len(message.data):
            raise BadMessage(topic, "data", "0 bytes", "is no picture")
        return None
    _samples(message, _encoding(message, topic), topic)
    return int(message.height), int(message.width)


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
    data, lines = np.frombuffer(message.data, np.uint8), int(height * encoding.rows)
    if data.size < step * lines:
        raise BadMessage(topic, "data", f"{data.size} bytes", f"is shorter than {lines} rows of step {step}")
    rows = data[: step * lines].reshape(lines, step)[:, :row]
    if encoding.size == 2:
        order = ">u2" if message.is_bigendian else "<u2"
        rows = np.ascontiguousarray(rows).view(order).astype(np.uint16)
    return rows.reshape(lines, width, encoding.channels) if encoding.channels > 1 else rows


def _decompressed(message: Any, topic: str, max_pixels: int) -> Image:
    """Decode a CompressedImage (jpeg, png) that says beforehand that it is not too large."""
    data = np.frombuffer(message.data, np.uint8)
    size = announced_size(data.tobytes())
    if size is not None and size[0] * size[1] > max_pixels:
        text = f"{size[0]} x {size[1]}"
        raise BadMessage(topic, "width x height", text, f"is more than {max_pixels * 1e-6:g} megapixels: not decoded")
    try:
        # By default OpenCV turns a picture by its Exif orientation, which camera_info knows nothing of.
        flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION
        picture = cv2.imdecode(data, flags) if size is not None else None
    except cv2.error:
        picture = None
    if picture is None:
        raise BadMessage(topic, "data", f"{data.size} bytes of {message.format!r}", "is no JPEG or PNG that decodes")
    if picture.dtype == np.uint16:
        picture = _upper_bits(picture)
    if picture.dtype != np.uint8:
        raise BadMessage(topic, "format", repr(message.format), f"has samples of {picture.dtype}, not of 8 or 16 bits")
    return picture


def announced_size(data: bytes) -> tuple[int, int] | None:
    """Return the width and height that the header of a JPEG or PNG announces, None for other data."""
    if data[:8] == b"\x89PNG\r\n\x1a\n" and len(data) >= 24:
        width, height = struct.unpack(">II", data[16:24])
        return int(width), int(height)
    at = 2
    while data[:2] == b"\xff\xd8" and at + 9 <= len(data) and data[at] == 0xFF:
        if data[at + 1] in _JPEG_FRAMES:
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            return int(width), int(height)
        # Fill bytes may stand before a marker.
        at += 1 if data[at + 1] == 0xFF else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return None


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
