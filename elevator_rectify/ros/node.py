"""The node: subscribes image, camera_info and detections, publishes the rectified view, the grid and the pose."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, qos_policy_name_from_kind

from elevator_rectify.core.compiled import COMPILED
from elevator_rectify.core.detector.follow import Found
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.reading.labels import aliases
from elevator_rectify.core.reading.target import Choice
from elevator_rectify.core.track import Track
from elevator_rectify.core.warm_up import warm_up
from elevator_rectify.ros.answer import Answer, answer_frame, chosen
from elevator_rectify.ros.camera_check import CameraCheck
from elevator_rectify.ros.confirming import ConfirmPress
from elevator_rectify.ros.convert import camera_from_message, class_labels, stamp_ns
from elevator_rectify.ros.finding import FindButton
from elevator_rectify.ros.frames import Frames, panel_frame
from elevator_rectify.ros.goals import action
from elevator_rectify.ros.hints import Hints, Silence
from elevator_rectify.ros.messages import installed, make_ros, ros_type
from elevator_rectify.ros.output import (
    BUTTONS,
    PICTURES,
    TARGET,
    TOPICS,
    diagnostics_message,
    output_messages,
    tf_message,
)
from elevator_rectify.ros.pairing import Frame, Pairing
from elevator_rectify.ros.parameters import changed, declare
from elevator_rectify.ros.poses import ros_header
from elevator_rectify.ros.running import run_node
from elevator_rectify.ros.serialized import make_published
from elevator_rectify.ros.statistics import Statistics
from elevator_rectify.ros.subscribe import (
    DetectionsSubscriber,
    compressed_topic,
    described,
    latched_qos,
    output_qos,
    overridable,
    subscribe,
)
from elevator_rectify.ros.waiting import Waiting

_DIAGNOSTICS_SECONDS, _WORKER_SECONDS = 1.0, 0.5
# A detector may be found so much later than the camera.
_OWN_AFTER_SECONDS = 2.0
# Views from other sides come no faster.
_CAMERA_CHECK_SECONDS = 0.2
_TF_DEPTH, _LONGEST_TARGET = 100, 100
_TF = "tf2_msgs/msg/TFMessage"


class ElevatorRectify(Node):
    """Transport around `answer_frame`: a worker thread computes, so that the subscriptions never wait."""

    def __init__(self, **options: Any) -> None:
        super().__init__("elevator_rectify", **options)
        self.node_config, self.config = declare(self)
        # What cannot be read ends the node here, not every frame.
        class_labels(self.node_config.detections.labels)
        aliases()
        if COMPILED:
            self.get_logger().info("numba is installed: loads the compiled kernels, compiles them once in some 20 s")
        warm_up(self.config, self.node_config.measure)
        self.add_on_set_parameters_callback(self._on_parameters)
        self.pairing = Pairing(self.node_config.pairing)
        self.statistics = Statistics()
        self._hints = Hints(self.node_config)
        self._target = ""
        self._found: Found | None = None
        self._camera_check, self._camera_checked = CameraCheck(), 0.0
        self._outputs = {topic: self._publisher(kind, f"~/{topic}") for topic, kind in self._topics().items()}
        self._diagnostics = self._publisher("diagnostic_msgs/msg/DiagnosticArray", "/diagnostics")
        self._tf = self._tf_publisher() if self.node_config.publish_tf else None
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        find, confirm = action("FindButton"), action("ConfirmPress")
        self._finding = FindButton(self, find, Frames(self), self._steady) if find else None
        self._confirming = ConfirmPress(self, confirm, self._steady) if confirm else None
        self._subscribe_target()
        self._begin()

    def _begin(self) -> None:
        """Begin with no track: subscribe, and let the worker compute."""
        self.pairing.needs_detections = self.node_config.detector != "own"
        self.pairing.needs_depth = self.node_config.use_depth
        self._started, self._had_detections = time.monotonic(), False
        self._track: tuple[int, Track | None] = (0, None)
        self._waiting = Waiting(self.node_config.max_waiting)
        self._subscribe_all()
        self._worker = threading.Thread(target=self._work, args=(self._waiting,), name="worker", daemon=True)
        self._worker.start()

    def _end(self) -> None:
        """Let nothing come any more, and the worker end."""
        self.destroy_timer(self._timer)
        self._detections.close()
        for subscription in self._streams:
            self.destroy_subscription(subscription)
        self._end_worker()
        # What waited is of no use later.
        self.pairing = Pairing(self.node_config.pairing)

    def _end_worker(self) -> None:
        self._waiting.close()
        self._worker.join(timeout=_WORKER_SECONDS)

    @staticmethod
    def _topics() -> dict[str, str]:
        return {**TOPICS, **TARGET, **({BUTTONS[0]: BUTTONS[1]} if installed(BUTTONS[1]) else {})}

    def _publisher(self, kind: str, topic: str, qos: QoSProfile | None = None) -> Any:
        """Create a publisher; a subscriber whose QoS does not match is logged."""

        def incompatible(event: Any) -> None:
            policy = qos_policy_name_from_kind(event.last_policy_kind)
            listeners = self.get_subscriptions_info_by_topic(publisher.topic_name)
            theirs = [described(info.qos_profile) for info in listeners]
            self.get_logger().error(
                f"{publisher.topic_name}: a subscriber asks for another {policy}. Ours: "
                f"{described(publisher.qos_profile)}; theirs: {'; '.join(theirs) or 'unknown'}"
            )

        publisher: Any = self.create_publisher(
            ros_type(kind),
            topic,
            qos or output_qos(),
            event_callbacks=PublisherEventCallbacks(incompatible_qos=incompatible),
            qos_overriding_options=overridable(),
        )
        return publisher

    def _tf_publisher(self) -> Any:
        if not installed(_TF):
            raise ValueError("publish_tf: the package tf2_msgs is not installed: sudo apt install ros-jazzy-tf2-msgs")
        return self._publisher(_TF, "/tf", QoSProfile(depth=_TF_DEPTH))

    def _subscribe_all(self) -> None:
        image = ("sensor_msgs/msg/Image", "image")
        if self.node_config.image_transport == "compressed":
            image = ("sensor_msgs/msg/CompressedImage", compressed_topic(self))
        streams = [(*image, self._add_image)]
        streams.append(("sensor_msgs/msg/CameraInfo", "camera_info", self.pairing.add_camera_info))
        if self.node_config.use_depth:
            streams.append(("sensor_msgs/msg/Image", "depth", self.pairing.add_depth))
        bad = self.pairing.add_unreadable
        self._streams = [subscribe(self, kind, topic, self._feeding(add), bad) for kind, topic, add in streams]
        kind, add = self.node_config.detections.type, self._feeding(self._add_detections)
        self._detections = DetectionsSubscriber(self, kind, add, bad, self._steady)
        topics = {"image": image[1], "camera_info": "camera_info"}
        if self.node_config.detector != "own":
            topics["detections"] = "detections"
        self._silence = Silence({name: self.resolve_topic_name(topic) for name, topic in topics.items()})
        self.get_logger().info(f"waiting for {', '.join(self._silence.names.values())}")
        self._timer = self.create_timer(_DIAGNOSTICS_SECONDS, self._diagnose, clock=self._steady)

    def _subscribe_target(self) -> None:
        # A target set before the node started is that of a latched publisher; each publisher matches one of the two,
        # and that it does not match the other is no news.
        quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
        for qos in (output_qos(), latched_qos()):
            string = ros_type("std_msgs/msg/String")
            self.create_subscription(string, "~/target", self._on_target, qos, event_callbacks=quiet)

    def _add_image(self, message: Any) -> list[Frame]:
        """Pair the image, or hand it to our own detector where nobody publishes detections."""
        if not self.pairing.needs_detections:
            self._choose_detector()
        return self.pairing.add_image(message)

    def _add_detections(self, message: Any) -> list[Frame]:
        """Pair the message; with `detector: auto` the first one shows that there is a detector."""
        if not self._had_detections:
            self._had_detections = True
            self._choose_detector()
        return self.pairing.add_detections(message)

    def _choose_detector(self) -> None:
        """With `detector: auto` our own detector serves while nobody publishes detections."""
        if self.node_config.detector != "auto":
            return
        young = time.monotonic() - self._started < _OWN_AFTER_SECONDS
        needed = self._had_detections or young or self.count_publishers(self.resolve_topic_name("detections")) > 0
        if needed != self.pairing.needs_detections:
            self.pairing.needs_detections = needed
            source = "the topic" if needed else "our own detector, nobody publishes them"
            self.get_logger().info(f"detections come from {source}")

    def _on_target(self, message: Any) -> None:
        """Select the button that is to be pressed, from the next frame on; an empty text selects none."""
        self._target = str(message.data)[:_LONGEST_TARGET]

    def _feeding(self, add: Callable[[Any], list[Frame]]) -> Callable[[Any], None]:
        """Return the callback that adds a message to the pairing and enqueues what became complete."""
        return lambda message: self._enqueue(add(message))

    def _enqueue(self, frames: list[Frame]) -> None:
        """Hand complete frames to the worker; when it is behind, the oldest waiting frame gives way."""
        for frame in frames:
            for late in self._waiting.put(frame):
                reason = "frames come faster than they are computed"
                skipped = GridFit(status="skipped", reason=reason, method=self.config.method)
                self._publish(Answer(late.image.header, skipped))

    def _work(self, waiting: Waiting) -> None:
        """Answer frames until the queue is closed."""
        while (frame := waiting.get()) is not None and self.context.ok():
            try:
                self._answer(frame)
            except Exception as error:
                # After shutdown the publishers are gone; anything else is a defect that must not stop the node.
                if self.context.ok():
                    self.statistics.add("internal error", repr(error), 0.0, -1.0)
                    self.get_logger().error(f"internal error, frame skipped: {error!r}")

    def _answer(self, frame: Frame) -> None:
        """Convert, compute, publish."""
        wanted = [picture for picture, topics in PICTURES.items() if any(self._listened(topic) for topic in topics)]
        jumps, track = self._track
        if jumps != self.pairing.jumps:
            jumps, track = self.pairing.jumps, None
        asked = any(goals is not None and goals.wanted for goals in (self._finding, self._confirming))
        if asked and self._confirming is not None:
            wanted.append("patches")
        if asked or any(self._listened(topic) for topic in ("buttons", "markers")):
            wanted.append("labels")
        # Frames that are to agree say each what it reads.
        if asked:
            wanted.append("reading")
        if self.node_config.measure and self._hints.placements.wanted:
            wanted.append("placement")
        answer, track = answer_frame(frame, self.config, wanted, self.node_config, track, self._target, self._found)
        self._found = answer.found
        depths, lost = self.pairing.received["depth"], self.pairing.lost_infos
        for hint in self._hints.of(answer, frame.detections, depths, lost):
            self.get_logger().warning(hint)
        self._track = jumps, track
        self._check_camera(answer, frame)
        if answer.fit.status == "contradicted" and self._hints.advice:
            answer = replace(answer, fit=replace(answer.fit, reason=f"{answer.fit.reason}; {self._hints.advice}"))
        self._publish(replace(answer, calibration=self._camera_check.found))
        if asked:
            self._answer_goals(answer, frame)

    def _answer_goals(self, answer: Answer, frame: Frame) -> None:
        """Let a frame answer what waits for it; what it finds is remembered for a press."""
        if self._confirming is not None:
            self._confirming.look(answer)
        found = self._finding.look(answer, partial(self._choose, answer, frame)) if self._finding is not None else []
        if self._confirming is not None:
            self._confirming.remember(found, answer)

    def _check_camera(self, answer: Answer, frame: Frame) -> None:
        """Let an accepted frame now and then say what it knows of the calibration."""
        if time.monotonic() - self._camera_checked < _CAMERA_CHECK_SECONDS:
            return
        self._camera_checked = time.monotonic()
        if answer.fit.ok:
            rectified = self.node_config.image_is_rectified
            self._camera_check.add(answer.fit, camera_from_message(frame.camera_info, rectified=rectified))
        if warning := self._camera_check.warning():
            self.get_logger().warning(warning)

    def _choose(self, answer: Answer, frame: Frame, label: str, max_lateral_std_m: float) -> Choice:
        """Return the button of a label in an answered frame."""
        target = self.config.target
        most = max_lateral_std_m or target.max_lateral_std_m
        config = replace(self.config, target=replace(target, max_lateral_std_m=most))
        return chosen(answer.fit, label, config, self.node_config, frame.detections, answer.hidden, answer.lit)

    def _publish(self, answer: Answer) -> None:
        """Publish what somebody listens to; the status comes last and includes the time of the others."""
        self._log(answer)
        for topic, message in output_messages(answer, make_published, self._listened):
            self._outputs[topic].publish(message)
            answer.stopwatch.lap("publish")
        if self._tf is not None and answer.fit.ok and answer.fit.metric:
            frame, header = panel_frame(self, self.node_config.panel_frame), ros_header(answer.header, make_ros)
            self._tf.publish(tf_message(answer, frame, header, make_ros))

    def _listened(self, topic: str) -> bool:
        return topic in self._outputs and bool(self._outputs[topic].get_subscription_count())

    def _log(self, answer: Answer) -> None:
        """Count the frame; of a refused one say why, at most every five seconds."""
        fit = answer.fit
        age_ms = 1e-6 * (self.get_clock().now().nanoseconds - stamp_ns(answer.header))
        self.statistics.add(fit.status, fit.reason, sum(answer.stopwatch.milliseconds.values()), age_ms)
        if not fit.ok:
            self.get_logger().warning(f"{fit.status}: {fit.reason}", throttle_duration_sec=5.0)

    def _diagnose(self) -> None:
        """Publish the counts, once a second."""
        values = self.statistics.values(self.pairing, _DIAGNOSTICS_SECONDS)
        values["detections type"] = self._detections.type if self._detections.published else "none published"
        values["calibration"] = self._camera_check.text
        self._choose_detector()
        silence = self._silence.look(self.pairing, self.statistics.frames, time.monotonic())
        if silence:
            self.get_logger().warning(silence)
        now = self.get_clock().now().to_msg()
        self._diagnostics.publish(diagnostics_message(self.get_fully_qualified_name(), values, now, make_ros))

    def _on_parameters(self, parameters: list[Parameter]) -> Any:
        self.config, result = changed(self.config, parameters)
        return result

    def close(self) -> None:
        """Stop the worker, say what was refused, leave the graph."""
        self._end_worker()
        for goals in (self._finding, self._confirming):
            if goals is not None:
                goals.close(self.executor)
        if self.context.ok():
            verdicts, dropped = dict(self.statistics.verdicts), dict(self.pairing.dropped)
            self.get_logger().info(f"answered or refused: {verdicts}, dropped: {dropped}")
        self.destroy_node()


def main(args: list[str] | None = None) -> int:
    """Run the node until it is interrupted; 0 on a clean end, 2 for wrong parameters."""
    return run_node(ElevatorRectify, args)


if __name__ == "__main__":
    sys.exit(main())
