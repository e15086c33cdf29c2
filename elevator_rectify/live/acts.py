"""What goes wrong in a robot's life, one act after another: each sends messages and says what must come of them."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from elevator_rectify.core.types import Array
from elevator_rectify.live.driver import Driver
from elevator_rectify.live.frames import Frames, detections_message, header
from elevator_rectify.ros.convert import stamp_ns
from elevator_rectify.ros.messages import make_ros, ros_type

POSE, REFUSED, NOTHING = "pose", "refused", "nothing"
_FRAME_NS = 33_333_333
_JUMP_NS = 100 * 10**9
_BURST = 12
_IMAGE, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


@dataclass
class Script:
    """Sends seeded acts and keeps the account: what must come of every stamp, the view that it showed, and when its
    last message was sent, on the clock of `time.perf_counter`."""

    driver: Driver
    frames: Frames
    rng: np.random.Generator
    compressed: bool = False
    expected: dict[int, str] = field(default_factory=dict)
    shown: dict[int, Array] = field(default_factory=dict)
    sent: Counter[str] = field(default_factory=Counter)
    sent_at: dict[int, float] = field(default_factory=dict)
    acts: Counter[str] = field(default_factory=Counter)
    _number: int = 0
    _base_ns: int = field(default_factory=time.time_ns)

    @property
    def image(self) -> str:
        """Return the name of the image's topic."""
        return "image/compressed" if self.compressed else "image"

    def play(self) -> None:
        """Play one act, drawn at random."""
        names = list(ACTS)
        weights = np.array([_OFTEN.get(name, 1.0) for name in names])
        name = names[int(self.rng.choice(len(names), p=weights / weights.sum()))]
        self.acts[name] += 1
        ACTS[name](self)
        self.driver.spin(float(self.rng.uniform(0.02, 0.2)))

    def new(self, expected: str) -> tuple[int, dict[str, Any]]:
        """Return stamp and messages of a new good frame, and note what must come of it."""
        self._number += 1
        stamp = self._base_ns + self._number * _FRAME_NS + self._number
        messages = self.frames.messages(self._number, stamp)
        if self.compressed:
            messages[self.image] = self._as_compressed(messages.pop("image"))
        self.expected[stamp] = expected
        poses = messages["detections"].poses
        self.shown[stamp] = np.array([[p.position.x, p.position.y] for p in poses])
        return stamp, messages

    def send(self, messages: dict[str, Any], *names: str) -> None:
        """Publish the named messages of a frame, or all of them, the detections last."""
        for name in names or ("camera_info", self.image, "detections"):
            self.driver.publishers[name].publish(messages[name])
            self.sent["image" if name == self.image else name] += 1
            self.sent_at[stamp_ns(messages[name].header)] = time.perf_counter()

    def jump(self) -> None:
        """Set the clock back; the stamps that were used do not come again."""
        self._base_ns -= _JUMP_NS

    @staticmethod
    def _as_compressed(image: Any) -> Any:
        picture = np.frombuffer(image.data, np.uint8).reshape(image.height, image.width, 3)
        data = cv2.imencode(".jpg", picture)[1].ravel()
        return make_ros(_COMPRESSED, header=image.header, format="bgr8; jpeg compressed bgr8", data=data)


def _good(script: Script) -> None:
    for _ in range(int(script.rng.integers(1, 6))):
        script.send(script.new(POSE)[1])
        script.driver.spin(0.033)


def _late(script: Script) -> None:
    """Detections come up to two seconds after their images, in any order."""
    several = [script.new(POSE)[1] for _ in range(3)]
    for messages in several:
        script.send(messages, "camera_info", script.image)
    script.driver.spin(float(script.rng.uniform(0.0, 2.0)))
    for k in script.rng.permutation(len(several)):
        script.send(several[k], "detections")
        script.driver.spin(0.04)


def _detections_first(script: Script) -> None:
    messages = script.new(POSE)[1]
    script.send(messages, "detections")
    script.driver.spin(0.05)
    script.send(messages, "camera_info", script.image)


def _twice(script: Script) -> None:
    messages = script.new(POSE)[1]
    for names in ((), (script.image,), ("detections",)):
        script.send(messages, *names)
        script.driver.spin(0.05)


def _never(script: Script) -> None:
    script.send(script.new(NOTHING)[1], "camera_info", script.image)
    script.send(script.new(NOTHING)[1], "detections")


