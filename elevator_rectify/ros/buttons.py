"""The buttons of a fitted panel as a vision_msgs/Detection3DArray."""

from __future__ import annotations

from typing import Any

from elevator_rectify.core.types import Detection
from elevator_rectify.ros.answer import Answer
from elevator_rectify.ros.messages import Make
from elevator_rectify.ros.poses import message_covariance, pose_of, quaternion

# A button's diameter over the pitch, where its box has no size.
_USUAL_SHARE = 0.6


def buttons_message(answer: Answer, header: Any, make: Make) -> Any:
    """Return one Detection3D per detected button of the grid: pose at its cell, facing into the panel, label and score.

    id is "row,column"; results[0].hypothesis has the detector's label as class_id and its score.
    """
    fit = answer.fit
    on = [(d, row, column) for d, (row, column) in zip(answer.detections, fit.cells, strict=True) if row >= 0]
    found = [_button(answer, d, int(row), int(column), header, make) for d, row, column in on]
    return make("vision_msgs/msg/Detection3DArray", header=header, detections=found)


def _button(answer: Answer, detection: Detection, row: int, column: int, header: Any, make: Make) -> Any:
    fit, point = answer.fit, answer.fit.grid_points[row, column]
    pose = pose_of(point, quaternion(fit.R_camera_panel), make)
    covariance = message_covariance(fit, point - fit.t_camera_panel)
    width, height = _size(answer, detection, float(point[2]))
    hypothesis = make("vision_msgs/msg/ObjectHypothesis", class_id=detection.label, score=float(detection.score))
    with_covariance = make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance.ravel())
    result = make("vision_msgs/msg/ObjectHypothesisWithPose", hypothesis=hypothesis, pose=with_covariance)
    size = make("geometry_msgs/msg/Vector3", x=width, y=height, z=0.0)
    box = make("vision_msgs/msg/BoundingBox3D", center=pose, size=size)
    return make("vision_msgs/msg/Detection3D", header=header, results=[result], bbox=box, id=f"{row},{column}")


def _size(answer: Answer, detection: Detection, depth: float) -> tuple[float, float]:
    """Return roughly the button's width and height: its box at the button's depth, else a usual share of the pitch."""
    if answer.camera is None or detection.width_px <= 0 or detection.height_px <= 0:
        usual = _USUAL_SHARE * float(answer.fit.pitch.min())
        return usual, usual
    return detection.width_px * depth / answer.camera.focal_px, detection.height_px * depth / answer.camera.focal_px
