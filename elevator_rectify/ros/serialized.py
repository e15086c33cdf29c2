"""Messages read straight from their serialised bytes, and images written so: what nobody looks at costs no copy.

The layout is OMG's plain CDR (DDS-XTypes 1.3, 7.4.3): every number aligned to its own size from the first byte after
the four of encapsulation; a string is its length, with the closing zero, and its bytes.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message

from elevator_rectify.core.types import Image
from elevator_rectify.ros.messages import make_ros, ros_type
from elevator_rectify.ros.pictures import BadMessage

_LITTLE_ENDIAN_CDR = b"\x00\x01"
_BODY = 4


@dataclass(frozen=True)
class Stamp:
    """As builtin_interfaces/Time."""

    sec: int
    nanosec: int


@dataclass(frozen=True)
class Header:
    """As std_msgs/Header."""

    stamp: Stamp
    frame_id: str


@dataclass(frozen=True)
class RawImage:
    """As sensor_msgs/Image; data is a view of the serialised bytes."""

    header: Header
    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: memoryview


@dataclass(frozen=True)
class RawCompressedImage:
    """As sensor_msgs/CompressedImage; data is a view of the serialised bytes."""

    header: Header
    format: str
    data: memoryview


class _Reader:
    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, _BODY

    def number(self, kind: str = "I") -> int:
        size = struct.calcsize(kind)
        self._at += -(self._at - _BODY) % size
        (value,) = struct.unpack_from(f"<{kind}", self._data, self._at)
        self._at += size
        return int(value)

    def view(self) -> memoryview:
        length = self.number()
        if self._at + length > len(self._data):
            raise struct.error(f"{length} bytes announced, {len(self._data) - self._at} there")
        self._at += length
        return memoryview(self._data)[self._at - length : self._at]

    def text(self) -> str:
        return bytes(self.view()).rstrip(b"\x00").decode(errors="replace")

    def header(self) -> Header:
        return Header(Stamp(self.number("i"), self.number()), self.text())


class Unread:
    """A message of which the header is read, and the rest when it is first asked for: of a flood most never is."""

    def __init__(self, kind: str, data: bytes) -> None:
        self.header = _Reader(data).header()
        self._kind, self._data = kind, data

    @cached_property
    def _message(self) -> Any:
        try:
            return deserialize_message(self._data, ros_type(self._kind))
        except Exception as error:
            # Of wrong bytes rclpy says what it likes.
            raise BadMessage("detections", "bytes", len(self._data), f"are no {self._kind}: {error!r:.200}") from error

    def __getattr__(self, name: str) -> Any:
        """Return a field of the message itself."""
        return getattr(self._message, name)


def read_header(kind: str, data: bytes) -> Any:
    """Return the message in serialised bytes that begins with a header, of which only that is read yet."""
    return Unread(kind, data) if data[:2] == _LITTLE_ENDIAN_CDR else deserialize_message(data, ros_type(kind))


def read_image(kind: str, data: bytes) -> Any:
    """Return the sensor_msgs Image or CompressedImage in serialised bytes; of another layout, by rclpy's own reader."""
    if data[:2] != _LITTLE_ENDIAN_CDR:
        return deserialize_message(data, ros_type(kind))
    reader = _Reader(data)
    header = reader.header()
    if kind == "sensor_msgs/msg/CompressedImage":
        return RawCompressedImage(header, reader.text(), reader.view())
    return RawImage(
        header, reader.number(), reader.number(), reader.text(), reader.number("B"), reader.number(), reader.view()
    )


def make_published(name: str, /, **fields: Any) -> Any:
    """Make a message to publish: as `make_ros`, but an Image as its serialised bytes, its pixels copied once."""
    return image_bytes(**fields) if name == "sensor_msgs/msg/Image" else make_ros(name, **fields)


def image_bytes(
    header: Any, height: int, width: int, encoding: str, is_bigendian: int, step: int, data: Image
) -> bytes:
    """Return a sensor_msgs/Image in plain CDR."""
    pixels = np.ascontiguousarray(data).data.cast("B")
    head = bytearray(_LITTLE_ENDIAN_CDR + b"\x00\x00" + struct.pack("<iI", header.stamp.sec, header.stamp.nanosec))
    for part in (header.frame_id, height, width, encoding):
        _append(head, part)
    head += struct.pack("<B", is_bigendian)
    for number in (step, len(pixels)):
        _append(head, number)
    return b"".join((head, pixels))


def _append(head: bytearray, part: str | int) -> None:
    """Append a string, or a number of four bytes at a multiple of four."""
    head += bytes(-(len(head) - _BODY) % 4)
    if isinstance(part, int):
        head += struct.pack("<I", part)
    else:
        text = part.encode() + b"\x00"
        head += struct.pack("<I", len(text)) + text
