"""Makes a bag from a folder of pictures and a JSON of boxes, so that real photographs can be replayed.

JSON: {"NAME": {"boxes": [[xmin, ymin, xmax, ymax], ...], "labels": ["7", ...], "scores": [0.9, ...],
"focal_over_max_size": 0.9 or null}, ...}, for NAME.jpg, NAME.jpeg or NAME.png; labels, scores and focal length may be
left out.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.types import Detection
from elevator_rectify.progress import progress
from elevator_rectify.render.bag import FRAME, header_message
from elevator_rectify.ros.bag import BagWriter, bag_writer, make_bag_message
from elevator_rectify.ros.config import DETECTION_TYPES
from elevator_rectify.ros.detections import boxes_message, centres_message
from elevator_rectify.ros.output import camera_info_message

ASSUMED_FOCAL = 0.9
_PERIOD_NS = 1_000_000_000


def photograph_camera(size: Sequence[int], focal_over_max_size: float | None) -> Camera:
    """Return the camera of a photograph, of the usual focal length where it is unknown (None)."""
    width, height = size
    return Camera.centred(width, height, (focal_over_max_size or ASSUMED_FOCAL) * max(width, height))


def find_picture(folder: Path, name: str) -> Path | None:
    """Return the picture of this name."""
    endings = (".jpg", ".jpeg", ".png", ".JPG", ".JPEG", ".PNG")
    return next((p for ext in endings if (p := folder / f"{name}{ext}").exists()), None)


def write_photograph(bag: BagWriter, path: Path, entry: dict[str, Any], focal: float, time_ns: int) -> None:
    """Append one photograph with its camera and detections."""
    image = cv2.imread(str(path))
    if image is None:
        raise ValueError(f"{path} is no picture that OpenCV reads")
    header = header_message(time_ns, FRAME)
    _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 92])
    kind = "sensor_msgs/msg/CompressedImage"
    bag.write(
        "/camera/image/compressed",
        kind,
        make_bag_message(kind, header=header, format="jpeg", data=jpeg.ravel()),
        time_ns,
    )
    camera = photograph_camera((image.shape[1], image.shape[0]), focal)
    info = camera_info_message(camera, np.eye(3), header, make_bag_message)
    bag.write("/camera/camera_info", "sensor_msgs/msg/CameraInfo", info, time_ns + 1)
    found = labelled_boxes(entry)
    kind = DETECTION_TYPES["pose_array"]
    bag.write("/detections", kind, centres_message(found, header, make_bag_message), time_ns + 2)
    kind = DETECTION_TYPES["vision_msgs"]
    bag.write("/detections_labelled", kind, boxes_message(found, header, make_bag_message), time_ns + 3)
    bag.write("/camera/file_name", "std_msgs/msg/Header", header_message(time_ns, path.name), time_ns + 4)


def labelled_boxes(entry: dict[str, Any]) -> list[Detection]:
    """Return the entry's boxes with their labels and scores, as far as it has them."""
    boxes = np.array(entry["boxes"], dtype=float).reshape(-1, 4)
    labels, scores = entry.get("labels") or [""] * len(boxes), entry.get("scores") or [1.0] * len(boxes)
    return [
        Detection(float(a + c) / 2.0, float(b + d) / 2.0, float(c - a), float(d - b), str(label or ""), float(score))
        for (a, b, c, d), label, score in zip(boxes, labels, scores, strict=True)
    ]


def checked(name: str, entry: Any) -> dict[str, Any]:
    """Return the entry of one picture. Raises ValueError where a box is none, or labels and boxes differ in number."""
    try:
        boxes = np.array(entry["boxes"], dtype=float).reshape(-1, 4)
    except (TypeError, ValueError, KeyError) as error:
        raise ValueError(f"{name}: boxes must be a list of [xmin, ymin, xmax, ymax]") from error
    bad = ~(np.isfinite(boxes).all(axis=1) & (boxes[:, 2:] > boxes[:, :2]).all(axis=1))
    if bad.any():
        first = int(bad.argmax())
        raise ValueError(f"{name}: box {first} is {boxes[first].tolist()}, not [xmin, ymin, xmax, ymax]")
    for key in ("labels", "scores"):
        if entry.get(key) and len(entry[key]) != len(boxes):
            raise ValueError(f"{name}: {len(entry[key])} {key} for {len(boxes)} boxes")
    return dict(entry)


def make_bag(folder: Path, boxes: Path, output: Path, focal: float | None) -> list[str]:
    """Write the bag; return warnings (assumed focal lengths, missing pictures). Raises ValueError for a bad JSON."""
    try:
        entries = json.loads(boxes.read_text())
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{boxes}: {error}") from error
    if not isinstance(entries, dict):
        raise ValueError(f"{boxes}: an object of pictures by name is expected")
    entries = {name: checked(name, entry) if "boxes" in entry else entry for name, entry in entries.items()}
    warnings = []
    with bag_writer(output) as bag:
        for number, (name, entry) in enumerate(progress(sorted(entries.items()), "photographs")):
            path = find_picture(folder, name)
            if path is None or "boxes" not in entry:
                warnings.append(f"{name}: no picture or no boxes, left out")
                continue
            known = focal or entry.get("focal_over_max_size")
            if known is None:
                warnings.append(
                    f"{name}: focal length unknown, assumed {ASSUMED_FOCAL} x the longer side; if wrong, angles are off"
                )
            write_photograph(bag, path, entry, known or ASSUMED_FOCAL, (number + 1) * _PERIOD_NS)
    return warnings


def main(arguments: list[str] | None = None) -> int:
    """Command line: pictures and boxes to a bag."""
    parser = argparse.ArgumentParser(
        prog="make_bag", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("pictures", type=Path, help="folder of the pictures")
    parser.add_argument("boxes", type=Path, help="JSON file")
    parser.add_argument("bag", type=Path, help="folder to write")
    parser.add_argument("--focal", type=float, help="focal length over the picture's longer side, for all pictures")
    options = parser.parse_args(arguments)
    try:
        for warning in make_bag(options.pictures, options.boxes, options.bag, options.focal):
            print(f"warning: {warning}", file=sys.stderr)
    except ValueError as error:
        print(f"make_bag: {error}", file=sys.stderr)
        return 2
    print(f"wrote {options.bag}")
    return 0
