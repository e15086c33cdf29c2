"""The whole thing live: a player process feeds the node process over DDS; what it publishes is recorded and checked."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from elevator_rectify.arguments import add_bag, add_domain, bag_or_sample
from elevator_rectify.recordings.page import write_page
from elevator_rectify.recordings.report import Outcome, write_report
from elevator_rectify.recordings.topics import OUTPUT_PREFIX, InputTopics, find_topics
from elevator_rectify.ros.bag import BagWriter, bag_topics, bag_writer
from elevator_rectify.ros.messages import installed, ros_type
from elevator_rectify.ros.output import TARGET, TOPICS
from elevator_rectify.share import share_file

# Outputs come in bursts of a picture each; the recorder must not lose any.
_RECORD_DEPTH = 100
_QUIET_SECONDS = 20.0
# What a robot would know of the sample bag's elevators.
_SAMPLE_PARAMETERS = ("scale.column_pitch_m:=0.045",)
_START_SECONDS, _SETTLE_SECONDS = 60.0, 2.0


def dds_environment(domain: int) -> dict[str, str]:
    """Return the environment of a graph of its own on this machine, with the shared-memory profile."""
    environment = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(domain)}
    environment["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(share_file("config/fastdds.xml"))
    return environment


@contextmanager
def running(command: list[str], environment: dict[str, str]) -> Iterator[subprocess.Popen[bytes]]:
    """Run a process for the time of the block, then end it as Ctrl-C would."""
    process = subprocess.Popen(command, env=environment)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(timeout=10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def remaps(topics: InputTopics) -> list[str]:
    """Return the arguments that connect the node to a played bag's topics."""
    image = topics.image.removesuffix("/compressed")
    pairs = {"image": image, "camera_info": topics.camera_info, "detections": topics.detections}
    return ["--ros-args", *(part for name, topic in pairs.items() for part in ("-r", f"{name}:={topic}"))]


class Recorder:
    """Records all outputs of the node into a bag and counts the statuses."""

    def __init__(self, bag: BagWriter, expected: int, press: str) -> None:
        self.answered, self.expected = 0, expected
        self._bag, self._last = bag, time.monotonic()
        self._node = rclpy.create_node("elevator_rectify_recorder")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        for topic, kind in {**TOPICS, **TARGET}.items():
            self._subscribe(topic, kind)
        latched = QoSProfile(
            depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
        )
        string = ros_type("std_msgs/msg/String")
        self._target = self._node.create_publisher(string, OUTPUT_PREFIX + "target", latched)
        self._target.publish(string(data=press))

    def _subscribe(self, topic: str, kind: str) -> None:
        qos = QoSProfile(depth=_RECORD_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
        name, message_type = OUTPUT_PREFIX + topic, ros_type(kind)
        self._node.create_subscription(message_type, name, lambda data: self._write(topic, kind, data), qos, raw=True)

    def _write(self, topic: str, kind: str, data: bytes) -> None:
        self._bag.write_raw(OUTPUT_PREFIX + topic, kind, data, time.time_ns())
        self._last = time.monotonic()
        if topic == "status":
            self.answered += 1
            end = "" if self.answered < self.expected else "\n"
            print(f"\r{self.answered}/{self.expected} frames answered", end=end, file=sys.stderr, flush=True)

    def connect(self) -> None:
        """Wait for the node; what it publishes before both sides know of each other is lost."""
        deadline = time.monotonic() + _START_SECONDS
        while any(not self._node.count_publishers(OUTPUT_PREFIX + topic) for topic in TOPICS):
            if time.monotonic() > deadline:
                raise TimeoutError(f"the node did not start within {_START_SECONDS:g} s")
            self._spin(0.1)
        # The node may learn of its listener a little later than the listener of the node.
        self._spin(_SETTLE_SECONDS)

    def record(self, finished: Callable[[], bool]) -> None:
        """Record until all statuses came, or the player has finished and the node fallen silent."""
        while not (finished() and (self.answered >= self.expected or time.monotonic() - self._last > _QUIET_SECONDS)):
            self._spin(0.2)
        # What arrived together with the last status.
        self._spin(0.5)
        self._node.destroy_node()

    def _spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.05)


@dataclass(frozen=True)
class Session:
    """What is played to which node: bag, folder of the results, ROS_DOMAIN_ID, the node's arguments, label to press."""

    source: Path
    folder: Path
    domain: int
    arguments: tuple[str, ...] = ()
    press: str = ""


