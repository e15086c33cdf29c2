"""Our own detector as a node, for those who compose: images in, detections out."""

from __future__ import annotations

import sys
import threading
from typing import Any

from rclpy.node import Node

from elevator_rectify.core.config import NetworkConfig, flatten, with_values
from elevator_rectify.core.detector.detect import detect_buttons
from elevator_rectify.core.reading.reader import labelled, read_boxes
from elevator_rectify.ros.config import DETECTION_TYPES
from elevator_rectify.ros.detections import boxes_message, centres_message
from elevator_rectify.ros.messages import installed, make_ros, ros_type
from elevator_rectify.ros.pictures import BadMessage, image_from_message
from elevator_rectify.ros.poses import ros_header
from elevator_rectify.ros.running import run_node
from elevator_rectify.ros.subscribe import compressed_topic, output_qos, subscribe


class ButtonDetector(Node):
    """Detects (and reads) the buttons of the newest image; images that come meanwhile are skipped."""

    def __init__(self, **options: Any) -> None:
        super().__init__("button_detector", **options)
        self._config = self._declared()
        self._read = bool(self.declare_parameter("read", True).value)
        compressed = self.declare_parameter("image_transport", "raw").value == "compressed"
        rich = DETECTION_TYPES["vision_msgs"]
        self._kind = rich if installed(rich) else DETECTION_TYPES["pose_array"]
        self._publisher = self.create_publisher(ros_type(self._kind), "detections", output_qos())
        kind, topic = ("CompressedImage", compressed_topic(self)) if compressed else ("Image", "image")
        subscribe(self, f"sensor_msgs/msg/{kind}", topic, self._take)
        self._newest: Any = None
        self._change, self._closed = threading.Condition(), False
        self._worker = threading.Thread(target=self._work, name="worker", daemon=True)
        self._worker.start()
        self.get_logger().info(f"waiting for {self.resolve_topic_name(topic)}; publishes {self._kind}")

    def _declared(self) -> NetworkConfig:
        """Declare the detector's parameters; ValueError for a value out of its range."""
        values = {
            name: self.declare_parameter(f"network.{name}", default).value
            for name, (_, default) in flatten(NetworkConfig()).items()
        }
        config: NetworkConfig = with_values(NetworkConfig(), values)
        return config

    def _take(self, message: Any) -> None:
        with self._change:
            self._newest = message
            self._change.notify()

    def _work(self) -> None:
        """Answer the newest image until closed; a bad one is logged, and never stops the node."""
        while True:
            with self._change:
                while self._newest is None and not self._closed:
                    self._change.wait()
                message, self._newest = self._newest, None
            if message is None:
                return
            try:
                self._answer(message)
            except BadMessage as error:
                self.get_logger().warning(str(error), throttle_duration_sec=5.0)
            except Exception as error:
                if self.context.ok():
                    self.get_logger().error(f"internal error, image skipped: {error!r}")

    def _answer(self, message: Any) -> None:
        image = image_from_message(message)
        found = tuple(detect_buttons(image, self._config))
        if self._read and self._kind == DETECTION_TYPES["vision_msgs"]:
            found = labelled(found, read_boxes(image, found))
        make = boxes_message if self._kind == DETECTION_TYPES["vision_msgs"] else centres_message
        self._publisher.publish(make(found, ros_header(message.header, make_ros), make_ros))

    def close(self) -> None:
        """Stop the worker and leave the graph."""
        with self._change:
            self._closed, self._newest = True, None
            self._change.notify_all()
        self._worker.join(timeout=0.5)
        self.destroy_node()


def main(args: list[str] | None = None) -> int:
    """Run the detector until it is interrupted; 0 on a clean end, 2 for wrong parameters."""
    return run_node(ButtonDetector, args)


if __name__ == "__main__":
    sys.exit(main())
