"""The node without a detector's topic, and our own detector as a node, over real DDS between processes."""

from __future__ import annotations

import subprocess
import sys

import pytest

from elevator_rectify.benchmark.pictures import Pictured, pictured
from elevator_rectify.ros.convert import detections_from_message
from elevator_rectify.ros.messages import installed, ros_type
from test.harness import ENVIRONMENT, PREFIX, ROOT, Harness, start, stop
from test.messages import camera_info, detections, image

VISION = "vision_msgs/msg/Detection2DArray"


@pytest.fixture(scope="module")
def given() -> Pictured:
    return pictured("easy", 60, 0, held_out=True)


def status(harness: Harness, number: int) -> dict[str, str]:
    return {pair.key: pair.value for pair in harness.received["status"][number].values}


def test_the_node_finds_the_buttons_itself_and_a_target_by_its_own_reading(given: Pictured) -> None:
    harness, process = Harness(), start("-p", "detector:=own")
    target = harness.node.create_publisher(ros_type("std_msgs/msg/String"), PREFIX + "target", 1)
    try:
        assert harness.until(harness.connected) and harness.until(lambda: target.get_subscription_count() > 0)
        target.publish(ros_type("std_msgs/msg/String")(data="7"))
        for stamp in (1, 2):
            harness.send(image=image(stamp, given.image), camera_info=camera_info(stamp, given.scene.camera))
            assert harness.answered(stamp)
        assert harness.statuses() == ["ok", "ok"]
        assert status(harness, 1)["detections_from"] == "own" and status(harness, 1)["target_status"] == "found"
        assert harness.until(lambda: len(harness.received["target_pose"]) >= 1)
        stop(process)
    finally:
        process.kill()
        harness.close()


def test_detections_of_a_topic_come_first(given: Pictured) -> None:
    harness, process = Harness(), start()
    try:
        assert harness.until(harness.connected)
        harness.send(
            image=image(1, given.image),
            camera_info=camera_info(1, given.scene.camera),
            detections=detections(1, given.scene.centres_px),
        )
        assert harness.answered(1) and status(harness, 0)["detections_from"] == "topic"
        stop(process)
    finally:
        process.kill()
        harness.close()


@pytest.mark.skipif(not installed(VISION), reason="vision_msgs is not installed")
def test_the_detector_as_a_node_publishes_labelled_boxes(given: Pictured) -> None:
    harness = Harness()
    harness.node.destroy_publisher(harness.inputs.pop("detections"))
    harness.listen("/detections", VISION)
    command = [sys.executable, "-m", "elevator_rectify", "detector", "--ros-args", "-r", "__ns:=/"]
    process = subprocess.Popen(command, env=ENVIRONMENT, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    try:
        assert harness.until(lambda: harness.inputs["image"].get_subscription_count() > 0)
        found = harness.received["/detections"]

        def answered() -> bool:
            harness.send(image=image(5, given.image))
            return harness.until(lambda: bool(found), 1.0)

        assert harness.until(answered)
        read = detections_from_message(found[0])
        assert found[0].header.stamp.nanosec == 5 and len(read) >= 0.6 * len(given.scene.detections)
        bad = image(6, given.image)
        bad.encoding = "nonsense"
        harness.send(image=bad)
        harness.send(image=image(7, given.image))
        assert harness.until(lambda: any(m.header.stamp.nanosec == 7 for m in found)), "a bad image ended it"
        stop(process)
    finally:
        process.kill()
        harness.close()
