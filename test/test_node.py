"""The live node, in its own process, over real DDS."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elevator_rectify.ros.output import TOPICS
from elevator_rectify.ros.subscribe import subscribe
from test.harness import DOMAIN, ENVIRONMENT, ROOT, Harness, command, start, stop
from test.messages import camera_info, detections, image
from test.scenes import rotation_error_deg, scene


@pytest.fixture
def process() -> Iterator[subprocess.Popen[str]]:
    child = start()
    yield child
    if child.poll() is None:
        child.kill()
    child.wait()


@pytest.fixture
def harness() -> Iterator[Harness]:
    harness = Harness()
    yield harness
    harness.close()


def test_node_answers_good_frames_and_refuses_bad_ones(process: subprocess.Popen[str], harness: Harness) -> None:
    assert harness.until(harness.connected)
    truth = scene(1, tilt_deg=15.0, sigma_px=0.3)

    def frame(stamp: int, **bad: Any) -> dict[str, Any]:
        good = {
            "image": image(stamp),
            "camera_info": camera_info(stamp),
            "detections": detections(stamp, truth.centres_px),
        }
        return {**good, **bad}

    unknown = image(2)
    unknown.encoding = "yuv9"
    short = image(3)
    short.height = 900
    uncalibrated = camera_info(4)
    uncalibrated.k = np.zeros(9)
    other_size = camera_info(5)
    other_size.width = 320
    crowd = np.random.default_rng(0).uniform(-100, 800, (10_000, 2))
    frames = [
        (frame(1), "ok"),
        (frame(2, image=unknown), "image: encoding = yuv9"),
        (frame(3, image=short), "image: data = 921600 bytes"),
        (frame(4, camera_info=uncalibrated), "camera_info: k"),
        (frame(5, camera_info=other_size), "camera_info: width x height = 320 x 480"),
        (frame(6, detections=detections(6)), "too_few_detections: 0 usable"),
        (frame(7, detections=detections(7, np.full((9, 2), np.nan))), "9 not finite"),
        (frame(8, detections=detections(8, np.full((9, 2), 5000.0))), "outside the image"),
        (frame(9, detections=detections(9, crowd)), ""),
        (frame(10), "ok"),
    ]
    for number, (messages, expected) in enumerate(frames, start=1):
        harness.send(**messages)
        assert harness.until(lambda count=number: len(harness.received["status"]) >= count), harness.statuses()  # type: ignore[misc]
        assert expected in harness.statuses()[-1]
    assert harness.until(lambda: len(harness.received["panel_pose"]) >= 2)
    stamps = [message.header.stamp.nanosec for message in harness.received["panel_pose"]]
    assert stamps[0] == 1 and stamps[-1] == 10 and "ok" not in harness.statuses()[1:8]
    check_outputs(harness, truth)
    assert "refused" in stop(process, signal.SIGINT)


def check_outputs(harness: Harness, truth: Any) -> None:
    """The first frame's outputs carry the truth, one stamp and one frame."""
    first = {topic: harness.received[topic][0] for topic in TOPICS if topic not in ("status", "markers")}
    assert all(m.header.stamp.nanosec == 1 and m.header.frame_id == "camera" for m in first.values())
    position = first["panel_pose"].pose.pose.position
    found = np.array([position.x, position.y, position.z])
    # 0.3 px of 320 over 18 buttons.
    assert np.linalg.norm(found - truth.t_camera_panel) < 0.03 * np.linalg.norm(truth.t_camera_panel)
    assert len(first["grid_centers"].poses) == 18
    covariance = np.array(first["panel_pose"].pose.covariance).reshape(6, 6)
    assert np.linalg.eigvalsh(covariance)[0] > 0
    info, view = first["rectified/camera_info"], first["rectified/image"]
    assert (info.width, info.height) == (view.width, view.height)
    R = np.array(info.r).reshape(3, 3).T
    assert rotation_error_deg(R, truth.R_camera_panel) < 2.0


