"""Renders a bag in the manner of the paper's experiment: five elevators, five looks at each, with the truth."""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from elevator_rectify.arguments import count
from elevator_rectify.core.types import Array, Image
from elevator_rectify.progress import progress
from elevator_rectify.render.panel import Panel, paper_panels
from elevator_rectify.render.photograph import photograph
from elevator_rectify.render.scene import DetectorModel, Scene, Viewpoint, make_scene, paper_camera
from elevator_rectify.ros.bag import BagWriter, bag_writer, make_bag_message
from elevator_rectify.ros.output import camera_info_message
from elevator_rectify.ros.poses import quaternion

DETECTOR = DetectorModel(sigma_px=1.0, missed=0.04, false=0.04)
MAX_TILT_RAD = np.deg2rad(50.0)
FRAME = "camera_optical_frame"
_PERIOD_NS = 500_000_000
_START_NS = 1_577_000_000_000_000_000
_DETECTOR_DELAY_NS = 120_000_000
_JPEG_QUALITY = 92


@dataclass(frozen=True)
class Shot:
    """A scene, its picture, and which elevator it shows."""

    elevator: int
    scene: Scene
    image: Image


def make_shot(panels: tuple[Panel, ...], number: int, views: int, seed: int) -> Shot:
    """Render look `number`: elevator by elevator, tilts spread from 0 to 50 degrees over a panel's views."""
    rng = np.random.default_rng([seed, number])
    elevator, view = divmod(number, views)
    tilt = MAX_TILT_RAD * (view + rng.uniform(0.0, 0.9)) / views
    point = Viewpoint(
        tilt_rad=tilt,
        tilt_axis_rad=rng.uniform(0, 2 * np.pi),
        roll_rad=np.deg2rad(rng.uniform(-6.0, 6.0)),
        fill=rng.uniform(0.62, 0.8),
        offset=(rng.uniform(-0.06, 0.06), rng.uniform(-0.03, 0.03)),
    )
    scene = make_scene(panels[elevator % len(panels)], paper_camera(), point, DETECTOR, rng)
    return Shot(elevator, scene, photograph(scene, rng))


def write_shot(bag: BagWriter, shot: Shot, time_ns: int) -> None:
    """Append picture, camera info, detections and truth, all of one stamp; the detector answers later."""
    make, header = make_bag_message, header_message(time_ns, FRAME)
    _, jpeg = cv2.imencode(".jpg", shot.image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    kind = "sensor_msgs/msg/CompressedImage"
    bag.write("/camera/image/compressed", kind, make(kind, header=header, format="jpeg", data=jpeg.ravel()), time_ns)
    info = camera_info_message(shot.scene.camera, np.eye(3), header, make)
    bag.write("/camera/camera_info", "sensor_msgs/msg/CameraInfo", info, time_ns + 1)
    kind = "geometry_msgs/msg/PoseStamped"
    pose = pose_message(shot.scene.t_camera_panel, shot.scene.R_camera_panel)
    bag.write("/truth/panel_pose", kind, make(kind, header=header, pose=pose), time_ns + 2)
    kind = "geometry_msgs/msg/PoseArray"
    points = pose_array(shot.scene.panel.points_m, header)
    bag.write("/truth/buttons", kind, points, time_ns + 3)
    cells = np.column_stack([shot.scene.panel.cells[:, ::-1], shot.scene.panel.blocks]).astype(float)
    bag.write(
        "/truth/cells", kind, pose_array(cells, header_message(time_ns, f"elevator_{shot.elevator + 1}")), time_ns + 4
    )
    labels = ",".join(button.label for button in shot.scene.panel.buttons)
    bag.write("/truth/labels", "std_msgs/msg/Header", header_message(time_ns, labels), time_ns + 5)
    boxes = np.column_stack([shot.scene.centres_px, np.zeros(len(shot.scene.detections))])
    bag.write("/detections", kind, pose_array(boxes, header), time_ns + _DETECTOR_DELAY_NS)


def header_message(time_ns: int, frame: str) -> Any:
    """Return a std_msgs/Header."""
    stamp = make_bag_message("builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    return make_bag_message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def pose_message(t: Array, R: Array) -> Any:
    """Return a geometry_msgs/Pose."""
    x, y, z, w = quaternion(R)
    position = make_bag_message("geometry_msgs/msg/Point", x=float(t[0]), y=float(t[1]), z=float(t[2]))
    orientation = make_bag_message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
    return make_bag_message("geometry_msgs/msg/Pose", position=position, orientation=orientation)


def pose_array(points: Array, header: Any) -> Any:
    """Return a PoseArray of positions (N, 3) with identity orientations."""
    poses = [pose_message(point, np.eye(3)) for point in points]
    return make_bag_message("geometry_msgs/msg/PoseArray", header=header, poses=poses)


def render_bag(path: Path, elevators: int, views: int, seed: int) -> None:
    """Write the whole bag; the same arguments give the same bytes."""
    panels = paper_panels()
    with bag_writer(path) as bag:
        for number in progress(range(elevators * views), "rendering"):
            write_shot(bag, make_shot(panels, number, views, seed), _START_NS + number * _PERIOD_NS)


def main(arguments: list[str] | None = None) -> int:
    """Command line: render a bag."""
    parser = argparse.ArgumentParser(prog="render", description=__doc__)
    parser.add_argument("bag", type=Path, help="folder to write")
    parser.add_argument("--elevators", type=count, default=5, help="elevators that are shown")
    parser.add_argument("--views", type=count, default=5, help="pictures of each elevator")
    parser.add_argument("--seed", type=int, default=1, help="the same seed gives the same bytes")
    options = parser.parse_args(arguments)
    try:
        render_bag(options.bag, options.elevators, options.views, options.seed)
    except ValueError as error:
        print(f"render: {error}", file=sys.stderr)
        return 2
    print(f"wrote {options.bag}")
    return 0