def run(session: Session, own: bool = False) -> int:
    """Run the demo, with own also without the bag's detections; 0 when every image was answered or refused.

    Where both are run the table shows how they differ.
    """
    expected = bag_topics(session.source)[find_topics(session.source, {}, installed).image][1]
    os.environ.update(dds_environment(session.domain))
    print(f"node and player on ROS_DOMAIN_ID={session.domain}; {expected} images from {session.source}")
    rclpy.init()
    runs = {"live": session, **({"own detector": with_own_detector(session)} if own else {})}
    outputs, answered = {}, {}
    for name, each in runs.items():
        outputs[name] = session.folder / f"bag_{name.replace(' ', '_')}"
        answered[name] = record(each, outputs[name], expected)
    rclpy.try_shutdown()
    code = 0
    report = write_report(session.source, outputs, session.folder)
    write_page(session.source, session.folder, report, {"arguments": " ".join(session.arguments)})
    for name, outcomes in report.outcomes.items():
        print(f"\n{name}:")
        if session.press:
            print(pressed(outcomes, session.press))
        code = max(code, verdict(outcomes, expected, answered[name]))
    return code


def with_own_detector(session: Session) -> Session:
    """Return the same session with the node's own detector."""
    return replace(session, arguments=(*session.arguments, "-p", "detector:=own"))


def record(session: Session, output: Path, expected: int) -> int:
    """Play the bag to a node of its own and record what it publishes; return how many images were answered."""
    topics, python = find_topics(session.source, {}, installed), [sys.executable, "-m", "elevator_rectify"]
    environment = dds_environment(session.domain)
    wait = ["--wait-for", topics.image, topics.camera_info, topics.detections]
    node = [*python, "node", *remaps(topics), *session.arguments]
    with running(node, environment), bag_writer(output) as bag:
        recorder = Recorder(bag, expected, session.press)
        recorder.connect()
        with running([*python, "play", str(session.source), *wait], environment) as player:
            recorder.record(lambda: player.poll() is not None)
    return recorder.answered


def pressed(outcomes: list[Outcome], label: str) -> str:
    """Return how often the button was found, and how far from the true one where that is known."""
    found = [o for o in outcomes if o.target is not None]
    text = f"button {label}: found in {len(found)} of {len(outcomes)} images"
    errors = 1e3 * np.array([e for e in (o.target_error_m(label) for o in found) if np.isfinite(e)])
    if len(errors):
        text += f", {np.median(errors):.1f} mm off in the median, {errors.max():.1f} mm at most"
    reasons = sorted({o.values.get("target_status", "") for o in outcomes if o.target is None} - {""})
    return text + (f"; otherwise: {', '.join(reasons)}" if reasons else "")


def verdict(outcomes: list[Outcome], expected: int, answered: int) -> int:
    """Print what arrived and how long it took; 0 when every image has a status, with a reason where refused."""
    complete = [o for o in outcomes if o.verdict and (o.ok == (o.verdict == "ok")) and (not o.ok or o.viewed)]
    refused = [o.verdict for o in outcomes if not o.ok]
    print(f"{expected} images played, {answered} answered, {len(complete)} of them completely, {len(refused)} refused:")
    print("\n".join(f"  {reason}" for reason in sorted(set(refused))) or "  none")
    print(timings(outcomes))
    return 0 if answered == expected == len(complete) else 1


def timings(outcomes: list[Outcome]) -> str:
    """Return the node's milliseconds per frame by stage."""
    lines = [f"{'stage':<10}{'median ms':>11}{'p95 ms':>9}"]
    for stage in ("convert", "fit", "warp", "overlay", "publish"):
        values = [float(o.values[f"{stage}_ms"]) for o in outcomes if f"{stage}_ms" in o.values]
        if values:
            lines.append(f"{stage:<10}{np.median(values):>11.2f}{np.percentile(values, 95):>9.2f}")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Command line: the live demo."""
    parser = argparse.ArgumentParser(prog="demo", description=__doc__)
    add_bag(parser, "bag")
    parser.add_argument("--output", type=Path, default=Path("out/demo"), help="folder for the bag, pictures and table")
    add_domain(parser, 77)
    parser.add_argument("--param", action="append", default=[], metavar="NAME:=VALUE", help="a parameter of the node")
    parser.add_argument("--own", action="store_true", help="once more with the node's own detector, for comparison")
    parser.add_argument("--press", metavar="LABEL", help="a button to press; of the sample bag 7")
    options = parser.parse_args(arguments)
    if options.bag is None:
        options.param = [*_SAMPLE_PARAMETERS, *options.param]
        options.press = "7" if options.press is None else options.press
    if options.output.exists():
        options.output = options.output.with_name(f"{options.output.name}_{time.strftime('%Y%m%d_%H%M%S')}")
    node_arguments = tuple(part for assignment in options.param for part in ("-p", assignment))
    try:
        source = Path(bag_or_sample(options.bag))
        session = Session(source, options.output, options.domain, node_arguments, options.press or "")
        return run(session, options.own)
    except (ValueError, TimeoutError, FileNotFoundError) as error:
        print(f"demo: {error}", file=sys.stderr)
        return 2
