"""Camera and detection messages to values. Works on rclpy messages and on rosbags' alike."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.types import Detection
from elevator_rectify.ros.config import DEFAULT_NODE, DetectionsConfig
from elevator_rectify.ros.pictures import BadMessage

_LONGEST_LABEL = 32
# Fields of view that panels are looked at with, along the longer side.
_NARROWEST_DEG, _WIDEST_DEG = 10.0, 170.0
NUMBER_IDS = (
    "the detections' class ids are bare numbers, which may be labels or indices: set detections.numbers_are_labels, or "
    "detections.labels"
)
# Names that annotators give to buttons on which nothing can be read.
UNREAD = ("unknown", "blur", "empty", "-", "button")
# Scores of one detection's hypotheses that add up to more are no probabilities.
_MOST_IN_ALL = 1.02
_NUMBER = re.compile(r"[+-]?\d+")


def stamp_ns(header: Any) -> int:
    """Return a header's stamp in nanoseconds."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def output_stamp_ns(message: Any) -> int:
    """Return the stamp of the image that an output of the node belongs to; of a status it is the value `stamp`."""
    if hasattr(message, "markers"):
        return stamp_ns(message.markers[0].header)
    if hasattr(message, "header"):
        return stamp_ns(message.header)
    text = next((pair.value for pair in message.values if pair.key == "stamp"), "0.0")
    seconds, _, nanoseconds = text.partition(".")
    return int(seconds) * 10**9 + int(nanoseconds)


