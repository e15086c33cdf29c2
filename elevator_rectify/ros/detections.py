"""Detections as messages: boxes with labels and scores, or bare centres where vision_msgs is missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from elevator_rectify.core.types import Detection
from elevator_rectify.ros.messages import Make
from elevator_rectify.ros.poses import pose_of

_V = "vision_msgs/msg/"
_NO_TURN = (0.0, 0.0, 0.0, 1.0)


def boxes_message(detections: Sequence[Detection], header: Any, make: Make) -> Any:
    """Return a vision_msgs/Detection2DArray."""
    found = [_box(d, header, make) for d in detections]
    return make(_V + "Detection2DArray", header=header, detections=found)


def _box(detection: Detection, header: Any, make: Make) -> Any:
    position = make(_V + "Point2D", x=detection.x_px, y=detection.y_px)
    centre = make(_V + "Pose2D", position=position, theta=0.0)
    box = make(_V + "BoundingBox2D", center=centre, size_x=detection.width_px, size_y=detection.height_px)
    pose = make(
        "geometry_msgs/msg/PoseWithCovariance", pose=pose_of(np.zeros(3), _NO_TURN, make), covariance=np.zeros(36)
    )
    hypothesis = make(_V + "ObjectHypothesis", class_id=detection.label, score=detection.score)
    result = make(_V + "ObjectHypothesisWithPose", hypothesis=hypothesis, pose=pose)
    return make(_V + "Detection2D", header=header, results=[result], bbox=box, id="")


def centres_message(detections: Sequence[Detection], header: Any, make: Make) -> Any:
    """Return a geometry_msgs/PoseArray of the boxes' centres in pixels."""
    poses = [pose_of(np.array([d.x_px, d.y_px, 0.0]), _NO_TURN, make) for d in detections]
    return make("geometry_msgs/msg/PoseArray", header=header, poses=poses)
