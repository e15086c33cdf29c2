"""What a user should be told and would otherwise have to guess: why nothing comes, and which parameter is missing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from elevator_rectify.ros.answer import Answer
from elevator_rectify.ros.config import NodeConfig
from elevator_rectify.ros.convert import NUMBER_IDS, has_number_ids
from elevator_rectify.ros.pairing import Pairing

# After so long without a frame the reason is told, and again after so long while it lasts.
_SILENT_SECONDS, _AGAIN_SECONDS = 5.0, 30.0


@dataclass
class Silence:
    """Watches whether frames become complete, and says once in a while what is missing."""

    names: Mapping[str, str]
    _frames: int = 0
    _since: float | None = None
    _said: float | None = None
    _received: dict[str, int] = field(default_factory=dict)

    def look(self, pairing: Pairing, frames: int, now: float) -> str:
        """Return what to log now, '' for nothing. frames: answered so far; now: seconds of a steady clock."""
        if self._since is None or frames > self._frames:
            self._frames, self._since, self._said = frames, now, None
            self._received = dict(pairing.received)
            return ""
        last = self._since if self._said is None else self._said + _AGAIN_SECONDS - _SILENT_SECONDS
        if now - last < _SILENT_SECONDS:
            return ""
        self._said = now
        return f"no frame was complete for {now - self._since:.0f} s: {self.reason(pairing)}"

    def reason(self, pairing: Pairing) -> str:
        """Return what is missing: a stream that does not come, or stamps that do not meet."""
        came = {topic: pairing.received[topic] - self._received.get(topic, 0) for topic in self.names}
        missing = [f"nothing comes on {self.names[topic]}" for topic, number in came.items() if not number]
        if came.get("image") and came.get("detections") and pairing.has_camera_info:
            return _stamps(pairing)
        if pairing.has_camera_info:
            missing = [text for text in missing if self.names.get("camera_info", "?") not in text]
        return "; ".join(missing) or _stamps(pairing)


def _stamps(pairing: Pairing) -> str:
    """Return why images and detections do not pair, with both newest stamps."""
    image, detections = (pairing.newest.get(topic, 0) for topic in ("image", "detections"))
    text = f"image and detections have no stamp in common; the newest are {_seconds(image)} and {_seconds(detections)}"
    if not image or not detections:
        return text + ": a stamp of zero pairs with nothing, the detections must carry their image's header"
    apart = 1e-9 * abs(image - detections)
    return text + f", {apart:.3f} s apart: pass the image's header on, or set pairing.tolerance_s"


def _seconds(stamp_ns: int) -> str:
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}"


@dataclass
class Hints:
    """Says once each what an answered frame lacks."""

    node: NodeConfig
    _said: set[str] = field(default_factory=set)

    def of(self, answer: Answer, detections: Any, depths: int, lost_infos: int = 0) -> list[str]:
        """Return what to log of this frame for the first time. depths: number of depth images received;
        lost_infos: of images whose camera info did not come."""
        hints = {}
        if answer.fit.ok and not answer.fit.metric:
            hints["scale"] = (
                "the metric scale is unknown, positions are in column pitches: set scale.column_pitch_m, or use_depth "
                "with an aligned depth image"
            )
        if lost_infos:
            hints["camera_info"] = (
                "images come without the camera_info that those before had: the last one that came serves; does its "
                "publisher still run?"
            )
        if self.node.use_depth and not depths:
            hints["depth"] = "use_depth is set, but nothing comes on the topic depth"
        settled = self.node.detections.numbers_are_labels or self.node.detections.labels or "numbers" in self._said
        if not settled and answer.fit.status != "bad_input" and has_number_ids(detections):
            hints["numbers"] = NUMBER_IDS
        new = [text for name, text in hints.items() if name not in self._said]
        self._said |= hints.keys()
        return new
