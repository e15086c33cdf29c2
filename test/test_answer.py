"""One frame's messages through the core, as node and replay do it."""

from __future__ import annotations

import array
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from elevator_rectify.benchmark.pictures import pictured
from elevator_rectify.core import Config, ScaleConfig, fit_panel, rectify_image
from elevator_rectify.core.geometry.rotations import rotation
from elevator_rectify.core.view.draw import draw_rectified
from elevator_rectify.ros.answer import Answer, answer_frame
from elevator_rectify.ros.config import NodeConfig, PairingConfig
from elevator_rectify.ros.messages import make_ros
from elevator_rectify.ros.output import output_messages
from elevator_rectify.ros.pairing import Frame
from elevator_rectify.ros.poses import rotation_of
from test.messages import camera_info, detections, header, image
from test.scenes import patches_read, scene

VIEW = scene(2, tilt_deg=20.0, sigma_px=0.5)
ALONE = NodeConfig(track=False)


def frame(stamp: int, **other: Any) -> Frame:
    given = {"image": image(stamp), "camera_info": camera_info(stamp), "detections": detections(stamp, VIEW.centres_px)}
    return Frame(**{**given, **other})


def test_without_tracking_the_result_is_that_of_fit_panel_bit_for_bit() -> None:
    _, track = answer_frame(frame(1), Config())
    answer, _ = answer_frame(frame(2), Config(), node=ALONE)
    expected = fit_panel(list(answer.detections), VIEW.camera, Config())
    assert track is not None
    for item in fields(expected):
        np.testing.assert_array_equal(getattr(answer.fit, item.name), getattr(expected, item.name))


def test_tracking_starts_from_the_last_fit_and_survives_a_refused_frame() -> None:
    _, track = answer_frame(frame(1), Config())
    refused, track = answer_frame(frame(2, detections=detections(2)), Config(), track=track)
    assert not refused.fit.ok and track is not None
    answer, after = answer_frame(frame(3), Config(), track=track)
    assert answer.fit.ok and after is not None and after.stamp_ns == 3


def test_labels_are_read_at_keyframes_and_where_a_frame_must_say_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    given, read, track = pictured("easy", 60, 0, held_out=True), patches_read(monkeypatch), None
    labels, counts = [], []
    for tenth in (1, 2, 5, 6, 7):
        wanted = ("labels", "reading") if tenth == 7 else ("labels",)
        stamp = tenth * 100_000_000
        one = Frame(image(stamp, given.image), camera_info(stamp, given.scene.camera), None)
        read.clear()
        answer, track = answer_frame(one, Config(), wanted, track=track)
        counts.append(sum(read))
        labels.append([d.label for d in answer.fit.detections])
    assert counts[1] == counts[2] == 0 and min(counts[0], counts[3], counts[4]) >= len(labels[0])
    assert len(set(map(tuple, labels))) == 1 and sum(label != "" for label in labels[0]) > 0.5 * len(labels[0])


def test_nothing_is_made_for_topics_without_a_listener() -> None:
    answer, _ = answer_frame(frame(1), Config(), wanted=())
    assert answer.view is None and answer.overlay is None and "convert" in answer.stopwatch.milliseconds
    made = [topic for topic, _ in output_messages(answer, make_ros, lambda topic: topic == "panel_pose")]
    assert made == ["panel_pose"]


@pytest.mark.parametrize("wanted", [(), ("rectified",)])
def test_a_bad_image_is_refused_whether_its_picture_is_wanted_or_not(wanted: tuple[str, ...]) -> None:
    broken = image(1)
    broken.data = array.array("B", bytes(10))
    answer, _ = answer_frame(frame(1, image=broken), Config(), wanted)
    assert answer.fit.status == "bad_input" and "image: data = 10 bytes" in answer.fit.reason


