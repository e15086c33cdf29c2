"""What integrators meet with a live node: their detector's messages, their QoS, their clocks and restarts."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message

from elevator_rectify.core.known.file import panel_text
from elevator_rectify.ros.messages import installed, make_ros, ros_type
from elevator_rectify.ros.poses import UNKNOWN_SCALE_VARIANCE
from test.harness import PREFIX, Harness, start, stop
from test.messages import camera_info, detections, header, image, vision_detections
from test.scenes import known_of, scene

DETECTIONS = "vision_msgs/msg/Detection2DArray"
# Of the real package, as given by `ros2 topic info -v` on a robot.
HASHES = {
    "Detection2DArray": "RIHS01_214274120007f4a683866481336b70310268cfa107aebe9d594a6acf75bda968",
    "Detection3DArray": "RIHS01_793f5eab9595ac1c0da07873cc859db42eae51f0ee76056db8562515d830e018",
}
pytestmark = pytest.mark.skipif(
    not installed(DETECTIONS), reason="vision_msgs is not installed: make test builds it from test/interfaces"
)
TRUTH = scene(1, tilt_deg=15.0, sigma_px=0.3)


@contextmanager
def live(*arguments: str, inputs: dict[str, str] | None = None, program: str = "node") -> Iterator[tuple[Any, Harness]]:
    process, harness = start(*arguments, program=program), Harness(inputs)
    try:
        yield process, harness
    finally:
        harness.close()
        if process.poll() is None:
            process.kill()
        process.wait()


def frame(stamp: int, **other: Any) -> dict[str, Any]:
    good = {
        "image": image(stamp),
        "camera_info": camera_info(stamp),
        "detections": detections(stamp, TRUTH.centres_px),
    }
    return {**good, **other}


@pytest.mark.parametrize("name", HASHES)
def test_the_stand_in_talks_to_the_real_vision_msgs(name: str) -> None:
    path = Path(sys.prefix) / "share" / "vision_msgs" / "msg" / f"{name}.json"
    if not path.exists():
        pytest.skip("the real vision_msgs is installed here")
    hashes = {t["type_name"]: t["hash_string"] for t in json.loads(path.read_text())["type_hashes"]}
    assert hashes[f"vision_msgs/msg/{name}"] == HASHES[name]


def test_vision_msgs_in_and_buttons_markers_and_tf_out() -> None:
    arguments = ["-p", "publish_tf:=true", "-p", "detections.labels:='0=B1'"]
    with live(*arguments, inputs={"detections": DETECTIONS}) as (process, harness):
        harness.listen("/tf", "tf2_msgs/msg/TFMessage")
        assert harness.until(harness.connected)
        labels = ["0", "7", "open", *[""] * (len(TRUTH.centres_px) - 3)]
        harness.send(**frame(1, detections=vision_detections(1, TRUTH.centres_px, labels)))
        assert harness.answered(1) and harness.statuses() == ["ok"]
        assert harness.until(lambda: all(harness.received[topic] for topic in ("buttons", "/tf", "markers")))
        (buttons,), (pose,) = harness.received["buttons"], harness.received["panel_pose"]
        found = {b.results[0].hypothesis.class_id for b in buttons.detections}
        assert len(buttons.detections) == len(TRUTH.centres_px) and found == {"B1", "open", ""}
        first = next(b for b in buttons.detections if b.id == "0,0")
        assert first.bbox.center.position == pose.pose.pose.position
        np.testing.assert_allclose(first.results[0].pose.covariance, pose.pose.covariance)
        (transform,) = harness.received["/tf"][0].transforms
        assert (transform.header.frame_id, transform.child_frame_id) == ("camera", "elevator_panel")
        assert transform.transform.translation.z == pose.pose.pose.position.z
        markers = harness.received["markers"][0].markers
        assert markers[0].action == markers[0].DELETEALL
        assert {m.text for m in markers if m.ns == "labels"} == {"B1", "open"}
        harness.send(**frame(2, detections=vision_detections(2, np.zeros((0, 2)), [])))
        assert harness.answered(2)
        assert harness.until(lambda: len(harness.received["markers"]) == 2)
        assert len(harness.received["markers"][1].markers) == 1, "old markers are deleted, and nothing is drawn"
        stop(process)


def test_another_detector_may_take_over_with_another_type() -> None:
    with live() as (process, harness):
        assert harness.until(harness.connected)
        harness.send(**frame(1))
        assert harness.answered(1)
        harness.advertise("detections", DETECTIONS)
        assert harness.until(lambda: bool(harness.inputs["detections"].get_subscription_count()))
        harness.until(lambda: False, 1.0)
        harness.send(**frame(2, detections=vision_detections(2, TRUTH.centres_px, [""] * len(TRUTH.centres_px))))
        assert harness.answered(2) and harness.statuses() == ["ok", "ok"]
        assert "Detection2DArray" in stop(process)


def test_compressed_images_come_in_and_go_out() -> None:
    arguments = ["-p", "image_transport:=compressed"]
    inputs = {"image/compressed": "sensor_msgs/msg/CompressedImage"}
    picture = np.full((480, 640, 3), 90, np.uint8)
    data = cv2.imencode(".png", picture)[1].ravel()

    def compressed(stamp: int, size: int) -> dict[str, Any]:
        message = make_ros("sensor_msgs/msg/CompressedImage", header=header(stamp), format="png", data=data[:size])
        rest = {name: content for name, content in frame(stamp).items() if name != "image"}
        return {"image/compressed": message, **rest}

    with live(*arguments, inputs=inputs) as (process, harness):
        harness.node.destroy_publisher(harness.inputs.pop("image"))
        assert harness.until(harness.connected)
        harness.send(**compressed(1, len(data)))
        assert harness.answered(1) and harness.statuses() == ["ok"]
        assert harness.until(lambda: bool(harness.received["rectified/image/compressed"]))
        message = harness.received["rectified/image/compressed"][0]
        view = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
        raw = harness.received["rectified/image"][0]
        assert view.shape[:2] == (raw.height, raw.width)
        harness.send(**compressed(2, 20))
        assert harness.answered(2) and "bad_input: image: data = 20 bytes" in harness.statuses()[1]
        stop(process)


def test_qos_that_does_not_match_is_logged_with_both_sides_settings() -> None:
    override = "qos_overrides./camera_info.subscription.reliability"
    with live("-p", f"{override}:=reliable") as (process, harness):
        unreliable = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        harness.node.create_publisher(ros_type("sensor_msgs/msg/CameraInfo"), "camera_info", unreliable)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        kind = ros_type("geometry_msgs/msg/PoseArray")
        harness.node.create_subscription(kind, PREFIX + "grid_centers", lambda _: None, latched)
        assert harness.until(harness.connected)
        harness.until(lambda: False, 1.0)
        said = stop(process)
    assert "camera_info: nothing will come from a publisher whose RELIABILITY does not match" in said
    assert "Ours: reliability RELIABLE" in said and "reliability BEST_EFFORT, durability VOLATILE" in said
    assert "grid_centers: a subscriber asks for another DURABILITY" in said and "TRANSIENT_LOCAL" in said


def shared_memory(pid: int) -> set[Path]:
    """Return the files in shared memory of a process that are its own: ports are shared with others."""
    lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
    found = {Path(line.split(maxsplit=5)[5]) for line in lines if "/dev/shm/fast" in line}
    return {path for path in found if "port" not in path.name and path.exists()}


def test_diagnostics_count_everything_and_nothing_is_left_behind() -> None:
    with live() as (process, harness):
        assert harness.until(harness.connected)
        harness.send(**frame(10))
        harness.send(image=image(11), camera_info=camera_info(11))
        harness.send(**frame(12, camera_info=camera_info(12), detections=detections(12)))
        harness.send(image=image(12))
        assert harness.answered(2)
        seen = harness.received["/diagnostics"]
        count = len(seen)
        assert harness.until(lambda: len(seen) >= count + 2)
        values = {pair.key: pair.value for pair in seen[-1].status[0].values}
        expected = {
            "image received": "4",
            "detections received": "2",
            "frames ok": "1",
            "frames too_few_detections": "1",
            "dropped image with a repeated stamp": "1",
            "image waiting for its counterpart": "1",
            "share accepted": "0.500",
            "detections type": "geometry_msgs/msg/PoseArray",
        }
        assert {key: values.get(key) for key in expected} == expected
        assert values["last reason"].startswith("too_few_detections")
        # Other programs of ROS may run on this machine: only what this node has mapped is looked at.
        own = shared_memory(process.pid)
        stop(process, signal.SIGTERM)
    assert own and not [path for path in own if path.exists()]


def test_without_a_scale_the_translation_is_unusable_and_says_so() -> None:
    with live("-p", "scale.column_pitch_m:=0.0") as (process, harness):
        assert harness.until(harness.connected)
        harness.send(**frame(1))
        assert harness.answered(1) and harness.until(lambda: bool(harness.received["panel_pose"]))
        covariance = np.array(harness.received["panel_pose"][0].pose.covariance).reshape(6, 6)
        np.testing.assert_allclose(covariance[:3, :3], UNKNOWN_SCALE_VARIANCE * np.eye(3))
        assert np.linalg.eigvalsh(covariance)[0] > 0 and covariance[3, 3] < 0.1
        values = {pair.key: pair.value for pair in harness.received["status"][0].values}
        assert (values["scale"], values["unit"]) == ("unknown", "column pitch")
        stop(process)


def test_a_target_is_found_or_the_status_says_why_not() -> None:
    inputs = {"detections": DETECTIONS, PREFIX + "target": "std_msgs/msg/String"}
    labels = [d.label for d in TRUTH.detections]
    arguments = ["-p", "detections.numbers_are_labels:=true"]
    with live(*arguments, inputs=inputs) as (process, harness):
        assert harness.until(harness.connected)

        def ask(target: str, stamp: int) -> dict[str, str]:
            harness.send(**{PREFIX + "target": make_ros("std_msgs/msg/String", data=target)})
            harness.until(lambda: False, 0.5)
            harness.send(**frame(stamp, detections=vision_detections(stamp, TRUTH.centres_px, labels)))
            assert harness.answered(stamp)
            return {pair.key: pair.value for pair in harness.received["status"][-1].values}

        assert ask("", 1)["target_status"] == ""
        assert ask("99", 2)["target_status"] == "unknown_label"
        assert not harness.received["target_pose"]
        assert ask("7", 3)["target_status"] == "found"
        assert harness.until(lambda: bool(harness.received["target_pose"] and harness.received["standoff_pose"]))
        poses = [harness.received[topic][0] for topic in ("target_pose", "standoff_pose")]
        at, before = (np.array([p.pose.position.x, p.pose.position.y, p.pose.position.z]) for p in poses)
        seven = next(k for k, button in enumerate(TRUTH.panel.buttons) if button.label == "7")
        truth = TRUTH.R_camera_panel @ TRUTH.panel.points_m[seven] + TRUTH.t_camera_panel
        # The pitch is given exactly; 0.3 px of noise.
        assert np.linalg.norm(at - truth) < 0.03 * np.linalg.norm(truth)
        assert np.linalg.norm(at - before) == pytest.approx(0.1) and np.linalg.norm(before) < np.linalg.norm(at)
        stop(process)


def test_a_taught_panel_is_pressed_without_labels_and_a_hidden_button_is_not(tmp_path: Path) -> None:
    path = tmp_path / "lobby.yaml"
    path.write_text(panel_text(known_of(TRUTH.panel)))
    seven = next(k for k, button in enumerate(TRUTH.panel.buttons) if button.label == "7")
    hidden = TRUTH.centres_px[TRUTH.button != seven]
    with live("-p", f"panel.file:={path}", inputs={PREFIX + "target": "std_msgs/msg/String"}) as (process, harness):
        assert harness.until(harness.connected)
        harness.send(**{PREFIX + "target": make_ros("std_msgs/msg/String", data="7")})
        harness.until(lambda: False, 0.5)
        for stamp, centres, status in ((1, TRUTH.centres_px, "found"), (2, hidden, "occluded")):
            harness.send(**frame(stamp, detections=detections(stamp, centres)))
            assert harness.answered(stamp)
            said = {pair.key: pair.value for pair in harness.received["status"][-1].values}
            assert (said["status"], said["panel"], said["target_status"]) == ("ok", "lobby", status)
        at = harness.received["target_pose"][0].pose.position
        truth = TRUTH.R_camera_panel @ TRUTH.panel.points_m[seven] + TRUTH.t_camera_panel
        # The scale is the file's; 0.3 px of noise.
        assert np.linalg.norm([at.x, at.y, at.z] - truth) < 0.02 * np.linalg.norm(truth)
        assert len(harness.received["target_pose"]) == 1
        stop(process)


def test_under_simulated_time_frames_are_answered_and_diagnostics_go_on() -> None:
    """Nobody publishes a clock yet: a node whose timers waited for it would be silent."""
    with live("-p", "use_sim_time:=true") as (process, harness):
        assert harness.until(harness.connected)
        harness.send(**frame(1))
        assert harness.answered(1) and harness.statuses() == ["ok"]
        count = len(harness.received["/diagnostics"])
        assert harness.until(lambda: len(harness.received["/diagnostics"]) > count)
        stop(process)


def test_a_missing_package_is_named(tmp_path: Path) -> None:
    with live("-p", "detections.type:=yolo_msgs", inputs={}) as (process, harness):
        assert harness.until(lambda: bool(harness.node.count_publishers("/diagnostics")))
        harness.until(lambda: False, 1.0)
        assert "sudo apt install ros-jazzy-yolo-msgs" in stop(process)


def test_malformed_bytes_on_any_topic_are_skipped_and_the_next_frame_is_answered() -> None:
    with live() as (process, harness):
        assert harness.until(harness.connected)
        for name in ("image", "camera_info", "detections"):
            whole = bytes(serialize_message(frame(1)[name]))
            for cut in (4, 5, len(whole) // 2):
                harness.inputs[name].publish(whole[:cut])
        harness.until(lambda: False, 1.0)
        harness.send(**frame(2))
        assert harness.until(lambda: "ok" in harness.statuses())
        stop(process)
