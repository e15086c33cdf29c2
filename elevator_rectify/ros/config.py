"""Configuration of the node itself; what concerns the mathematics is in core/config."""

from __future__ import annotations

from dataclasses import dataclass, field

from elevator_rectify.core.config import Checked, value
from elevator_rectify.ros.pictures import MAX_MEGAPIXELS

DETECTION_TYPES = {
    "pose_array": "geometry_msgs/msg/PoseArray",
    "vision_msgs": "vision_msgs/msg/Detection2DArray",
    "yolo_msgs": "yolo_msgs/msg/DetectionArray",
}


@dataclass(frozen=True)
class DetectionsConfig(Checked):
    """How the detections are to be read."""

    type: str = value(
        "auto", "type of the detections; auto: the one that is published", choices=("auto", *DETECTION_TYPES)
    )
    labels: str = value("", "labels of class ids, such as '0=B, 1=1, 2=open'")
    ignore: str = value(
        "led,display*,indicator*,*keyhole*,switch,speaker,text,text_*,other",
        "classes that are no buttons, with wildcards: their boxes are left out",
    )
    numbers_are_labels: bool = value(False, "a class id that is a bare number is the button's label, no index")
    image_width_px: int = value(0, "width of the image that boxes refer to; 0: the image's own", low=0, high=100000)
    image_height_px: int = value(0, "height of the image that boxes refer to; 0: the image's own", low=0, high=100000)
    offset_x_px: float = value(
        0.0, "taken from the boxes' x before they are scaled: the border of a letterbox", low=-1e5, high=1e5
    )
    offset_y_px: float = value(0.0, "taken from the boxes' y before they are scaled", low=-1e5, high=1e5)


@dataclass(frozen=True)
class PairingConfig(Checked):
    """Bounds of the buffers, and what belongs together."""

    max_images: int = value(60, "images that wait for their detections", low=1, high=10000)
    max_megabytes: int = value(256, "memory that waiting images may take", low=1, high=65536)
    max_detections: int = value(60, "detection messages that wait for their image", low=1, high=10000)
    tolerance_s: float = value(
        0.0, "largest difference of the stamps of detections and image; 0: equal", low=0.0, high=1.0
    )
    nameless_camera_info: bool = value(False, "a camera_info whose header has no frame_id is taken for the image's")
    jump_s: float = value(1.0, "an image older than the last by more clears the buffers", low=0.01, high=1000.0)


@dataclass(frozen=True)
class NodeConfig(Checked):
    """What concerns the node only; read when it starts."""

    image_transport: str = value("raw", "how images arrive", choices=("raw", "compressed"))
    max_megapixels: int = value(
        MAX_MEGAPIXELS, "compressed images that announce more are not decoded", low=1, high=1000
    )
    image_is_rectified: bool = value(False, "the image is rectified: camera_info's P is used instead of K and D")
    lamps: bool = value(True, "tell which lamps are lit, where buttons are asked for")
    measure: bool = value(True, "measure the buttons in the image: several times as accurate as the boxes alone")
    use_depth: bool = value(False, "subscribe to an aligned depth image for the metric scale")
    publish_tf: bool = value(False, "publish the panel's pose on /tf (needs tf2_msgs)")
    panel_frame: str = value("elevator_panel", "name of the panel's frame on /tf")
    detector: str = value(
        "auto",
        "where the detections are from: the topic, our own detector, or (auto) our own while nobody publishes any",
        choices=("auto", "topic", "own"),
    )
    read: bool = value(True, "labels by our own reader where the detections bring none")
    track: bool = value(True, "start from the fit of the frame before, and smooth by the covariances")
    autostart: bool = value(True, "lifecycle_node: go to the state active at the start")
    max_waiting: int = value(8, "frames that may wait; beyond, the oldest is skipped", low=1, high=100)
    detections: DetectionsConfig = field(default_factory=DetectionsConfig)
    pairing: PairingConfig = field(default_factory=PairingConfig)


DEFAULT_NODE = NodeConfig()
