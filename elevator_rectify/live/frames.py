"""Endless input for a live node: the pictures of a bag, held for a while each, with fresh noise on the detections."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.types import Array, Image
from elevator_rectify.recordings.topics import find_topics
from elevator_rectify.ros.bag import read_bag
from elevator_rectify.ros.convert import camera_from_message, detections_from_message
from elevator_rectify.ros.messages import make_ros
from elevator_rectify.ros.output import camera_info_message, image_message
from elevator_rectify.ros.pictures import image_from_message

# A robot looks at one panel for some seconds.
_HELD_FRAMES = 60
_NOISE_PX = 0.3
FRAME_ID = "camera"


@dataclass(frozen=True)
class View:
    """One look at a panel: the picture, its camera, the detected centres (N, 2)."""

    picture: Image
    camera: Camera
    centres_px: Array


def views(bag: Path, width: int, height: int) -> list[View]:
    """Return the bag's pictures, enlarged to width x height with their cameras and detections."""
    topics, parts = find_topics(bag, {}), dict[int, dict[str, Any]]()
    for record in read_bag(bag, {topics.image, topics.camera_info, topics.detections}):
        stamp = record.message.header.stamp
        parts.setdefault(stamp.sec * 10**9 + stamp.nanosec, {})[record.topic] = record.message
    found = []
    for part in parts.values():
        picture = image_from_message(part[topics.image])
        camera = camera_from_message(part[topics.camera_info])
        size = np.array([width / picture.shape[1], height / picture.shape[0]])
        K = camera.matrix * np.append(size, 1.0)[:, None]
        centres = np.array([[d.x_px, d.y_px] for d in detections_from_message(part[topics.detections])])
        large = Camera(K, width, height, camera.distortion, camera.model)
        found.append(View(cv2.resize(picture, (width, height)), large, centres * size))
    return found


class Frames:
    """Makes the messages of frame after frame, with the stamps that are asked for."""

    def __init__(self, bag: Path, width: int = 640, height: int = 480, seed: int = 0) -> None:
        self.views = views(bag, width, height)
        self._rng = np.random.default_rng(seed)
        self._images = [image_message(view.picture, header(0), make_ros) for view in self.views]

    def view(self, number: int) -> View:
        """Return the view of frame `number`."""
        return self.views[(number // _HELD_FRAMES) % len(self.views)]

    def messages(self, number: int, stamp_ns: int) -> dict[str, Any]:
        """Return image, camera_info and detections of frame `number`."""
        head, view = header(stamp_ns), self.view(number)
        image = copy.copy(self._images[(number // _HELD_FRAMES) % len(self.views)])
        image.header = head
        noise = self._rng.normal(0.0, _NOISE_PX, view.centres_px.shape)
        return {
            "camera_info": camera_info_message(view.camera, np.eye(3), head, make_ros),
            "image": image,
            "detections": detections_message(view.centres_px + noise, head),
        }


def header(stamp_ns: int, frame_id: str = FRAME_ID) -> Any:
    """Return a std_msgs/Header."""
    stamp = make_ros("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return make_ros("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def detections_message(centres_px: Array, head: Any) -> Any:
    """Return a PoseArray of box centres."""
    message = make_ros("geometry_msgs/msg/PoseArray", header=head, poses=[])
    for x, y in centres_px:
        pose = make_ros("geometry_msgs/msg/Pose")
        pose.position.x, pose.position.y = float(x), float(y)
        message.poses.append(pose)
    return message
