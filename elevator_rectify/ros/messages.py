"""Makes messages by name, of rclpy's types in the live node and of rosbags' in a bag."""

from __future__ import annotations

import array
import importlib
from typing import Any, Protocol

import numpy as np


class Make(Protocol):
    """Makes one message: all fields are given, primitive arrays as ndarrays."""

    def __call__(self, name: str, /, **fields: Any) -> Any:
        """Return a message of the type `name`, such as 'std_msgs/msg/Header'."""


def ros_type(name: str) -> Any:
    """Import the class of a type name such as 'sensor_msgs/msg/Image'."""
    package, _, kind = name.partition("/msg/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


def installed(name: str) -> bool:
    """Tell whether the message package of a type name is installed here."""
    try:
        ros_type(name)
    except ImportError:
        return False
    return True


def make_ros(name: str, /, **fields: Any) -> Any:
    """Make an rclpy message.

    Bytes go through array.array: assigning an ndarray to Image.data checks every byte in Python.
    """
    for key, content in fields.items():
        if isinstance(content, np.ndarray):
            if content.dtype == np.uint8:
                data = array.array("B")
                data.frombytes(np.ascontiguousarray(content).data.cast("B"))
                fields[key] = data
            else:
                fields[key] = content.astype(float).tolist() if key == "d" else content
    return ros_type(name)(**fields)


class MakeRosbags:
    """Makes rosbags messages of a type store."""

    def __init__(self, typestore: Any) -> None:
        self._types = typestore.types

    def __call__(self, name: str, /, **fields: Any) -> Any:
        """Return a message; sequences and bytes must be ndarrays here."""
        for key, content in fields.items():
            if isinstance(content, np.ndarray) and content.dtype == np.uint8:
                fields[key] = np.ascontiguousarray(content).reshape(-1)
        if name == "diagnostic_msgs/msg/DiagnosticStatus":
            fields["level"] = fields["level"][0]
        return self._types[name](**fields)
