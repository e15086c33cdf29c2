"""Subscriptions that say why nothing comes: QoS that does not match, types that are not known or not installed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
    qos_policy_name_from_kind,
)
from rclpy.qos_overriding_options import QoSOverridingOptions

from elevator_rectify.ros.config import DETECTION_TYPES
from elevator_rectify.ros.messages import ros_type
from elevator_rectify.ros.serialized import read_header, read_image

_INPUT_DEPTH = 30
_LOOK_SECONDS = 0.5
_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")


def sensor_qos() -> QoSProfile:
    """Return a fresh SensorData-like profile: rclpy's global one is changed by QoS overrides."""
    return QoSProfile(depth=_INPUT_DEPTH, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)


def output_qos() -> QoSProfile:
    """Return the profile of the outputs: reliable, depth 1."""
    return QoSProfile(depth=1, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE)


def latched_qos() -> QoSProfile:
    """Return the profile that receives what was published before the node started, of latched publishers only."""
    return QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def compressed_topic(node: Node) -> str:
    """Return the name of the compressed image: the remapped one, or the remapped image's with /compressed behind it."""
    name = "image/compressed"
    remapped = node.resolve_topic_name(name) != node.resolve_topic_name(name, only_expand=True)
    return name if remapped else node.resolve_topic_name("image") + "/compressed"


def overridable() -> QoSOverridingOptions:
    """Let the standard qos_overrides parameters change history, depth, reliability and durability."""
    kinds = QoSPolicyKind
    return QoSOverridingOptions([kinds.HISTORY, kinds.DEPTH, kinds.RELIABILITY, kinds.DURABILITY])


def described(qos: QoSProfile) -> str:
    """Return the settings that two sides must agree on."""
    return f"reliability {qos.reliability.name}, durability {qos.durability.name}"


def subscribe(
    node: Node, kind: str, topic: str, add: Callable[[Any], None], bad: Callable[[str], None] = lambda topic: None
) -> Any:
    """Subscribe; a publisher whose QoS does not match is logged with both sides' settings.

    bad: counts a message that cannot be read.
    """

    def incompatible(event: Any) -> None:
        # The other node's name is often not known yet when the event comes.
        theirs = [described(info.qos_profile) for info in node.get_publishers_info_by_topic(name)]
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        node.get_logger().error(
            f"{topic}: nothing will come from a publisher whose {policy} does not match. Ours: "
            f"{described(subscription.qos_profile)}; theirs: {'; '.join(theirs) or 'unknown'}. "
            f"Set qos_overrides.{name}.subscription.* to match"
        )

    def received(data: bytes) -> None:
        handle(data)
        # An executor's turn costs more than a message: what has come meanwhile is taken with it.
        for _ in range(_INPUT_DEPTH - 1):
            with subscription.handle:
                taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
            if taken is None:
                return
            handle(taken[0])

    def handle(data: bytes) -> None:
        try:
            message = read(kind, data)
        except Exception as error:
            # Whatever is wrong with the bytes, and with whichever reader: one message, never the node.
            node.get_logger().error(f"{name}: not a {kind}: {error!r:.200}", throttle_duration_sec=5.0)
            bad(topic.split("/")[0])
            return
        add(message)

    name = node.resolve_topic_name(topic)
    read = read_image if kind in _IMAGES else read_header
    serialised = kind in _IMAGES or kind in DETECTION_TYPES.values()
    subscription: Any = node.create_subscription(
        ros_type(kind),
        topic,
        received if serialised else add,
        sensor_qos(),
        raw=serialised,
        event_callbacks=SubscriptionEventCallbacks(incompatible_qos=incompatible),
        qos_overriding_options=overridable(),
    )
    return subscription


class DetectionsSubscriber:
    """Subscribes the detections by the configured type, or ('auto') by the one that is published, now or later."""

    def __init__(
        self, node: Node, kind: str, add: Callable[[Any], None], bad: Callable[[str], None], clock: Any
    ) -> None:
        self._node, self._add, self._bad = node, add, bad
        self._topic = "detections"
        self._name = node.resolve_topic_name(self._topic)
        self._wanted = None if kind == "auto" else DETECTION_TYPES[kind]
        self.type = ""
        self._subscription: Any = None
        self._said = ""
        self.published = False
        if self._wanted is None:
            # Until a detector shows its type: `ros2 node info` lists the topic from the start.
            self._subscribe(DETECTION_TYPES["pose_array"])
        self._look()
        self._timer = node.create_timer(_LOOK_SECONDS, self._look, clock=clock)

    def close(self) -> None:
        """Subscribe no more."""
        self._node.destroy_timer(self._timer)
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)

    def _look(self) -> None:
        """Subscribe to the published type; when a detector of another type takes over, follow it."""
        published = [i.topic_type for i in self._node.get_publishers_info_by_topic(self._name)]
        self.published = self.type in published
        if self._wanted is not None:
            self._subscribe(self._wanted)
        elif self.type not in published:
            known = [kind for kind in published if kind in DETECTION_TYPES.values()]
            self.published = bool(known)
            if known:
                self._subscribe(known[0])
            elif published:
                self._say(f"{published[0]} is published, which is none of {', '.join(DETECTION_TYPES.values())}")

    def _subscribe(self, kind: str) -> None:
        if kind == self.type:
            return
        package = kind.split("/")[0]
        try:
            ros_type(kind)
        except ImportError:
            self._say(f"{kind} needs the package {package}: sudo apt install ros-jazzy-{package.replace('_', '-')}")
            return
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        self._subscription = subscribe(self._node, kind, self._topic, self._add, self._bad)
        self.type = kind
        self._node.get_logger().info(f"{self._name}: {kind}")

    def _say(self, text: str) -> None:
        """Log a problem once."""
        if text != self._said:
            self._said = text
            self._node.get_logger().error(f"{self._name}: {text}")
