"""Bytes that are no messages, by the thousand: each is counted or refused, none ends the node.

MALFORMED_CASES=100000 runs as many; each case has its own seed.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import rclpy
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message

from elevator_rectify.core import Camera
from elevator_rectify.progress import progress
from elevator_rectify.ros.messages import ros_type
from elevator_rectify.ros.node import ElevatorRectify
from elevator_rectify.ros.pairing import Frame
from test.messages import camera_info, detections, image, vision_detections

CASES = int(os.environ.get("MALFORMED_CASES", "1500"))
Rng = np.random.Generator
Case = dict[str, bytes]
KINDS = {
    "image": "sensor_msgs/msg/Image",
    "camera_info": "sensor_msgs/msg/CameraInfo",
    "depth": "sensor_msgs/msg/Image",
}


@pytest.fixture(params=["pose_array", "vision_msgs"])
def node(request: pytest.FixtureRequest) -> Iterator[ElevatorRectify]:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=77)
    values = {"detections.type": request.param, "use_depth": True, "detector": "topic"}
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    made = ElevatorRectify(context=context, parameter_overrides=overrides)
    yield made
    made.close()
    rclpy.shutdown(context=context)


def good(stamp: int, kind: str, boxes: bool = False) -> Case:
    """Return the messages of a small frame with four boxes, or with none."""
    centres = np.array([[20.0, 10], [40, 10], [20, 30], [40, 30]])[: 4 * boxes]
    small = image(stamp, np.full((48, 64), 90, np.uint8))
    messages = {
        "camera_info": camera_info(stamp, Camera.centred(64, 48, 60.0)),
        "depth": small,
        "image": small,
        "detections": vision_detections(stamp, centres, ["1"] * len(centres))
        if kind == "vision_msgs"
        else detections(stamp, centres),
    }
    return {name: bytes(serialize_message(message)) for name, message in messages.items()}


def cut(data: bytearray, rng: Rng) -> bytearray:
    return data[: int(rng.integers(0, len(data)))]


def flipped(data: bytearray, rng: Rng) -> bytearray:
    for at in rng.integers(0, min(len(data), 400), int(rng.integers(1, 6))):
        data[at] ^= 1 << int(rng.integers(8))
    return data


def length_changed(data: bytearray, rng: Rng) -> bytearray:
    """Overwrite an aligned number: a length, a stamp, a count."""
    at = 4 + 4 * int(rng.integers(0, min(len(data), 400) // 4 - 1))
    number = [0, 1, 7, 255, 1 << 16, (1 << 31) - 1, 1 << 31, (1 << 32) - 1][int(rng.integers(8))]
    data[at : at + 4] = number.to_bytes(4, "little")
    return data


def inserted(data: bytearray, rng: Rng) -> bytearray:
    at = int(rng.integers(0, len(data)))
    return data[:at] + bytearray(rng.bytes(int(rng.integers(1, 40)))) + data[at:]


def noise(data: bytearray, rng: Rng) -> bytearray:
    return data[:4] + bytearray(rng.bytes(int(rng.integers(0, 300))))


CHANGES: list[Callable[[bytearray, Rng], bytearray]] = [cut, flipped, length_changed, inserted, noise]


def feed(node: ElevatorRectify, messages: Case) -> None:
    """Hand the bytes to the node's subscriptions, as an executor does; rclpy's own refusals are the executor's."""
    subscriptions = {s.topic_name.rpartition("/")[2]: s for s in node.subscriptions}
    for name, data in messages.items():
        subscription: Any = subscriptions[name]
        if subscription.raw:
            subscription.callback(data)
            continue
        try:
            message = deserialize_message(data, ros_type(KINDS[name]))
        except Exception:  # rclpy raises what it likes, and `run_node` goes on
            continue
        subscription.callback(message)


def test_no_bytes_on_any_topic_end_the_node_or_are_an_internal_error(
    node: ElevatorRectify, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind = node.node_config.detections.type
    answered: list[Frame] = []

    def answer(frames: list[Frame]) -> None:
        # Here, not in the worker: what is raised fails the test.
        for frame in frames:
            answered.append(frame)
            node._answer(frame)

    monkeypatch.setattr(node, "_enqueue", answer)
    for number in progress(range(1, CASES + 1), f"malformed, {kind}"):
        rng = np.random.default_rng([number, 16])
        name = ("image", "camera_info", "depth", "detections")[int(rng.integers(4))]
        messages = good(number * 10**9, kind, boxes=name == "detections")
        # Few boxes would be sought by their outlines, for some hundred milliseconds.
        node.node_config = replace(node.node_config, measure=name != "detections")
        messages[name] = bytes(CHANGES[int(rng.integers(len(CHANGES)))](bytearray(messages[name]), rng))
        feed(node, messages)
    verdicts = node.statistics.verdicts
    # A changed picture is often one still, a changed length seldom.
    assert len(answered) > CASES / 4 and set(verdicts) <= {"bad_input", "too_few_detections", "collinear"}
    assert verdicts["bad_input"] > CASES / 50 and sum(node.pairing.dropped.values()) > CASES / 10
    feed(node, good(10**18, kind))
    assert answered[-1].image.header.stamp.sec == 10**9
