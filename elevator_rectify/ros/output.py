"""Values to messages: everything that is published for a frame, by topic."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from elevator_rectify.core.camera import Camera
from elevator_rectify.core.types import Array, GridFit, Image
from elevator_rectify.ros.answer import Answer
from elevator_rectify.ros.messages import Make

# Topic below the node's name: message type.
TOPICS = {
    "rectified/image": "sensor_msgs/msg/Image",
    "rectified/camera_info": "sensor_msgs/msg/CameraInfo",
    "grid_centers": "geometry_msgs/msg/PoseArray",
    "panel_pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "overlay": "sensor_msgs/msg/Image",
    "status": "diagnostic_msgs/msg/DiagnosticStatus",
}
# What the pictures of `answer_frame` serve.
PICTURES = {"rectified": ("rectified/image", "rectified/camera_info"), "overlay": ("overlay",)}


def output_messages(answer: Answer, make: Make) -> Iterator[tuple[str, Any]]:
    """Yield (topic below the node's name, message) for one answer; poses and view only where the fit is ok."""
    header = ros_header(answer.header, make)
    if answer.view is not None:
        yield "rectified/image", image_message(answer.view.image, header, make)
        yield (
            "rectified/camera_info",
            camera_info_message(answer.view.camera, answer.view.R_rectified_camera, header, make),
        )
    if answer.fit.ok:
        yield "grid_centers", grid_message(answer.fit, header, make)
        yield "panel_pose", pose_message(answer.fit, header, make)
    if answer.overlay is not None:
        yield "overlay", image_message(answer.overlay, header, make)
    yield "status", status_message(answer, make)


def ros_header(header: Any, make: Make) -> Any:
    """Return a std_msgs/Header of the same stamp and frame, in the types of `make`."""
    stamp = make("builtin_interfaces/msg/Time", sec=int(header.stamp.sec), nanosec=int(header.stamp.nanosec))
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=str(header.frame_id))


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


def quaternion(R: Array) -> tuple[float, float, float, float]:
    """Return (x, y, z, w) of a rotation matrix, w >= 0."""
    # The eigenvector of the largest eigenvalue (Bar-Itzhack 2000): well conditioned at every angle.
    skew = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    K = np.zeros((4, 4))
    K[:3, :3] = R + R.T - np.trace(R) * np.eye(3)
    K[:3, 3] = K[3, :3] = skew
    K[3, 3] = np.trace(R)
    q = np.linalg.eigh(K)[1][:, -1]
    x, y, z, w = (float(v) for v in (q if q[3] >= 0 else -q))
    return x, y, z, w


def _pose(t: Array, q: tuple[float, float, float, float], make: Make) -> Any:
    position = make("geometry_msgs/msg/Point", x=float(t[0]), y=float(t[1]), z=float(t[2]))
    orientation = make("geometry_msgs/msg/Quaternion", x=q[0], y=q[1], z=q[2], w=q[3])
    return make("geometry_msgs/msg/Pose", position=position, orientation=orientation)


def grid_message(fit: GridFit, header: Any, make: Make) -> Any:
    """Return all cells row by row in the camera frame, each facing into the panel."""
    q = quaternion(fit.R_camera_panel)
    poses = [_pose(point, q, make) for point in fit.grid_points.reshape(-1, 3)]
    return make("geometry_msgs/msg/PoseArray", header=header, poses=poses)


def pose_message(fit: GridFit, header: Any, make: Make) -> Any:
    """Return the panel's pose with its covariance."""
    pose = _pose(fit.t_camera_panel, quaternion(fit.R_camera_panel), make)
    with_covariance = make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=fit.covariance.ravel().copy())
    return make("geometry_msgs/msg/PoseWithCovarianceStamped", header=header, pose=with_covariance)


def status_message(answer: Answer, make: Make) -> Any:
    """Return the frame's verdict with its figures, all of them named."""
    fit = answer.fit
    level = b"\x00" if fit.ok else b"\x02" if fit.status == "bad_input" else b"\x01"
    values = {
        "stamp": f"{answer.header.stamp.sec}.{answer.header.stamp.nanosec:09d}",
        "status": fit.status,
        "method": fit.method,
        "confidence": f"{fit.confidence:.4f}",
        "unit": "m" if fit.metric else "column pitch",
        "detections": str(answer.detections),
        "inliers": str(fit.inliers),
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