def _bad_image(script: Script) -> None:
    messages = script.new(REFUSED)[1]
    image = messages[script.image]
    if script.compressed:
        image.data = image.data[: int(script.rng.integers(1, 60))]
    else:
        faults: list[tuple[str, Any]] = [
            ("encoding", "yuv9"), ("encoding", ""), ("step", 7), ("height", 100000), ("width", 0)
        ]  # fmt: skip
        name, value = faults[int(script.rng.integers(len(faults)))]
        fields = {n: getattr(image, n) for n in ("header", "height", "width", "encoding", "is_bigendian", "step")}
        messages[script.image] = ros_type(_IMAGE)(**{**fields, "data": image.data, name: value})
    script.send(messages)


def _bad_camera(script: Script) -> None:
    messages = script.new(REFUSED)[1]
    info = messages["camera_info"]
    fault = int(script.rng.integers(5))
    if fault == 0:
        info.k = np.zeros(9)
    elif fault == 1:
        info.k = np.full(9, np.nan)
    elif fault == 2:
        info.width = 320
    elif fault == 3:
        info.header = header(int(info.header.stamp.sec) * 10**9 + int(info.header.stamp.nanosec), "another_camera")
    else:
        info.d, info.distortion_model = [0.1, 0.2, 0.3], "unheard_of"
    script.send(messages)


def _bad_detections(script: Script) -> None:
    stamp, messages = script.new(REFUSED)
    rng, number = script.rng, int(script.rng.integers(6))
    points = [
        np.zeros((0, 2)),
        np.full((9, 2), np.nan),
        np.full((30, 2), 5000.0),
        np.full((30, 2), 200.0),
        np.column_stack([np.linspace(50, 600, 12), np.linspace(40, 400, 12)]),
        rng.uniform(0, 480, (3, 2)),
    ][number]
    messages["detections"] = detections_message(points, header(stamp))
    script.send(messages)


def _crowd(script: Script) -> None:
    """Ten thousand detections, none of them a panel: bounded time, no pose."""
    stamp, messages = script.new(REFUSED)
    messages["detections"] = detections_message(script.rng.uniform(-100, 800, (10_000, 2)), header(stamp))
    script.send(messages)
    script.driver.spin(1.5)


def _burst(script: Script) -> None:
    for messages in [script.new(POSE)[1] for _ in range(_BURST)]:
        script.send(messages)
    script.driver.spin(0.8)


def _silence(script: Script) -> None:
    script.driver.spin(2.0)


def _clock_jump(script: Script) -> None:
    """What waits is lost, what comes after is answered."""
    script.driver.spin(0.5)
    script.send(script.new(NOTHING)[1], "camera_info", script.image)
    script.driver.spin(0.2)
    script.jump()
    _good(script)


def _restart(script: Script) -> None:
    """The camera's and the detector's publishers die and come again."""
    script.driver.spin(0.3)
    kinds = {script.image: _COMPRESSED if script.compressed else _IMAGE, "camera_info": "sensor_msgs/msg/CameraInfo"}
    script.driver.restart({**kinds, "detections": "geometry_msgs/msg/PoseArray"})
    _good(script)


def _wrong_type(script: Script) -> None:
    """Somebody publishes texts on our topics."""
    kind = ros_type("std_msgs/msg/String")
    with script.driver.stranger() as node:
        publishers = [node.create_publisher(kind, name, 1) for name in (script.image, "camera_info", "detections")]
        script.driver.spin(0.5)
        for publisher in publishers:
            publisher.publish(kind(data="no image"))
        script.driver.spin(0.2)


ACTS: dict[str, Callable[[Script], None]] = {
    "good": _good,
    "late detections": _late,
    "detections first": _detections_first,
    "sent twice": _twice,
    "no counterpart": _never,
    "bad image": _bad_image,
    "bad camera": _bad_camera,
    "bad detections": _bad_detections,
    "crowd": _crowd,
    "burst": _burst,
    "silence": _silence,
    "clock jump": _clock_jump,
    "restart": _restart,
    "wrong type": _wrong_type,
}
_OFTEN = {
    **{"good": 4.0, "bad image": 2.0, "bad camera": 2.0, "bad detections": 2.0},
    **dict.fromkeys(("silence", "crowd", "restart", "wrong type"), 0.3),
}
