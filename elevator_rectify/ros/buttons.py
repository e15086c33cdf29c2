"""The buttons of a fitted panel as a vision_msgs/Detection3DArray, and the pose of the one that is to be pressed."""

from __future__ import annotations

from typing import Any

from elevator_rectify.core.types import Array, Button, GridFit
from elevator_rectify.ros.messages import Make
from elevator_rectify.ros.poses import message_covariance, pose_of, quaternion


def buttons_message(fit: GridFit, header: Any, make: Make) -> Any:
    """Return one Detection3D per detected button of the grid: pose at its cell, facing into the panel, label and score.

    id is "row,column"; results[0].hypothesis has the button's label as class_id and the detector's score.
    """
    found = [_detection(fit, button, header, make) for button in fit.buttons]
    return make("vision_msgs/msg/Detection3DArray", header=header, detections=found)


def _detection(fit: GridFit, button: Button, header: Any, make: Make) -> Any:
    pose = pose_of(button.point, quaternion(fit.R_camera_panel), make)
    covariance = message_covariance(fit, button.point - fit.t_camera_panel)
    hypothesis = make("vision_msgs/msg/ObjectHypothesis", class_id=button.label, score=float(button.score))
    with_covariance = make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance.ravel())
    result = make("vision_msgs/msg/ObjectHypothesisWithPose", hypothesis=hypothesis, pose=with_covariance)
    size = make("geometry_msgs/msg/Vector3", x=float(button.size[0]), y=float(button.size[1]), z=0.0)
    box = make("vision_msgs/msg/BoundingBox3D", center=pose, size=size)
    place = f"{button.row},{button.column}"
    return make("vision_msgs/msg/Detection3D", header=header, results=[result], bbox=box, id=place)


def pressing_pose_message(fit: GridFit, point: Array, header: Any, make: Make) -> Any:
    """Return a PoseStamped at a point (3,) of the camera frame, z along the pressing direction, into the panel."""
    return make(
        "geometry_msgs/msg/PoseStamped", header=header, pose=pose_of(point, quaternion(fit.R_camera_panel), make)
    )
