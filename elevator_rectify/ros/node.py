"""The node: subscribes image, camera_info and detections, publishes the rectified view, the grid and the pose."""

from __future__ import annotations

import queue
import signal
import sys
import threading
from collections import Counter
from types import FrameType
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from elevator_rectify.core.types import GridFit
from elevator_rectify.ros.answer import Answer, answer_frame
from elevator_rectify.ros.messages import make_ros, ros_type
from elevator_rectify.ros.output import PICTURES, TOPICS, output_messages
from elevator_rectify.ros.pairing import Frame, Pairing
from elevator_rectify.ros.parameters import changed, declare

# Frames that may wait while one is computed; beyond, the oldest gives way.
QUEUE_LENGTH = 8
_INPUT_DEPTH = 30
_SIGNAL_SECONDS = 0.1


def sensor_qos() -> QoSProfile:
    """Return a fresh SensorData-like profile: rclpy's global one is changed by QoS overrides."""
    return QoSProfile(depth=_INPUT_DEPTH, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)


def output_qos() -> QoSProfile:
    """Return the profile of the outputs: reliable, depth 1."""
    return QoSProfile(depth=1, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE)


class ElevatorRectify(Node):
    """Transport around `answer_frame`: a worker thread computes, so that the subscriptions never wait."""

    def __init__(self, **options: Any) -> None:
        super().__init__("elevator_rectify", **options)
        self.node_config, self.config = declare(self)
        self.add_on_set_parameters_callback(self._on_parameters)
        self._pairing = Pairing(self.node_config.pairing)
        self.refused: Counter[str] = Counter()
        self._frames: queue.Queue[Frame | None] = queue.Queue(QUEUE_LENGTH)
        self._outputs = {
            topic: self.create_publisher(
                ros_type(kind),
                f"~/{topic}",
                output_qos(),
                qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            )
            for topic, kind in TOPICS.items()
        }
        compressed = self.node_config.image_transport == "compressed"
        image = (
            ("sensor_msgs/msg/CompressedImage", "image/compressed")
            if compressed
            else ("sensor_msgs/msg/Image", "image")
        )
        self._subscribe(*image, self._pairing.add_image)
        self._subscribe("sensor_msgs/msg/CameraInfo", "camera_info", self._pairing.add_camera_info)
        self._subscribe("geometry_msgs/msg/PoseArray", "detections", self._pairing.add_detections)
        self._worker = threading.Thread(target=self._work, name="worker", daemon=True)
        self._worker.start()

    def _subscribe(self, kind: str, topic: str, add: Any) -> None:
        self.create_subscription(
            ros_type(kind),
            topic,
            lambda message: self._enqueue(add(message)),
            sensor_qos(),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def _enqueue(self, frames: list[Frame]) -> None:
        """Hand complete frames to the worker; when it is behind, the oldest waiting frame gives way."""
        for frame in frames:
            while True:
                try:
                    self._frames.put_nowait(frame)
                    break
                except queue.Full:
                    self._give_way()

    def _give_way(self) -> None:
        try:
            late = self._frames.get_nowait()
        except queue.Empty:
            return
        if late is not None:
            reason = "frames come faster than they are computed"
            answer = Answer(late.image.header, GridFit(status="skipped", reason=reason, method=self.config.method))
            self._publish(answer)

    def _work(self) -> None:
        """Answer frames until None comes."""
        while (frame := self._frames.get()) is not None and self.context.ok():
            try:
                self._answer(frame)
            except Exception as error:
                # After shutdown the publishers are gone; anything else is a defect that must not stop the node.
                if self.context.ok():
                    self.refused["internal error"] += 1
                    self.get_logger().error(f"internal error, frame skipped: {error!r}")

    def _answer(self, frame: Frame) -> None:
        """Convert, compute, publish."""
        wanted = [picture for picture, topics in PICTURES.items() if any(self._listened(topic) for topic in topics)]
        self._publish(answer_frame(frame, self.config, wanted))

    def _publish(self, answer: Answer) -> None:
        """Publish what somebody listens to; the status comes last and includes the time of the others."""
        self._log(answer)
        for topic, message in output_messages(answer, make_ros):
            if self._listened(topic):
                self._outputs[topic].publish(message)
            answer.stopwatch.lap("publish")

    def _listened(self, topic: str) -> bool:
        return bool(self._outputs[topic].get_subscription_count())

    def _log(self, answer: Answer) -> None:
        """Count a refused frame and say why, at most every five seconds."""
        if not answer.fit.ok:
            self.refused[answer.fit.status] += 1
            self.get_logger().warning(f"{answer.fit.status}: {answer.fit.reason}", throttle_duration_sec=5.0)

    def _on_parameters(self, parameters: list[Parameter]) -> Any:
        self.config, result = changed(self.config, parameters)
        return result

    def close(self) -> None:
        """Stop the worker, say what was refused, leave the graph."""
        while True:
            try:
                self._frames.put_nowait(None)
                break
            except queue.Full:
                self._give_way()
        self._worker.join(timeout=0.5)
        if self.context.ok():
            self.get_logger().info(f"refused: {dict(self.refused)}, dropped: {dict(self._pairing.dropped)}")
        self.destroy_node()


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def main(args: list[str] | None = None) -> int:
    """Run the node until it is interrupted; 0 on a clean end, 2 for wrong parameters."""
    # The handlers are ours, so that the node can still log and leave the graph when a signal comes.
    rclpy.init(args=args, signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    try:
        node = ElevatorRectify()
    except (ValueError, rclpy.exceptions.ParameterException) as error:
        print(f"elevator_rectify: {error}", file=sys.stderr)
        rclpy.try_shutdown()
        return 2
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        # A wait without limit would keep the signal from Python until the next message.
        while rclpy.ok():
            executor.spin_once(timeout_sec=_SIGNAL_SECONDS)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.close()
        executor.shutdown(timeout_sec=0.2)
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
