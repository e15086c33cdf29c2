"""Values to messages: everything that is published for a frame, by topic."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import cv2
import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.types import Array, Image
from elevator_rectify.ros.answer import Answer
from elevator_rectify.ros.buttons import buttons_message, pressing_pose_message
from elevator_rectify.ros.markers import marker_message
from elevator_rectify.ros.messages import Make
from elevator_rectify.ros.poses import message_covariance, pose_of, quaternion, ros_header, stamped_pose

Messages = Iterator[tuple[str, Any]]
# Topic below the node's name: message type.
TOPICS = {
    "rectified/image": "sensor_msgs/msg/Image",
    "rectified/image/compressed": "sensor_msgs/msg/CompressedImage",
    "rectified/camera_info": "sensor_msgs/msg/CameraInfo",
    "rectified/overlay": "sensor_msgs/msg/Image",
    "grid_centers": "geometry_msgs/msg/PoseArray",
    "panel_pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "docking_pose": "geometry_msgs/msg/PoseStamped",
    "markers": "visualization_msgs/msg/MarkerArray",
    "overlay": "sensor_msgs/msg/Image",
    "status": "diagnostic_msgs/msg/DiagnosticStatus",
}
# Only while a button is asked for.
TARGET = {"target_pose": "geometry_msgs/msg/PoseStamped", "standoff_pose": "geometry_msgs/msg/PoseStamped"}
# Where vision_msgs is installed.
BUTTONS = ("buttons", "vision_msgs/msg/Detection3DArray")
# What the pictures of `answer_frame` serve.
PICTURES = {
    "rectified": ("rectified/image", "rectified/image/compressed", "rectified/camera_info"),
    "overlay": ("overlay",),
    "rectified_overlay": ("rectified/overlay",),
}
_JPEG_QUALITY = 90


def output_messages(answer: Answer, make: Make, listened: Callable[[str], bool] = lambda _: True) -> Messages:
    """Yield (topic below the node's name, message) for one answer; poses and view only where the fit is ok.

    listened: tells whether somebody subscribes to a topic; for the others nothing is made.
    """
    header = ros_header(answer.header, make)
    fit, view = answer.fit, answer.view
    makers: dict[str, Callable[[], Any]] = {}
    if view is not None:
        makers["rectified/image"] = lambda: image_message(view.image, header, make)
        makers["rectified/image/compressed"] = lambda: compressed_message(view.image, header, make)
        makers["rectified/camera_info"] = lambda: camera_info_message(
            view.camera, view.R_rectified_camera, header, make
        )
    if fit.ok:
        makers["grid_centers"] = lambda: grid_message(fit, header, make)
        makers["panel_pose"] = lambda: pose_message(answer, header, make)
        if fit.metric:
            makers["docking_pose"] = lambda: docking_message(answer, header, make)
        makers |= _target_makers(answer, header, make)
        makers["buttons"] = lambda: buttons_message(fit, answer.buttons, header, make)
    for topic, picture in (("overlay", answer.overlay), ("rectified/overlay", answer.rectified_overlay)):
        if picture is not None:
            makers[topic] = partial(image_message, picture, header, make)
    makers["markers"] = lambda: marker_message(answer, header, make)
    makers["status"] = lambda: status_message(answer, make)
    for topic, maker in makers.items():
        if listened(topic):
            yield topic, maker()


def _target_makers(answer: Answer, header: Any, make: Make) -> dict[str, Callable[[], Any]]:
    """Return the makers of the poses of the button that is to be pressed, where it was found."""
    fit, choice = answer.fit, answer.choice
    if choice is None or choice.button is None:
        return {}
    point, before = choice.button.point, answer.standoff(choice.button)
    return {
        "target_pose": lambda: pressing_pose_message(fit, point, header, make),
        "standoff_pose": lambda: pressing_pose_message(fit, before, header, make),
    }


def image_message(image: Image, header: Any, make: Make) -> Any:
    """Return a bgr8 or mono8 Image."""
    channels = 1 if image.ndim == 2 else image.shape[2]
    return make(
        "sensor_msgs/msg/Image",
        header=header,
        height=int(image.shape[0]),
        width=int(image.shape[1]),
        encoding="mono8" if channels == 1 else "bgr8",
        is_bigendian=0,
        step=int(image.shape[1] * channels),
        data=image,
    )


def compressed_message(image: Image, header: Any, make: Make) -> Any:
    """Return a jpeg CompressedImage."""
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
    kind = "mono8; jpeg compressed mono8" if image.ndim == 2 else "bgr8; jpeg compressed bgr8"
    return make("sensor_msgs/msg/CompressedImage", header=header, format=kind, data=data.ravel())


def camera_info_message(camera: Camera, R_rectified_camera: Array, header: Any, make: Make) -> Any:
    """Return the exact CameraInfo of the rectified view; its rotation R takes input rays to the view's."""
    projection = np.column_stack([camera.matrix, np.zeros(3)])
    roi = make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return make(
        "sensor_msgs/msg/CameraInfo",
        header=header,
        height=camera.height,
        width=camera.width,
        distortion_model=camera.model,
        d=np.zeros(5),
        k=camera.matrix.ravel().copy(),
        r=R_rectified_camera.ravel().copy(),
        p=projection.ravel().copy(),
        binning_x=0,
        binning_y=0,
        roi=roi,
    )


def grid_message(fit: GridFit, header: Any, make: Make) -> Any:
    """Return all cells row by row in the camera frame, each facing into the panel."""
    q = quaternion(fit.R_camera_panel)
    poses = [pose_of(point, q, make) for point in fit.grid_points.reshape(-1, 3)]
    return make("geometry_msgs/msg/PoseArray", header=header, poses=poses)


def pose_message(answer: Answer, header: Any, make: Make) -> Any:
    """Return the panel's pose with its covariance; of unknown scale, the translation's is too large for any use."""
    fit, origin = answer.fit, answer.origin
    pose = pose_of(fit.point_at(origin), quaternion(fit.R_camera_panel), make)
    return stamped_pose(pose, message_covariance(fit, origin if origin.any() else None), header, make)


def docking_message(answer: Answer, header: Any, make: Make) -> Any:
    """Return the middle of the cells that the panel frame began with, as a PoseStamped with the axes of a tag: x to
    the right, y up, z out of the panel.

    With these axes opennav_docking's `detected_dock_pose` needs no other rotation than its default one.
    """
    R = answer.fit.R_camera_panel * [1.0, -1.0, -1.0]
    middle = answer.fit.point_at(answer.middle)
    return make("geometry_msgs/msg/PoseStamped", header=header, pose=pose_of(middle, quaternion(R), make))


def tf_message(answer: Answer, frame: str, header: Any, make: Make) -> Any:
    """Return the transform from the camera's optical frame to the panel's, as a tf2_msgs/TFMessage."""
    t, (x, y, z, w) = answer.fit.point_at(answer.origin), quaternion(answer.fit.R_camera_panel)
    transform = make(
        "geometry_msgs/msg/Transform",
        translation=make("geometry_msgs/msg/Vector3", x=float(t[0]), y=float(t[1]), z=float(t[2])),
        rotation=make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
    )
    stamped = make("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=frame, transform=transform)
    return make("tf2_msgs/msg/TFMessage", transforms=[stamped])


def _seconds(stamp_ns: int) -> str:
    """Return a stamp as seconds."""
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}"


def status_message(answer: Answer, make: Make) -> Any:
    """Return the frame's verdict with its figures, all of them named."""
    fit = answer.fit
    level = b"\x00" if fit.ok else b"\x02" if fit.status == "bad_input" else b"\x01"
    seen = 0 if fit.measurement is None else int(np.isfinite(fit.measurement.correlation).sum())
    values = {
        "stamp": f"{answer.header.stamp.sec}.{answer.header.stamp.nanosec:09d}",
        "status": fit.status,
        "method": fit.method,
        "confidence": f"{fit.confidence:.4f}",
        "unit": "m" if fit.metric else "column pitch",
        "scale": answer.scale,
        "panel_frame_since": _seconds(answer.panel_frame.since_ns) if answer.panel_frame is not None else "",
        "detections_from": answer.detections_from,
        "calibration": answer.calibration,
        "panel": "" if fit.known is None else fit.known.name,
        "target": answer.target,
        "target_status": "" if answer.choice is None else answer.choice.status,
        "target_reason": "" if answer.choice is None else answer.choice.reason,
        "detections": str(len(answer.detections)),
        "inliers": str(fit.inliers),
        "measured": str(seen),
        "residual_pitch": "" if fit.measurement is None else f"{fit.measurement.residual:.5f}",
        "rows": str(fit.rows),
        "columns": str(fit.columns),
        "rms_px": f"{fit.rms_px:.4f}",
        "cost_x1000": f"{fit.cost_x1000:.6f}",
        "iterations": str(fit.iterations),
        **{f"{stage}_ms": f"{ms:.3f}" for stage, ms in answer.stopwatch.milliseconds.items()},
    }
    pairs = [make("diagnostic_msgs/msg/KeyValue", key=key, value=text) for key, text in values.items()]
    return make(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=level,
        name="elevator_rectify",
        message=fit.status if fit.ok else f"{fit.status}: {fit.reason}",
        hardware_id=str(answer.header.frame_id),
        values=pairs,
    )


def diagnostics_message(name: str, values: dict[str, str], now: Any, make: Make) -> Any:
    """Return the DiagnosticArray of the node, by its last seconds: stale without frames, a warning if none is good."""
    frames, accepted = (int(values[name]) for name in ("recent frames", "recent frames accepted"))
    level, text = (b"\x00", "accepts frames") if accepted else (b"\x01", "no frame was accepted in the last seconds")
    if not frames:
        level, text = b"\x03", "no frame came in the last seconds"
    pairs = [make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()]
    status = make(
        "diagnostic_msgs/msg/DiagnosticStatus", level=level, name=name, message=text, hardware_id="", values=pairs
    )
    header = make("std_msgs/msg/Header", stamp=now, frame_id="")
    return make("diagnostic_msgs/msg/DiagnosticArray", header=header, status=[status])
