"""The buttons of a fitted panel as a vision_msgs/Detection3DArray, and the pose of the one that is to be pressed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.types import Array, Button
from elevator_rectify.ros.messages import Make
from elevator_rectify.ros.poses import message_covariance, pose_of, quaternion

# What a lamp is called in a message, where it can be told.
_LAMP = {"yes": "lit", "no": "dark"}


def buttons_message(fit: GridFit, buttons: Sequence[Button], header: Any, make: Make) -> Any:
    """Return one Detection3D per button: pose at its cell or beside the grid, facing into the panel, label and score.

    id is "row,column", "row,column,inferred" for one without a detection, "beside,N" for detection N beside the grid,
    "beside,LABEL" for a taught button there that was not detected.
    results[0].hypothesis has the button's label as class_id; its score is the detector's where the label is as read,
    else the label's probability. Where it can be told, results[1].hypothesis has "lit" or "dark" as class_id, and the
    probability that the lamp is lit as score.
    """
    found = [_detection(fit, button, header, make) for button in buttons if button.state != "empty"]
    return make("vision_msgs/msg/Detection3DArray", header=header, detections=found)


def _detection(fit: GridFit, button: Button, header: Any, make: Make) -> Any:
    pose = pose_of(button.point, quaternion(fit.R_camera_panel), make)
    covariance = button_covariance(fit, button)
    hypothesis = make("vision_msgs/msg/ObjectHypothesis", class_id=button.label, score=_score(button))
    with_covariance = make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance.ravel())
    lamp = make("vision_msgs/msg/ObjectHypothesis", class_id=_LAMP.get(button.lit, ""), score=button.lit_probability)
    hypotheses = [hypothesis, *([lamp] if button.lit in _LAMP else [])]
    results = [make("vision_msgs/msg/ObjectHypothesisWithPose", hypothesis=h, pose=with_covariance) for h in hypotheses]
    size = make("geometry_msgs/msg/Vector3", x=float(button.size[0]), y=float(button.size[1]), z=0.0)
    box = make("vision_msgs/msg/BoundingBox3D", center=pose, size=size)
    return make("vision_msgs/msg/Detection3D", header=header, results=results, bbox=box, id=_id(button))


def button_covariance(fit: GridFit, button: Button) -> Array:
    """Return the (6, 6) covariance of a button's place and of its direction, as it is published."""
    covariance = message_covariance(fit, button.panel)
    if fit.metric:
        covariance[:3, :3] = button.covariance
    return covariance


def _id(button: Button) -> str:
    if button.row < 0:
        return f"beside,{button.detection if button.detection >= 0 else button.label}"
    return f"{button.row},{button.column}" + (",inferred" if button.state == "inferred" else "")


def _score(button: Button) -> float:
    as_read = button.state == "observed" and button.label_source in ("read", "")
    return float(button.score if as_read else min(button.probability, button.label_probability or 1.0))


def pressing_pose_message(fit: GridFit, point: Array, header: Any, make: Make) -> Any:
    """Return a PoseStamped at a point (3,) of the camera frame, z along the pressing direction, into the panel."""
    return make(
        "geometry_msgs/msg/PoseStamped", header=header, pose=pose_of(point, quaternion(fit.R_camera_panel), make)
    )
