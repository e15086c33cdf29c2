"""Brings together the image, camera info and detections of one instant, within bounded buffers."""

from __future__ import annotations

from collections import Counter, OrderedDict
from dataclasses import dataclass
from typing import Any

from elevator_rectify.ros.config import PairingConfig
from elevator_rectify.ros.convert import stamp_ns


@dataclass(frozen=True)
class Frame:
    """The messages of one instant."""

    image: Any
    camera_info: Any
    detections: Any


class Pairing:
    """Pairs by header.stamp. Every `add_*` returns the frames that became complete, and counts what it drops.

    The camera info is the one of the image's stamp, else the newest; frames wait for the first one.
    """

    def __init__(self, config: PairingConfig) -> None:
        self.config = config
        self.dropped: Counter[str] = Counter()
        self._images: OrderedDict[int, Any] = OrderedDict()
        self._detections: OrderedDict[int, Any] = OrderedDict()
        self._infos: OrderedDict[int, Any] = OrderedDict()
        self._bytes = 0
        self._done: OrderedDict[int, None] = OrderedDict()

    def add_image(self, message: Any) -> list[Frame]:
        """Buffer an image; the oldest ones give way when count or bytes exceed the bounds."""
        stamp = stamp_ns(message.header)
        if stamp in self._images or stamp in self._done:
            self.dropped["image with a repeated stamp"] += 1
            return []
        self._images[stamp] = message
        self._bytes += len(message.data)
        while len(self._images) > self.config.max_images or self._bytes > self.config.max_megabytes << 20:
            self._remove_image(next(iter(self._images)))
            self.dropped["image without detections"] += 1
        return self._complete()

    def add_camera_info(self, message: Any) -> list[Frame]:
        """Keep a camera info."""
        self._infos[stamp_ns(message.header)] = message
        self._infos.move_to_end(stamp_ns(message.header))
        while len(self._infos) > self.config.max_images:
            self._infos.popitem(last=False)
        return self._complete()

    def add_detections(self, message: Any) -> list[Frame]:
        """Buffer a detection message."""
        stamp = stamp_ns(message.header)
        if stamp in self._detections or stamp in self._done:
            self.dropped["detections with a repeated stamp"] += 1
            return []
        self._detections[stamp] = message
        while len(self._detections) > self.config.max_detections:
            self._detections.popitem(last=False)
            self.dropped["detections without image"] += 1
        return self._complete()

    def _complete(self) -> list[Frame]:
        """Take out all frames that are complete now, oldest first."""
        if not self._infos:
            return []
        frames = []
        for stamp in sorted(self._images.keys() & self._detections.keys()):
            info = self._infos.get(stamp, next(reversed(self._infos.values())))
            frames.append(Frame(self._images[stamp], info, self._detections.pop(stamp)))
            self._remove_image(stamp)
            self._done[stamp] = None
            if len(self._done) > 4 * self.config.max_images:
                self._done.popitem(last=False)
        return frames

    def _remove_image(self, stamp: int) -> None:
        self._bytes -= len(self._images.pop(stamp).data)

    def waiting(self) -> Counter[str]:
        """Count what is still in the buffers, by what it lacks."""
        lacking = "camera_info" if not self._infos else "its counterpart"
        counts = {
            f"image waiting for {lacking}": len(self._images),
            f"detections waiting for {lacking}": len(self._detections),
        }
        return Counter({name: number for name, number in counts.items() if number})
