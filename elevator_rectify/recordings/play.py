"""Plays a bag into live topics at its own rate: serialised messages as they are, compressed pictures as raw images."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from elevator_rectify.arguments import positive
from elevator_rectify.core.types import Image
from elevator_rectify.ros.bag import BadBag, Record, bag_topics, read_bag
from elevator_rectify.ros.messages import installed, make_ros, ros_type
from elevator_rectify.ros.output import image_message
from elevator_rectify.ros.pictures import image_from_message
from elevator_rectify.ros.poses import ros_header

_COMPRESSED = "sensor_msgs/msg/CompressedImage"
_DEPTH = 10
_SETTLE_SECONDS = 1.0


def live_topic(topic: str, kind: str) -> tuple[str, str]:
    """Return the topic and type that a recorded topic is played to."""
    if kind == _COMPRESSED:
        return topic.removesuffix("/compressed"), "sensor_msgs/msg/Image"
    return topic, kind


class Player:
    """Publishers for every topic of a bag; cameras publish best effort."""

    def __init__(self, node: Node, topics: dict[str, tuple[str, int]]) -> None:
        self._publishers: dict[str, Any] = {}
        qos = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        for topic, (kind, _) in topics.items():
            name, live_kind = live_topic(topic, kind)
            if not installed(live_kind):
                print(f"play: {topic} is left out, {live_kind.split('/')[0]} is not installed", file=sys.stderr)
                continue
            self._publishers[topic] = node.create_publisher(ros_type(live_kind), name, qos)

    def wait_for_listeners(self, topics: set[str], seconds: float) -> bool:
        """Wait until somebody subscribes to each of the recorded topics."""
        deadline = time.monotonic() + seconds
        awaited = [self._publishers[topic] for topic in topics if topic in self._publishers]
        while any(not publisher.get_subscription_count() for publisher in awaited):
            if time.monotonic() > deadline:
                return False
            time.sleep(0.05)
        return True

    def play(self, record: Record) -> None:
        """Publish one record."""
        if record.topic not in self._publishers:
            return
        content = as_raw_image(record.message) if record.kind == _COMPRESSED else record.data
        self._publishers[record.topic].publish(content)


def as_raw_image(message: Any) -> Any:
    """Return the raw rclpy Image of a CompressedImage."""
    picture: Image = np.ascontiguousarray(image_from_message(message))
    return image_message(picture, ros_header(message.header, make_ros), make_ros)


def play(path: Path, rate: float, wait_for: set[str], seconds: float) -> None:
    """Play the whole bag. Raises BadBag where it breaks off, TimeoutError where nobody listens."""
    node = rclpy.create_node("elevator_rectify_player")
    topics = bag_topics(path)
    if unknown := sorted(wait_for - topics.keys()):
        raise BadBag(f"{path} has no topic {', '.join(unknown)} to wait for; it has {', '.join(sorted(topics))}")
    player = Player(node, topics)
    if not player.wait_for_listeners(wait_for, seconds):
        raise TimeoutError(f"nobody subscribed to all of {', '.join(sorted(wait_for))} within {seconds:g} s")
    # The listeners may learn of the player a little later than it of them.
    time.sleep(_SETTLE_SECONDS if wait_for else 0.0)
    first, begin = None, time.monotonic()
    for record in read_bag(path):
        first = record.time_ns if first is None else first
        time.sleep(max(0.0, begin + (record.time_ns - first) * 1e-9 / rate - time.monotonic()))
        player.play(record)
    # Best-effort data leave with the process: let the last ones arrive.
    time.sleep(0.5)


def main(arguments: list[str] | None = None) -> int:
    """Command line: play a bag."""
    parser = argparse.ArgumentParser(prog="play", description=__doc__)
    parser.add_argument("bag", type=Path, help="folder of the bag")
    parser.add_argument("--rate", type=positive, default=1.0, help="speed, 1: as recorded")
    parser.add_argument(
        "--wait-for", nargs="*", default=[], metavar="TOPIC", help="recorded topics that must have a subscriber first"
    )
    parser.add_argument("--wait-seconds", type=positive, default=20.0, help="how long to wait for them")
    options = parser.parse_args(arguments)
    rclpy.init()
    try:
        play(options.bag, options.rate, set(options.wait_for), options.wait_seconds)
    except (BadBag, TimeoutError) as error:
        print(f"play: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 0
    finally:
        rclpy.try_shutdown()
    return 0
