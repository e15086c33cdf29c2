"""Detections of all three types; yolo_msgs by its fields, vision_msgs as the real messages where they are installed."""

from __future__ import annotations

from types import SimpleNamespace as Fields
from typing import Any

import numpy as np
import pytest

from elevator_rectify.ros.config import DetectionsConfig
from elevator_rectify.ros.convert import class_labels, detections_from_message
from elevator_rectify.ros.messages import installed, ros_type
from elevator_rectify.ros.pictures import BadMessage
from test.messages import vision_detections

BOX = "vision_msgs/msg/Detection2DArray"
needs_vision_msgs = pytest.mark.skipif(not installed(BOX), reason="vision_msgs is not installed: make test builds it")


def yolo(class_id: int, class_name: str, theta: float = 0.0) -> Any:
    position = Fields(x=10.0, y=20.0)
    box = Fields(center=Fields(position=position, theta=theta), size=Fields(x=8.0, y=4.0))
    return Fields(class_id=class_id, class_name=class_name, score=0.9, id="", bbox=box)


def test_yolo_boxes_labels_and_scores() -> None:
    (found,) = detections_from_message(Fields(detections=[yolo(3, "open")]))
    assert (found.x_px, found.y_px, found.width_px, found.height_px) == (10.0, 20.0, 8.0, 4.0)
    assert (found.label, found.score) == ("open", 0.9)


@pytest.mark.parametrize(
    ("class_id", "name", "config", "label"),
    [
        (7, "7", {}, ""),
        (7, "7", {"numbers_are_labels": True}, "7"),
        (7, "7", {"labels": "7=B1, 8=G"}, "B1"),
        (12, "7", {}, "7"),
        (12, "", {"labels": "12=open"}, "open"),
        (1, "a\tb\x00c" + 50 * "x", {}, ("abc" + 50 * "x")[:32]),
    ],
)
def test_a_bare_index_is_no_floor_unless_the_mapping_says_so(
    class_id: int, name: str, config: dict[str, Any], label: str
) -> None:
    (found,) = detections_from_message(Fields(detections=[yolo(class_id, name)]), DetectionsConfig(**config))
    assert found.label == label


def test_turned_boxes_and_boxes_of_a_resized_image() -> None:
    (found,) = detections_from_message(Fields(detections=[yolo(1, "", theta=np.pi / 2)]))
    assert (found.width_px, found.height_px) == pytest.approx((4.0, 8.0))
    config = DetectionsConfig(image_width_px=320, image_height_px=320)
    (found,) = detections_from_message(Fields(detections=[yolo(1, "")]), config, (640, 480))
    assert (found.x_px, found.y_px, found.width_px, found.height_px) == (20.0, 30.0, 16.0, 6.0)


def test_wrong_mappings_and_messages_are_named() -> None:
    with pytest.raises(ValueError, match="labels: 'open'"):
        class_labels("0=B, open")
    with pytest.raises(BadMessage, match="type"):
        detections_from_message(Fields(data="x"))


@needs_vision_msgs
def test_vision_msgs_take_the_best_hypothesis() -> None:
    message = vision_detections(0, np.array([[10.0, 20.0]]), ["7"])
    result = ros_type("vision_msgs/msg/ObjectHypothesisWithPose")()
    result.hypothesis.class_id, result.hypothesis.score = "open", 0.95
    message.detections[0].results.append(result)
    (found,) = detections_from_message(message)
    assert (found.x_px, found.y_px, found.label, found.score) == (10.0, 20.0, "open", 0.95)
    message.detections[0].results = []
    (found,) = detections_from_message(message)
    assert (found.label, found.score) == ("", 1.0)
