"""Runs a node in its own process, feeds it over DDS at a steady rate and notes when its answers come."""

from __future__ import annotations

import os
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy

from elevator_rectify.live.demo import dds_environment, running
from elevator_rectify.ros.convert import output_stamp_ns
from elevator_rectify.ros.messages import ros_type

_START_SECONDS, _SETTLE_SECONDS = 60.0, 2.0
# A node that is behind catches up with what waits, eight frames at most, in less.
_LAST_SECONDS = 20.0
_INPUTS = {
    "image": "sensor_msgs/msg/Image",
    "camera_info": "sensor_msgs/msg/CameraInfo",
    "detections": "geometry_msgs/msg/PoseArray",
}
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass
class Answers:
    """By topic: {stamp in ns: seconds of arrival, on the clock of `time.perf_counter`}, and the last messages."""

    arrived: dict[str, dict[int, float]] = field(default_factory=dict)
    last: dict[str, Any] = field(default_factory=dict)


class Driver:
    """Publishes inputs and listens to outputs: {topic: (type, read it fully)}; else only its stamp is read."""

    def __init__(self, domain: int, listen: dict[str, tuple[str, bool]], inputs: dict[str, str] | None = None) -> None:
        os.environ.update(dds_environment(domain))
        self.context, self._domain = rclpy.Context(), domain
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node("driver", context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self.publishers = {
            name: self.node.create_publisher(ros_type(kind), name, QoSProfile(depth=30))
            for name, kind in (inputs or _INPUTS).items()
        }
        self.answers = Answers({topic: {} for topic in listen})
        self.messages: dict[str, dict[int, list[Any]]] = {topic: {} for topic, (_, fully) in listen.items() if fully}
        for topic, (kind, fully) in listen.items():
            self._listen(topic, kind, fully)

    def _listen(self, topic: str, kind: str, fully: bool) -> None:
        qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
        note = self._note if fully else self._note_raw
        self.node.create_subscription(ros_type(kind), topic, lambda m: note(topic, m), qos, raw=not fully)

    def _note(self, topic: str, message: Any) -> None:
        stamp = output_stamp_ns(message)
        self.answers.last[topic] = message
        self.answers.arrived[topic][stamp] = time.perf_counter()
        self.messages[topic].setdefault(stamp, []).append(message)

    def _note_raw(self, topic: str, data: bytes) -> None:
        # CDR, little endian: after four bytes of encapsulation the header's stamp, as seconds and nanoseconds.
        seconds, nanoseconds = (int.from_bytes(data[k : k + 4], "little") for k in (4, 8))
        self.answers.arrived[topic][seconds * 10**9 + nanoseconds] = time.perf_counter()

    def connect(self) -> None:
        """Wait until every topic has its other side, and a little longer. Raises TimeoutError."""
        end = time.monotonic() + _START_SECONDS
        while not (
            all(publisher.get_subscription_count() for publisher in self.publishers.values())
            and all(self.node.count_publishers(topic) for topic in self.answers.arrived)
        ):
            if time.monotonic() > end:
                raise TimeoutError(f"the node was not there within {_START_SECONDS:g} s")
            self.spin(0.1)
        self.spin(_SETTLE_SECONDS)

    def restart(self, inputs: dict[str, str]) -> None:
        """Destroy the publishers and make new ones; wait until the node has found them."""
        for name, kind in inputs.items():
            self.node.destroy_publisher(self.publishers[name])
            self.publishers[name] = self.node.create_publisher(ros_type(kind), name, QoSProfile(depth=30))
        self.connect()

    @contextmanager
    def stranger(self) -> Iterator[Any]:
        """Lend a node of another participant of this process."""
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=self._domain)
        node = rclpy.create_node("stranger", context=context)
        try:
            yield node
        finally:
            node.destroy_node()
            rclpy.shutdown(context=context)

    def send(self, messages: dict[str, Any]) -> float:
        """Publish one frame's messages; return the time."""
        now = time.perf_counter()
        for name, message in messages.items():
            if name in self.publishers:
                self.publishers[name].publish(message)
        return now

    def spin(self, seconds: float) -> None:
        """Take what arrives for so long."""
        end = time.perf_counter() + seconds
        while (left := end - time.perf_counter()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def catch_up(self, topic: str, stamps: Collection[int]) -> None:
        """Take what arrives until all stamps are answered on the topic, or nothing more can be expected."""
        end = time.perf_counter() + _LAST_SECONDS
        while not self.answers.arrived[topic].keys() >= set(stamps) and time.perf_counter() < end:
            self.spin(0.1)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@contextmanager
def driven(command: list[str], driver: Driver, domain: int) -> Iterator[int]:
    """Run a node while the block drives it; yield its process id."""
    with running(command, dds_environment(domain)) as process:
        driver.connect()
        yield process.pid


def cpu_seconds(pid: int) -> float:
    """Return the processor time that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def resident_megabytes(pid: int) -> float:
    """Return the memory that a process holds."""
    line = next(x for x in Path(f"/proc/{pid}/status").read_text().splitlines() if x.startswith("VmRSS"))
    return int(line.split()[1]) / 1024.0
