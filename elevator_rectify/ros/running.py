"""Runs a node until it is interrupted, and lets it leave the graph in order."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

_SIGNAL_SECONDS = 0.1


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _refused(error: Exception) -> int:
    """Say in one line what is wrong with the command line, a parameter file or a QoS override."""
    print(f"elevator_rectify: {' '.join(str(error).split())}", file=sys.stderr)
    return 2


def run_node(make: Callable[[], Any], args: list[str] | None) -> int:
    """Run the node that `make` makes, with a method `close`; 0 on a clean end, 2 for wrong parameters."""
    # The handlers are ours, so that the node can still log and leave the graph when a signal comes.
    try:
        rclpy.init(args=args, signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    except RuntimeError as error:
        return _refused(error)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    try:
        node = make()
    except (ValueError, RuntimeError, rclpy.exceptions.ParameterException) as error:
        # A QoS override that is none is a RuntimeError of rclpy's.
        rclpy.try_shutdown()
        return _refused(error)
    except KeyboardInterrupt:
        # While it starts: the first time it compiles for some twenty seconds.
        rclpy.try_shutdown()
        return 0
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        # A wait without limit would keep the signal from Python until the next message.
        while rclpy.ok():
            try:
                executor.spin_once(timeout_sec=_SIGNAL_SECONDS)
            except (KeyboardInterrupt, ExternalShutdownException):
                raise
            except Exception as error:
                # A message that rclpy cannot deserialise, or a defect in a callback: neither may end the node.
                node.get_logger().error(f"internal error, message skipped: {error!r:.300}", throttle_duration_sec=5.0)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
        node.close()
        executor.shutdown(timeout_sec=0.2)
        rclpy.try_shutdown()
    return 0