def test_image_and_camera_info_of_different_frames_are_refused() -> None:
    other = camera_info(1)
    other.header = header(1, "right_camera")
    answer, _ = answer_frame(frame(1, camera_info=other), Config())
    assert answer.fit.reason == "camera_info: header.frame_id = 'right_camera' is not the image's 'camera'"


def test_a_nameless_camera_info_is_the_images_where_that_is_said() -> None:
    nameless = camera_info(1)
    nameless.header = header(1, "")
    answer, _ = answer_frame(frame(1, camera_info=nameless), Config())
    assert answer.fit.status == "bad_input" and "pairing.nameless_camera_info" in answer.fit.reason
    said = NodeConfig(pairing=PairingConfig(nameless_camera_info=True))
    assert answer_frame(frame(1, camera_info=nameless), Config(), node=said)[0].fit.ok
    other = camera_info(1)
    other.header = header(1, "right_camera")
    assert answer_frame(frame(1, camera_info=other), Config(), node=said)[0].fit.status == "bad_input"


def depth(encoding: str, metres: float) -> Any:
    data = np.full((480, 640), metres, "<f4").view(np.uint8).ravel()
    fields_of = {"height": 480, "width": 640, "encoding": encoding, "is_bigendian": 0, "step": 2560}
    return make_ros("sensor_msgs/msg/Image", header=header(1), data=data, **fields_of)


def status(answer: Answer) -> dict[str, str]:
    (message,) = [m for topic, m in output_messages(answer, make_ros) if topic == "status"]
    return {pair.key: pair.value for pair in message.values}


def test_a_depth_image_that_cannot_be_used_leaves_the_orientation() -> None:
    frontal = scene(2, tilt_deg=0.0, sigma_px=0.5)
    centres = detections(1, frontal.centres_px)
    good, _ = answer_frame(frame(1, detections=centres, depth=depth("32FC1", 0.6)), Config())
    assert status(replace(good, calibration="focal length 1.04"))["calibration"] == "focal length 1.04"
    assert not status(good)["calibration"]
    assert status(good)["scale"] == "depth" and good.fit.t_camera_panel[2] == pytest.approx(0.6, rel=0.02)
    bad, _ = answer_frame(frame(1, detections=centres, depth=depth("bgr8", 0.6)), Config())
    assert bad.fit.ok and status(bad)["scale"].startswith("unknown: depth: encoding = bgr8")


def test_a_compressed_image_is_decoded_only_for_a_picture() -> None:
    """Its size is not known without decoding; what cannot be decoded is refused where it is wanted."""
    message = make_ros("sensor_msgs/msg/CompressedImage", header=header(1), format="jpeg", data=np.ones(9, np.uint8))
    assert answer_frame(frame(1, image=message), Config(), (), NodeConfig(measure=False))[0].fit.ok
    assert answer_frame(frame(1, image=message), Config(), ())[0].fit.status == "bad_input"
    assert answer_frame(frame(1, image=message), Config(), ("rectified",))[0].fit.status == "bad_input"
    empty = replace(frame(1), image=make_ros("sensor_msgs/msg/CompressedImage", header=header(1)))
    assert answer_frame(empty, Config(), ())[0].fit.status == "bad_input"


def test_the_rectified_overlay_has_the_labels_at_the_buttons() -> None:
    labelled = replace(VIEW, detections=tuple(replace(d, label="7") for d in VIEW.detections))
    fit = fit_panel(list(labelled.detections), VIEW.camera)
    picture = np.zeros((VIEW.camera.height, VIEW.camera.width, 3), np.uint8)
    view = rectify_image(picture, VIEW.camera, fit)
    drawn = draw_rectified(view, fit.buttons, fit.buttons[4])
    for button in fit.buttons:
        x, y = view.camera.project((view.R_rectified_camera @ button.point)[None])[0].round().astype(int)
        assert drawn[max(0, y - 25) : y + 5, x : x + 25].any()
    assert not view.image.any(), "the view itself stays as it is"


