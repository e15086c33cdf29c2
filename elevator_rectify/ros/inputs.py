"""A frame's messages as values, or what is wrong with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from elevator_rectify.core.detector.follow import Found
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.types import Array, Detection, Image
from elevator_rectify.ros.config import NodeConfig
from elevator_rectify.ros.convert import camera_from_message, detections_from_message
from elevator_rectify.ros.pairing import Frame
from elevator_rectify.ros.pictures import BadMessage, check_image, depth_from_message, image_from_message


@dataclass(frozen=True)
class Inputs:
    """A frame's messages as values; image is None where no picture is wanted, depth a text where it is unusable."""

    image: Image | None
    camera: Camera
    detections: list[Detection]
    depth: Array | str | None
    found: Found | None = None


def inputs(frame: Frame, node: NodeConfig, with_picture: bool = True) -> Inputs:
    """Return the frame's messages as values. Raises BadMessage where they cannot be used together."""
    most = node.max_megapixels * 1_000_000
    image = image_from_message(frame.image, max_pixels=most) if with_picture else None
    size = check_image(frame.image) if image is None else (int(image.shape[0]), int(image.shape[1]))
    _check_size(frame.camera_info, size)
    camera = camera_from_message(frame.camera_info, rectified=node.image_is_rectified)
    ours, theirs = str(frame.image.header.frame_id), str(frame.camera_info.header.frame_id)
    nameless = not theirs and node.pairing.nameless_camera_info
    if ours != theirs and not nameless:
        way_out = "; see pairing.nameless_camera_info" if not theirs else ""
        raise BadMessage("camera_info", "header.frame_id", repr(theirs), f"is not the image's {ours!r}{way_out}")
    if size is not None and size != (camera.height, camera.width):
        text = f"{camera.width} x {camera.height}"
        raise BadMessage("camera_info", "width x height", text, f"is not the image's {size[1]} x {size[0]}")
    detections = []
    if frame.detections is not None:
        _check_frame("detections", frame.detections, ours)
        detections = detections_from_message(frame.detections, node.detections, (camera.width, camera.height))
    return Inputs(image, camera, detections, _depth(frame.depth, ours, node.use_depth))


def _check_size(info: Any, size: tuple[int, int] | None) -> None:
    """Raise BadMessage where a camera_info of the whole sensor is of another size than the image."""
    whole = not (info.roi.width or info.roi.height) and max(info.binning_x, info.binning_y) <= 1
    if size is not None and whole and size != (info.height, info.width):
        text = f"{info.width} x {info.height}"
        raise BadMessage("camera_info", "width x height", text, f"is not the image's {size[1]} x {size[0]}")


def _check_frame(topic: str, message: Any, ours: str) -> None:
    """Raise BadMessage for a message of another camera; a detector may leave the frame empty."""
    theirs = str(message.header.frame_id)
    if theirs and theirs != ours:
        raise BadMessage(topic, "header.frame_id", repr(theirs), f"is not the image's {ours!r}")


def _depth(message: Any, ours: str, wanted: bool) -> Array | str | None:
    """Return the depth in metres, or what is wrong with it: the orientation can be had without."""
    if message is None:
        return "no depth image has the image's stamp: see pairing.tolerance_s" if wanted else None
    try:
        _check_frame("depth", message, ours)
        return depth_from_message(message)
    except BadMessage as error:
        return str(error)
