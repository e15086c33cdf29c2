"""Stands in for tf2_ros, which is not on PyPI: knows the way from the frame camera to the frame map.

Nothing is known of time 0. Its calls and what they refuse are those of the real one.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from rclpy.duration import Duration
from rclpy.time import Time

TRANSLATION, QUATERNION = (1.0, -2.0, 0.5), (0.5, -0.5, 0.5, 0.5)


class TransformException(Exception):
    """As the real one: of all that follow."""


class LookupException(TransformException):
    """There is no such frame."""


class ExtrapolationException(TransformException):
    """Nothing is known of that time."""


class Buffer:
    """Knows one transform."""

    def __init__(self) -> None:
        self.waited_ns: list[int] = []

    def lookup_transform(self, target: str, source: str, time: Time, timeout: Duration | None = None) -> Any:
        """Return an object like a TransformStamped."""
        if not isinstance(time, Time):
            raise TypeError(f"{time!r} is no Time")
        self.waited_ns.append(0 if timeout is None else timeout.nanoseconds)
        if (target, source) != ("map", "camera"):
            raise LookupException(f'"{target}" passed to lookupTransform argument target_frame does not exist')
        if time.nanoseconds < 1:
            raise ExtrapolationException("Lookup would require extrapolation into the past")
        at, turn = (
            SimpleNamespace(**dict(zip(names, numbers, strict=True)))
            for names, numbers in (("xyz", TRANSLATION), ("xyzw", QUATERNION))
        )
        return SimpleNamespace(transform=SimpleNamespace(translation=at, rotation=turn))


class TransformListener:
    """Would fill the buffer."""

    def __init__(self, buffer: Buffer, node: Any) -> None:
        self.buffer = buffer