def test_messages_that_came_together_are_taken_in_one_turn(harness: Harness) -> None:
    """A flood would starve the other subscriptions, if each message cost the executor a turn."""
    received: list[Any] = []
    harness.advertise("flood", "geometry_msgs/msg/PoseArray")
    subscription = subscribe(harness.node, "geometry_msgs/msg/PoseArray", "flood", received.append)
    assert harness.until(lambda: bool(harness.inputs["flood"].get_subscription_count()))
    time.sleep(0.5)
    for stamp in range(20):
        harness.send(flood=detections(stamp, np.zeros((3, 2))))
    time.sleep(0.5)
    after = set[int]()

    def all_came() -> bool:
        after.add(len(received))
        return len(received) == 20

    assert harness.until(all_came, 5.0) and after <= {0, 20}
    assert [m.header.stamp.nanosec for m in received] == list(range(20))
    harness.node.destroy_subscription(subscription)


def test_parameters_are_checked_and_take_effect(process: subprocess.Popen[str], harness: Harness) -> None:
    from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
    from rcl_interfaces.srv import DescribeParameters, SetParametersAtomically

    assert harness.until(harness.connected)
    setter = harness.node.create_client(SetParametersAtomically, "/elevator_rectify/set_parameters_atomically")
    describer = harness.node.create_client(DescribeParameters, "/elevator_rectify/describe_parameters")
    assert setter.wait_for_service(10.0) and describer.wait_for_service(10.0)

    def call(client: Any, request: Any) -> Any:
        future = client.call_async(request)
        assert harness.until(future.done, 10.0)
        return future.result()

    def set_method(text: str) -> Any:
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text)
        return call(setter, SetParametersAtomically.Request(parameters=[Parameter(name="method", value=value)])).result

    refused = set_method("magic")
    assert not refused.successful and "magic" in refused.reason
    assert set_method("paper_as_printed").successful
    (described,) = call(describer, DescribeParameters.Request(names=["em.inlier_share"])).descriptors
    assert described.description and described.floating_point_range[0].to_value == pytest.approx(0.999)
    harness.send(image=image(1), camera_info=camera_info(1), detections=detections(1))
    assert harness.until(lambda: bool(harness.received["status"]))
    values = {pair.key: pair.value for pair in harness.received["status"][0].values}
    assert values["method"] == "paper_as_printed"
    stop(process, signal.SIGTERM)


def test_a_wrong_parameter_ends_the_node_with_a_message() -> None:
    wrong = command("-p", "em.inlier_share:=7.0")
    ended = subprocess.run(wrong, env=ENVIRONMENT, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 2 and "inlier_share" in ended.stderr and "Traceback" not in ended.stderr


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (["--params-file", "/nowhere.yaml"], "/nowhere.yaml"),
        (["-p", "qos_overrides./image.subscription.reliability:=sometimes"], "sometimes"),
        (["-r", "image"], "remap rule"),
    ],
)
def test_a_wrong_command_line_ends_the_node_with_a_message(wrong: list[str], words: str) -> None:
    ended = subprocess.run(
        command(*wrong), env=ENVIRONMENT, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False
    )
    assert ended.returncode == 2 and words in ended.stderr and "Traceback" not in ended.stderr


@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
def test_a_node_that_is_ended_while_it_starts_ends_in_order(number: str) -> None:
    code = (
        "import os, signal, time; from elevator_rectify.ros.running import run_node\n"
        f"def make(): os.kill(os.getpid(), signal.{number}); time.sleep(30.0)\n"
        "raise SystemExit(run_node(make, None))"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True, timeout=60, check=False
    )
    assert (run.returncode, run.stderr) == (0, "")


def test_the_demo_answers_every_image(tmp_path: Path) -> None:
    script = "import sys; from elevator_rectify.live.demo import main; sys.exit(main(sys.argv[1:]))"
    command = [
        sys.executable,
        "-c",
        script,
        "bags/paper_5x5",
        "--output",
        str(tmp_path / "demo"),
        "--domain",
        str(DOMAIN),
    ]
    ended = subprocess.run(command, cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True, timeout=200, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "25 images played, 25 answered, 25 of them completely" in ended.stdout
