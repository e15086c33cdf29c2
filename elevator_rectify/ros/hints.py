"""What a user should be told and would otherwise have to guess: why nothing comes, and which parameter is missing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from elevator_rectify.core.picture.placement import Placement
from elevator_rectify.core.types import Array
from elevator_rectify.ros.answer import Answer
from elevator_rectify.ros.config import NodeConfig
from elevator_rectify.ros.convert import NUMBER_IDS, has_number_ids
from elevator_rectify.ros.pairing import Pairing

# After so long without a frame the reason is told, and again after so long while it lasts.
_SILENT_SECONDS, _AGAIN_SECONDS = 5.0, 30.0
# So many contradicted frames must ask for the same setting, among so many; the same: scales this near to each other,
# and offsets, over the picture's size.
_ALIKE, _MOST_TRIED, _SAME_SCALE, _SAME_OFFSET = 5, 30, 0.08, 0.04


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
class Placements:
    """Where the boxes of contradicted frames would belong; what most of them have in common is a setting."""

    _tried: int = 0
    _found: list[Placement] = field(default_factory=list)

    @property
    def wanted(self) -> bool:
        """Tell whether more frames may still tell something."""
        return len(self._found) < _ALIKE and self._tried < _MOST_TRIED

    def add(self, found: Placement | None) -> None:
        """Count a contradicted frame; those that fit no map at all are of another moment or panel."""
        self._tried += 1
        if found is not None:
            self._found.append(found)

    def advice(self) -> str:
        """Return the setting that all frames ask for, '' where they do not agree."""
        if len(self._found) < _ALIKE:
            return ""
        scale = np.array([p.scale for p in self._found])
        size, box = self._found[-1].size_px, self._found[-1].box_px
        offset = np.array([p.offset_px / p.size_px for p in self._found])
        if np.ptp(scale, axis=0).max() > _SAME_SCALE or np.ptp(offset, axis=0).max() > _SAME_OFFSET:
            return ""
        return _setting(np.median(scale, axis=0), np.median(offset, axis=0) * size, size, box)


def _setting(scale: Array, offset_px: Array, size: Array, box_px: Array) -> str:
    """Return which setting moves boxes by this map."""
    if scale[0] < 0:
        return "the boxes are those of the mirrored picture"
    scale = np.where(np.abs(scale - 1.0) < _SAME_SCALE, 1.0, scale)
    if (scale == 1.0).all() and (np.abs(offset_px / np.maximum(box_px, 1.0) - 0.5) < 0.2).all():
        return "the boxes' x and y seem to be their upper left corners: their centres are needed"
    names = ("image_width_px", "image_height_px"), ("offset_x_px", "offset_y_px")
    of_scale = [(name, round(n / s)) for name, n, s in zip(names[0], size, scale, strict=True) if s != 1.0]
    border = np.where(np.abs(offset_px) < _SAME_OFFSET * size, 0.0, -offset_px / scale)
    of_offset = [(name, round(b)) for name, b in zip(names[1], border, strict=True) if b]
    settings = ", ".join(f"detections.{name}: {value}" for name, value in of_scale + of_offset)
    return f"the boxes are those of a resized, cropped or letterboxed picture: set about {settings}" if settings else ""


@dataclass
class Hints:
    """Says once each what an answered frame lacks."""

    node: NodeConfig
    placements: Placements = field(default_factory=Placements)
    _said: set[str] = field(default_factory=set)

    @property
    def advice(self) -> str:
        """Return the setting that would bring contradicted boxes onto the buttons, '' for none."""
        return self.placements.advice()

    def of(self, answer: Answer, detections: Any, depths: int, lost_infos: int = 0) -> list[str]:
        """Return what to log of this frame for the first time. depths: number of depth images received;
        lost_infos: of images whose camera info did not come."""
        hints = {}
        if answer.fit.status == "contradicted" and self.placements.wanted:
            self.placements.add(answer.placement)
            if self.advice:
                hints["placement"] = f"the picture contradicts the boxes: {self.advice}"
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
