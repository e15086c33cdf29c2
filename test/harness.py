"""Feeds a live node in its own process over real DDS, and collects what it publishes."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile

from elevator_rectify.live.demo import dds_environment
from elevator_rectify.ros.messages import installed, ros_type
from elevator_rectify.ros.output import BUTTONS, TARGET, TOPICS

ROOT = Path(__file__).parent.parent
DOMAIN = 78
ENVIRONMENT = {**dds_environment(DOMAIN), "ROS_PYTHON_CHECK_FIELDS": "1"}
PREFIX = "/elevator_rectify/"
INPUTS = {
    "image": "sensor_msgs/msg/Image",
    "camera_info": "sensor_msgs/msg/CameraInfo",
    "detections": "geometry_msgs/msg/PoseArray",
}
OUTPUTS = {
    **{PREFIX + topic: kind for topic, kind in TOPICS.items()},
    **{PREFIX + topic: kind for topic, kind in TARGET.items()},
    **({PREFIX + BUTTONS[0]: BUTTONS[1]} if installed(BUTTONS[1]) else {}),
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}


class Harness:
    """Publishes the node's inputs and collects its outputs; `received` has them by topic below the node's name."""

    def __init__(self, inputs: dict[str, str] | None = None) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = rclpy.create_node("harness", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.inputs: dict[str, Any] = {}
        for name, kind in {**INPUTS, **(inputs or {})}.items():
            self.advertise(name, kind)
        self.received: dict[str, list[Any]] = {topic.removeprefix(PREFIX): [] for topic in OUTPUTS}
        for topic, kind in OUTPUTS.items():
            self.listen(topic, kind)

    def advertise(self, name: str, kind: str) -> None:
        if name in self.inputs:
            self.node.destroy_publisher(self.inputs[name])
        self.inputs[name] = self.node.create_publisher(ros_type(kind), name, QoSProfile(depth=50))

    def listen(self, topic: str, kind: str) -> None:
        add = self.received.setdefault(topic.removeprefix(PREFIX), []).append
        self.node.create_subscription(ros_type(kind), topic, add, QoSProfile(depth=50))

    def until(self, condition: Callable[[], bool], seconds: float = 60.0) -> bool:
        end = time.monotonic() + seconds
        while not (met := condition()) and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)
        return met

    def connected(self) -> bool:
        heard = all(self.node.count_publishers(topic) for topic in OUTPUTS)
        if not (heard and all(p.get_subscription_count() for p in self.inputs.values())):
            return False
        # The node may learn of the harness a little later than the harness of the node.
        time.sleep(1.0)
        return True

    def send(self, **messages: Any) -> None:
        """Publish messages; the detections come last."""
        for name in sorted(messages, key=lambda name: name == "detections"):
            self.inputs[name].publish(messages[name])

    def statuses(self) -> list[str]:
        return [message.message for message in self.received["status"]]

    def answered(self, number: int) -> bool:
        return self.until(lambda: len(self.received["status"]) >= number)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


def command(*arguments: str, program: str = "node") -> list[str]:
    node = [sys.executable, "-m", "elevator_rectify", program]
    return [*node, "--ros-args", "-p", "scale.column_pitch_m:=0.045", *arguments]


def start(*arguments: str, program: str = "node") -> subprocess.Popen[str]:
    made = command(*arguments, program=program)
    return subprocess.Popen(made, env=ENVIRONMENT, cwd=ROOT, stderr=subprocess.PIPE, text=True)


def stop(process: subprocess.Popen[str], number: signal.Signals = signal.SIGINT) -> str:
    """End the node as a user would; return what it said."""
    begin = time.monotonic()
    process.send_signal(number)
    assert process.wait(timeout=10.0) == 0
    seconds = time.monotonic() - begin
    assert process.stderr is not None
    said = process.stderr.read()
    assert "Traceback" not in said
    assert seconds < 3.0, f"the node took {seconds:.1f} s to end"
    return said
