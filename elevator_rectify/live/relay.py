"""The yardstick of the latency table: a bare node that warps every image by a fixed homography and republishes it."""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import Any

import cv2
import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException

from elevator_rectify.ros.messages import make_ros, ros_type
from elevator_rectify.ros.output import image_message
from elevator_rectify.ros.pictures import image_from_message
from elevator_rectify.ros.subscribe import output_qos, sensor_qos

_H = np.array([[0.9, 0.1, 20.0], [-0.05, 1.1, 10.0], [1e-4, 2e-4, 1.0]])


def main(arguments: list[str] | None = None) -> int:
    """Relay `image` to `~/image` until interrupted."""
    rclpy.init(args=arguments)
    node = rclpy.create_node("relay")
    publisher = node.create_publisher(ros_type("sensor_msgs/msg/Image"), "~/image", output_qos())

    def relay(message: Any) -> None:
        picture = image_from_message(message)
        warped = cv2.warpPerspective(picture, _H, (picture.shape[1], picture.shape[0]))
        publisher.publish(image_message(warped, message.header, make_ros))

    node.create_subscription(ros_type("sensor_msgs/msg/Image"), "image", relay, sensor_qos())
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)
    node.destroy_node()
    rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
