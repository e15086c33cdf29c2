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
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy

from elevator_rectify.bag import BagWriter, bag_topics, bag_writer
from elevator_rectify.replay import OUTPUT_PREFIX, InputTopics, find_topics
from elevator_rectify.report import Outcome, write_report
from elevator_rectify.ros.messages import ros_type
from elevator_rectify.ros.output import TOPICS

# Outputs come in bursts of a picture each; the recorder must not lose any.
_RECORD_DEPTH = 100
_QUIET_SECONDS = 20.0


def dds_environment(domain: int) -> dict[str, str]:
    """Return the environment of a graph of its own on this machine, with the shared-memory profile where found."""
    environment = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(domain)}
    profile = Path(__file__).parent.parent / "config" / "fastdds.xml"
    if profile.exists():
        environment["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(profile)
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


def record(bag: BagWriter, expected: int, finished: Callable[[], bool]) -> int:
    """Record the node's outputs until `expected` statuses came, or it fell silent; return how many came."""
    node, answered = rclpy.create_node("elevator_rectify_recorder"), 0
    last = time.monotonic()

    def write(topic: str, kind: str, data: bytes) -> None:
        nonlocal answered, last
        bag.write_raw(OUTPUT_PREFIX + topic, kind, data, time.time_ns())
        last = time.monotonic()
        if topic == "status":
            answered += 1
            print(
                f"\r{answered}/{expected} frames answered",
                end="" if answered < expected else "\n",
                file=sys.stderr,
                flush=True,
            )

    def subscribe(topic: str, kind: str) -> None:
        qos = QoSProfile(depth=_RECORD_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
        node.create_subscription(
            ros_type(kind), OUTPUT_PREFIX + topic, lambda data: write(topic, kind, data), qos, raw=True
        )

    for topic, kind in TOPICS.items():
        subscribe(topic, kind)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not (finished() and (answered >= expected or time.monotonic() - last > _QUIET_SECONDS)):
        executor.spin_once(timeout_sec=0.2)
    _drain(executor)
    node.destroy_node()
    return answered


def _drain(executor: SingleThreadedExecutor) -> None:
    """Take in what arrived together with the last status."""
    end = time.monotonic() + 0.5
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)


def run(source: Path, folder: Path, domain: int, node_arguments: list[str]) -> int:
    """Run the demo; return 0 when every image was answered or refused with a reason."""
    topics = find_topics(source, {})
    expected = bag_topics(source)[topics.image][1]
    environment = dds_environment(domain)
    os.environ.update(environment)
    output = folder / "bag"
    python = [sys.executable, "-m", "elevator_rectify"]
    wait = ["--wait-for", topics.image, topics.camera_info, topics.detections]
    rclpy.init()
    print(f"node and player on ROS_DOMAIN_ID={domain}; {expected} images from {source}")
    with running([*python, "node", *remaps(topics), *node_arguments], environment):
        with running([*python, "play", str(source), *wait], environment) as player, bag_writer(output) as bag:
            answered = record(bag, expected, lambda: player.poll() is not None)
    rclpy.try_shutdown()
    outcomes = write_report(source, {"live": output}, folder)["live"]
    return verdict(outcomes, expected, answered)


def verdict(outcomes: list[Outcome], expected: int, answered: int) -> int:
    """Print what arrived and how long it took; 0 when every image has a status, with a reason where refused."""
    complete = [o for o in outcomes if o.verdict and (o.ok == (o.verdict == "ok")) and (not o.ok or o.view is not None)]
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
    parser.add_argument("bag", type=Path, nargs="?", default=Path("bags/paper_5x5"))
    parser.add_argument("--output", type=Path, default=Path("out/demo"))
    parser.add_argument("--domain", type=int, default=77, help="ROS_DOMAIN_ID of the demo")
    parser.add_argument("--param", action="append", default=[], metavar="NAME:=VALUE", help="a parameter of the node")
    options = parser.parse_args(arguments)
    if options.output.exists():
        options.output = options.output.with_name(f"{options.output.name}_{time.strftime('%Y%m%d_%H%M%S')}")
    node_arguments: list[Any] = [part for assignment in options.param for part in ("-p", assignment)]
    try:
        return run(options.bag, options.output, options.domain, node_arguments)
    except ValueError as error:
        print(f"demo: {error}", file=sys.stderr)
        return 2