def camera_from_message(message: Any, topic: str = "camera_info", rectified: bool = False) -> Camera:
    """Return the camera of the image that belongs to a sensor_msgs/CameraInfo. Raises BadMessage.

    K, P, width and height are of the full sensor; the image is its region of interest (all of it where the region is
    0 x 0), binned (REP-104). rectified: the image is undistorted already and P is its camera.
    """
    matrix = np.array(message.p, dtype=float).reshape(3, 4)[:, :3] if rectified else np.array(message.k, dtype=float)
    distortion = np.zeros(0) if rectified else np.array(message.d)
    width, height, name = int(message.width), int(message.height), "p" if rectified else "k"
    if width <= 0 or height <= 0:
        raise BadMessage(topic, "width x height", f"{width} x {height}", "cannot be used: it must be positive")
    try:
        full = Camera.from_matrix(matrix, width, height, distortion, message.distortion_model)
    except ValueError as error:
        if "distortion_model" in str(error):
            model = repr(message.distortion_model)
            raise BadMessage(topic, "distortion_model", model, f"cannot be used: {error}") from error
        raise BadMessage(topic, name, matrix.ravel().tolist(), f"cannot be used: {error}") from error
    _check_plausible(full, topic, name)
    roi, binning = message.roi, np.maximum([message.binning_x, message.binning_y], 1)
    size = np.array([roi.width or full.width, roi.height or full.height])
    offset = np.array([roi.x_offset, roi.y_offset], dtype=float)
    if (offset + size > [full.width, full.height]).any() or (size < binning).any():
        region = (roi.x_offset, roi.y_offset, roi.width, roi.height)
        raise BadMessage(topic, "roi", region, f"is not inside {full.width} x {full.height} pixels")
    K = full.matrix.copy()
    K[:2, 2] -= offset
    K[:2] /= binning[:, None]
    width, height = (int(s) for s in size // binning)
    return Camera(K, width, height, full.distortion, full.model)


def _check_plausible(camera: Camera, topic: str, name: str) -> None:
    """Raise BadMessage for intrinsics that no camera has: those of another resolution, most often."""
    size = np.array([camera.width, camera.height])
    share = camera.matrix[:2, 2] / size
    if not ((share >= 0.25) & (share <= 0.75)).all():
        factor = float(np.median(2.0 * share))
        meaning = f"is not in the middle half of {size[0]} x {size[1]}: of another resolution (factor {factor:.2f})?"
        raise BadMessage(topic, f"{name}: principal point", camera.matrix[:2, 2].round(1).tolist(), meaning)
    if camera.model == "equidistant":
        return
    focal = camera.matrix[[0, 1], [0, 1]]
    view = np.rad2deg(2.0 * np.arctan2(size.max() / 2.0, focal))
    if not ((view > _NARROWEST_DEG) & (view < _WIDEST_DEG)).all():
        meaning = f"gives a field of view of {view.max():.0f} degrees: of another resolution, or not calibrated?"
        raise BadMessage(topic, f"{name}: focal lengths", focal.round(2).tolist(), meaning)


def detections_from_message(
    message: Any,
    config: DetectionsConfig = DEFAULT_NODE.detections,
    size: tuple[int, int] | None = None,
    topic: str = "detections",
) -> list[Detection]:
    """Return the detections of a PoseArray, a vision_msgs/Detection2DArray or a yolo_msgs/DetectionArray.

    PoseArray: position x, y is a box's centre in pixels. size: width and height of the image, to which boxes of a
    resized or letterboxed image (by the configuration) are moved and scaled. Raises BadMessage.
    """
    if hasattr(message, "poses"):
        found = [Detection(float(pose.position.x), float(pose.position.y)) for pose in message.poses]
    elif hasattr(message, "detections"):
        labels, ignored = class_labels(config.labels), ignored_classes(config.ignore)
        found = [_detection(item, labels, config.numbers_are_labels) for item in message.detections]
        found = [replace(d, label="") if d.label.lower() in UNREAD else d for d in found if not ignored(d.label)]
    else:
        raise BadMessage(topic, "type", type(message).__name__, "is no type of detections")
    x = size[0] / config.image_width_px if size and config.image_width_px else 1.0
    y = size[1] / config.image_height_px if size and config.image_height_px else 1.0
    left, above = config.offset_x_px, config.offset_y_px
    if (x, y, left, above) == (1.0, 1.0, 0.0, 0.0):
        return found
    return [
        replace(
            d,
            x_px=(d.x_px - left) * x,
            y_px=(d.y_px - above) * y,
            width_px=d.width_px * x,
            height_px=d.height_px * y,
        )
        for d in found
    ]


def class_labels(text: str) -> dict[str, str]:
    """Return {class id: label} of a text such as '0=B, 1=1'; ValueError where it is none."""
    labels = {}
    for pair in filter(None, (part.strip() for part in text.split(","))):
        number, separator, label = pair.partition("=")
        if not separator or not number.strip():
            raise ValueError(f"detections.labels: '{pair:.40}' is not of the form id=label")
        labels[number.strip()] = label.strip()
    return labels


@cache
def ignored_classes(text: str) -> Callable[[str], bool]:
    """Return what tells whether a class is one of a list such as 'led,text_*': no button. Case does not matter."""
    names = [fnmatch.translate(part) for part in (p.strip().lower() for p in text.split(",")) if part]
    pattern = re.compile("|".join(names)) if names else None
    return lambda name: pattern is not None and pattern.match(name.lower()) is not None


def has_number_ids(message: Any) -> bool:
    """Tell whether a message's classes are bare numbers, of which nobody can tell whether they are labels."""
    found = [_named(item)[:2] for item in getattr(message, "detections", ())]
    return any(name == number and _NUMBER.fullmatch(name) for name, number in found)


def _named(item: Any) -> tuple[str, str, float]:
    """Return the class name, the class id and the score of a detection's best hypothesis."""
    if not hasattr(item, "results"):
        return str(item.class_name), str(item.class_id), float(item.score)
    name, score = max(_hypotheses(item), key=lambda h: np.nan_to_num(h[1], nan=-1.0), default=("", 1.0))
    return name, name, score


def _hypotheses(item: Any) -> list[tuple[str, float]]:
    """Return class and score of a vision_msgs detection's hypotheses; Foxy's has them bare, and calls the class id."""
    given = [getattr(r, "hypothesis", r) for r in getattr(item, "results", ())]
    return [(str(h.class_id if hasattr(h, "class_id") else h.id), float(h.score)) for h in given]


def _detection(item: Any, labels: dict[str, str], numbers_are_labels: bool) -> Detection:
    """Return one vision_msgs or yolo_msgs detection."""
    box = item.bbox
    width, height = (box.size.x, box.size.y) if hasattr(box, "size") else (box.size_x, box.size_y)
    theta, centre = float(getattr(box.center, "theta", 0.0)), getattr(box.center, "position", box.center)
    cosine, sine = abs(np.cos(theta)), abs(np.sin(theta))
    name, number, score = _named(item)
    return Detection(
        float(centre.x),
        float(centre.y),
        float(width * cosine + height * sine),
        float(width * sine + height * cosine),
        _label(name, number, labels, numbers_are_labels),
        score,
        _readings(item, labels, numbers_are_labels),
    )


def _readings(item: Any, labels: dict[str, str], numbers_are_labels: bool) -> tuple[tuple[str, float], ...]:
    """Return the labels of several hypotheses with their scores, where these can be probabilities."""
    given = _hypotheses(item)
    if len(given) < 2:
        return ()
    found = [(_label(name, name, labels, numbers_are_labels), score) for name, score in given]
    found = [(label, p) for label, p in found if label and label.lower() not in UNREAD]
    probabilities = np.array([p for _, p in found])
    if not len(found) or not (probabilities >= 0.0).all() or probabilities.sum() > _MOST_IN_ALL:
        return ()
    return tuple(sorted(found, key=lambda item: -item[1]))


def _label(name: str, number: str, labels: dict[str, str], numbers_are_labels: bool) -> str:
    """Return the button's label: mapped, or the class's name; a bare index is none."""
    for key in (number, name):
        if key in labels:
            return labels[key]
    if name == number and _NUMBER.fullmatch(name) and not numbers_are_labels:
        return ""
    return "".join(c for c in name if c.isprintable()).strip()[:_LONGEST_LABEL]
