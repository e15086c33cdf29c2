"""Input messages for the tests, as rclpy messages."""

from __future__ import annotations

from typing import Any

import numpy as np

from elevator_rectify.core import Camera
from elevator_rectify.core.types import Array, Image
from elevator_rectify.render.scene import paper_camera
from elevator_rectify.ros.messages import make_ros, ros_type
from elevator_rectify.ros.output import camera_info_message, image_message


def header(stamp_ns: int, frame: str = "camera") -> Any:
    time = make_ros("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return make_ros("std_msgs/msg/Header", stamp=time, frame_id=frame)


def image(stamp_ns: int = 0, picture: Image | None = None) -> Any:
    picture = np.zeros((480, 640, 3), np.uint8) if picture is None else picture
    return image_message(picture, header(stamp_ns), make_ros)


def camera_info(stamp_ns: int = 0, camera: Camera | None = None) -> Any:
    return camera_info_message(camera or paper_camera(), np.eye(3), header(stamp_ns), make_ros)


def detections(stamp_ns: int = 0, centres: Array | None = None) -> Any:
    message = make_ros("geometry_msgs/msg/PoseArray", header=header(stamp_ns), poses=[])
    for x, y in np.zeros((0, 2)) if centres is None else centres:
        pose = make_ros("geometry_msgs/msg/Pose")
        pose.position.x, pose.position.y = float(x), float(y)
        message.poses.append(pose)
    return message


def vision_detections(stamp_ns: int, centres: Array, labels: list[str]) -> Any:
    message = ros_type("vision_msgs/msg/Detection2DArray")(header=header(stamp_ns))
    for (x, y), label in zip(centres, labels, strict=True):
        item = ros_type("vision_msgs/msg/Detection2D")(header=header(stamp_ns))
        item.bbox.center.position.x, item.bbox.center.position.y = float(x), float(y)
        item.bbox.size_x = item.bbox.size_y = 20.0
        result = ros_type("vision_msgs/msg/ObjectHypothesisWithPose")()
        result.hypothesis.class_id, result.hypothesis.score = label, 0.9
        item.results.append(result)
        message.detections.append(item)
    return message