def test_drawings_are_made_only_where_they_are_wanted() -> None:
    for wanted in ((), ("overlay",), ("rectified_overlay",), ("rectified",)):
        answer, _ = answer_frame(frame(1), Config(), wanted)
        assert (answer.overlay is not None) == ("overlay" in wanted)
        assert (answer.rectified_overlay is not None) == ("rectified_overlay" in wanted)


def test_messages_of_another_camera_are_refused() -> None:
    other = detections(1, VIEW.centres_px)
    other.header.frame_id = "left_camera"
    refused, _ = answer_frame(frame(1, detections=other), Config())
    assert refused.fit.status == "bad_input" and "detections: header.frame_id = 'left_camera'" in refused.fit.reason
    other.header.frame_id = ""
    assert answer_frame(frame(1, detections=other), Config())[0].fit.ok, "a detector may leave the frame empty"
    far = depth("32FC1", 0.6)
    far.header.frame_id = "left_camera"
    answer, _ = answer_frame(frame(1, depth=far), Config())
    assert answer.fit.ok and status(answer)["scale"].startswith("unknown: depth: header.frame_id")


def test_the_docking_pose_needs_no_other_rotation_than_the_docking_servers_own() -> None:
    answer, _ = answer_frame(frame(1), Config(scale=ScaleConfig(column_pitch_m=0.045)))
    (message,) = [m for topic, m in output_messages(answer, make_ros) if topic == "docking_pose"]
    turn, at = message.pose.orientation, message.pose.position
    # SimpleChargingDock's defaults: roll -1.57, pitch 1.57 about the axes of the detected pose.
    own = rotation(np.array([0.0, np.pi / 2, 0.0])) @ rotation(np.array([-np.pi / 2, 0.0, 0.0]))
    dock = rotation_of(turn.x, turn.y, turn.z, turn.w) @ own
    R = answer.fit.R_camera_panel
    # The dock's x points to where the robot drives, into the panel, and its z up.
    np.testing.assert_allclose(dock, np.column_stack([R[:, 2], -R[:, 0], -R[:, 1]]), atol=1e-9)
    middle = answer.fit.grid_points.reshape(-1, 3).mean(axis=0)
    np.testing.assert_allclose([at.x, at.y, at.z], middle, atol=1e-9)
    unscaled, _ = answer_frame(frame(2), Config())
    assert not [topic for topic, _ in output_messages(unscaled, make_ros) if topic == "docking_pose"]


def test_the_panel_frame_stays_while_a_column_comes_into_view_and_the_status_says_since_when() -> None:
    config = Config(scale=ScaleConfig(column_pitch_m=0.045))
    panel, track, origins, since = scene(4, 6, 3, tilt_deg=20.0), None, [], []
    columns = np.array([panel.panel.buttons[k].column for k in panel.button])
    for tenth, hidden in ((1, 0), (2, -1), (3, -1), (90, -1)):
        stamp = tenth * 100_000_000
        centres = panel.centres_px[columns != hidden]
        given = Frame(image(stamp), camera_info(stamp), detections(stamp, centres))
        answer, track = answer_frame(given, config, (), NodeConfig(measure=False), track)
        assert answer.fit.ok and answer.fit.columns == (3 if hidden < 0 else 2)
        (pose,) = [m for topic, m in output_messages(answer, make_ros) if topic == "panel_pose"]
        at = pose.pose.pose.position
        origins.append([at.x, at.y, at.z])
        since.append(status(answer)["panel_frame_since"])
    # Noise-free: what is left is the fit's own tolerance.
    assert np.abs(np.array(origins[:3]) - origins[0]).max() < 1e-3
    # After a gap it begins anew, at the first column.
    assert 0.04 < np.linalg.norm(np.subtract(origins[3], origins[0])) < 0.06
    assert since == ["0.100000000"] * 3 + ["9.000000000"]
