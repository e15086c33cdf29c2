"""The reader of serialised images against rclpy's own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from elevator_rectify.ros.messages import make_ros, ros_type
from elevator_rectify.ros.output import image_message
from elevator_rectify.ros.pictures import BadMessage
from elevator_rectify.ros.serialized import Unread, make_published, read_header, read_image
from test.messages import header


def pixels(size: int) -> Any:
    return np.arange(size, dtype=np.uint8)


@settings(max_examples=150, deadline=None)
@given(
    frame=st.text(st.characters(min_codepoint=1, exclude_categories=["Cs"]), max_size=20),
    encoding=st.text("abc8_", max_size=9),
    size=st.integers(0, 50),
    stamp=st.integers(0, 2**31 * 10**9 - 1),
)
def test_images_are_read_as_rclpy_reads_them(frame: str, encoding: str, size: int, stamp: int) -> None:
    message = make_ros(
        "sensor_msgs/msg/Image",
        header=header(stamp, frame),
        height=3,
        width=size,
        encoding=encoding,
        is_bigendian=1,
        step=2 * size,
        data=pixels(size),
    )
    read = read_image("sensor_msgs/msg/Image", bytes(serialize_message(message)))
    for name in ("height", "width", "encoding", "is_bigendian", "step"):
        assert getattr(read, name) == getattr(message, name)
    assert (read.header.frame_id, read.header.stamp.sec) == (frame, message.header.stamp.sec)
    assert read.header.stamp.nanosec == message.header.stamp.nanosec
    assert bytes(read.data) == bytes(message.data)


@settings(max_examples=100, deadline=None)
@given(
    frame=st.text(st.characters(min_codepoint=1, exclude_categories=["Cs"]), max_size=20),
    shape=st.tuples(st.integers(1, 9), st.integers(1, 9), st.sampled_from([1, 3])),
    stamp=st.integers(0, 2**31 * 10**9 - 1),
)
def test_images_are_written_as_rclpy_reads_them(frame: str, shape: tuple[int, int, int], stamp: int) -> None:
    picture = pixels(int(np.prod(shape))).reshape(shape[:2] if shape[2] == 1 else shape)[:, ::-1]
    written = image_message(picture, header(stamp, frame), make_published)
    assert isinstance(written, bytes)
    read = deserialize_message(written, ros_type("sensor_msgs/msg/Image"))
    assert read == image_message(picture, header(stamp, frame), make_ros)


def test_compressed_images_too() -> None:
    message = make_ros("sensor_msgs/msg/CompressedImage", header=header(7), format="jpeg", data=pixels(11))
    read = read_image("sensor_msgs/msg/CompressedImage", bytes(serialize_message(message)))
    assert (read.format, bytes(read.data)) == ("jpeg", bytes(message.data))


def test_big_endian_bytes_are_left_to_rclpy(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr("elevator_rectify.ros.serialized.deserialize_message", lambda *given: seen.append(given))
    read_image("sensor_msgs/msg/Image", b"\x00\x00\x00\x00rest")
    assert seen[0][0].endswith(b"rest")


def test_of_detections_only_the_header_is_read_until_they_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    message = make_ros(
        "geometry_msgs/msg/PoseArray", header=header(5, "camera"), poses=[make_ros("geometry_msgs/msg/Pose")]
    )
    data, whole = bytes(serialize_message(message)), []

    def deserialised(*given: Any) -> Any:
        whole.append(given)
        return deserialize_message(*given)

    monkeypatch.setattr("elevator_rectify.ros.serialized.deserialize_message", deserialised)
    read = read_header("geometry_msgs/msg/PoseArray", data)
    assert (read.header.frame_id, read.header.stamp.nanosec, whole) == ("camera", 5, [])
    assert len(read.poses) == 1 and not hasattr(read, "detections") and len(whole) == 1


def test_detections_that_are_none_are_bad_input_when_they_are_used() -> None:
    whole = bytes(serialize_message(make_ros("geometry_msgs/msg/PoseArray", header=header(5, "camera"))))
    read = read_header("geometry_msgs/msg/PoseArray", whole[:-4] + b"\xff\xff\xff\x7f")
    assert isinstance(read, Unread)
    with pytest.raises(BadMessage, match="detections: bytes"):
        _ = read.poses
