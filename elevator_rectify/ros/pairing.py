"""Brings together the image, camera info, detections and depth of one instant, within bounded buffers."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter, OrderedDict
from dataclasses import dataclass
from typing import Any

from elevator_rectify.ros.config import PairingConfig
from elevator_rectify.ros.convert import stamp_ns

# So many images in a row that had a camera info of their own stamp: the next one will have one too.
_SYNCHRONISED = 2
# Images newer by this much show that an image's camera info or depth will not come any more.
_PATIENCE_NS = 500_000_000
# The stamp under which the last camera info is kept when the clock went back.
_BEFORE_ALL = -1


@dataclass(frozen=True)
class Frame:
    """The messages of one instant; detections and depth are None where there are none."""

    image: Any
    camera_info: Any
    detections: Any
    depth: Any = None


class Pairing:
    """Pairs by header.stamp. Every `add_*` returns the frames that became complete, and counts what it drops.

    The camera info is the one of the image's stamp, else the newest; frames wait for the first one. Where every image
    has had an info of its own, a frame waits for that, until a later one, or later images, show that it was lost; with
    `needs_depth` likewise for its depth, which may be off by the tolerance, too. Every image that was
    received is in a returned frame, in `dropped`, or still `waiting`.
    """

    def __init__(self, config: PairingConfig) -> None:
        self.config = config
        self.dropped: Counter[str] = Counter()
        self.received: Counter[str] = Counter({"image": 0, "camera_info": 0, "detections": 0})
        self.jumps = 0
        # Whether a frame is complete only with detections of a topic; else buttons are found in its image.
        self.needs_detections = True
        # Whether a frame waits for the depth image of its stamp.
        self.needs_depth = False
        # Images whose own camera info did not come, though those before had one each.
        self.lost_infos = 0
        self.newest: dict[str, int] = {}
        self._images: OrderedDict[int, Any] = OrderedDict()
        self._detections: OrderedDict[int, Any] = OrderedDict()
        self._infos: OrderedDict[int, Any] = OrderedDict()
        self._depths: OrderedDict[int, Any] = OrderedDict()
        self._bytes = self._depth_bytes = 0
        self._newest_ns: int | None = None
        self._done: OrderedDict[int, None] = OrderedDict()
        self._own_infos_in_a_row = 0

    def add_image(self, message: Any) -> list[Frame]:
        """Buffer an image; the oldest ones give way when count or bytes exceed the bounds."""
        stamp = self._received("image", message)
        if self._newest_ns is not None and (stamp < self._newest_ns - 1e9 * self.config.jump_s or self._loops(stamp)):
            self._clock_went_back(stamp)
        self._newest_ns = stamp if self._newest_ns is None else max(self._newest_ns, stamp)
        if stamp in self._images or stamp in self._done:
            self.dropped["image with a repeated stamp"] += 1
            return []
        self._images[stamp] = message
        self._bytes += len(message.data)
        while len(self._images) > self.config.max_images or self._bytes > self.config.max_megabytes << 20:
            self._remove_image(next(iter(self._images)))
            self.dropped["image without detections"] += 1
        return self._complete()

    def add_unreadable(self, topic: str) -> None:
        """Count a message whose bytes are none of its type."""
        self.received[topic] += 1
        self.dropped[f"{topic} that cannot be read"] += 1

    def add_camera_info(self, message: Any) -> list[Frame]:
        """Keep a camera info."""
        _keep(self._infos, self._received("camera_info", message), message, self.config.max_images)
        return self._complete()

    def add_depth(self, message: Any) -> list[Frame]:
        """Keep a depth image for the frame of its stamp; the oldest ones give way beyond the bounds of images."""
        stamp = self._received("depth", message)
        self._depth_bytes += len(message.data) - (len(self._depths[stamp].data) if stamp in self._depths else 0)
        self._depths[stamp] = message
        while len(self._depths) > self.config.max_images or self._depth_bytes > self.config.max_megabytes << 20:
            self._take_depth(min(self._depths))
            self.dropped["depth without image"] += 1
        return self._complete()

    def add_detections(self, message: Any) -> list[Frame]:
        """Buffer a detection message."""
        stamp = self._received("detections", message)
        if stamp in self._detections or stamp in self._done:
            self.dropped["detections with a repeated stamp"] += 1
            return []
        self._detections[stamp] = message
        while len(self._detections) > self.config.max_detections:
            self._detections.popitem(last=False)
            self.dropped["detections without image"] += 1
        return self._complete()

    def _received(self, topic: str, message: Any) -> int:
        """Count the message; return its stamp in ns."""
        self.received[topic] += 1
        self.newest[topic] = stamp_ns(message.header)
        return self.newest[topic]

    @property
    def has_camera_info(self) -> bool:
        """Tell whether any camera info is kept."""
        return bool(self._infos)

    def _loops(self, stamp: int) -> bool:
        """Tell whether a short bag begins again: its first answered image comes again, after others."""
        return len(self._done) > 1 and stamp == next(iter(self._done)) and stamp != self._newest_ns

    def _clock_went_back(self, now: int) -> None:
        """Empty the buffers; what is of the new time already, ahead of its image, stays, and so does the last info."""
        jump_ns = 1e9 * self.config.jump_s
        kept = {stamp: m for stamp, m in self._detections.items() if abs(stamp - now) < jump_ns}
        self.jumps += 1
        self.dropped["image: clock went back"] += len(self._images)
        self.dropped["detections: clock went back"] += len(self._detections) - len(kept)
        newest = next(reversed(self._infos.values()), None)
        for buffer in (self._images, self._detections, self._infos, self._depths, self._done):
            buffer.clear()
        self._detections.update(kept)
        if newest is not None:
            stamp = stamp_ns(newest.header)
            self._infos[stamp if abs(stamp - now) < jump_ns else _BEFORE_ALL] = newest
        self._bytes, self._depth_bytes, self._newest_ns = 0, 0, None

    def _complete(self) -> list[Frame]:
        """Take out all frames that are complete now, oldest first."""
        if not self._infos or not self._images:
            return []
        if not self.needs_detections:
            return [self._take(stamp, None) for stamp in sorted(self._images) if self._has_all(stamp)]
        pairs = [(stamp, stamp) for stamp in sorted(self._images.keys() & self._detections.keys())]
        if self.config.tolerance_s > 0:
            pairs = sorted(pairs + self._nearest_pairs(dict(pairs)))
        return [self._take(image, detections) for image, detections in pairs if self._has_all(image)]

    def _nearest_pairs(self, exact: dict[int, int]) -> list[tuple[int, int]]:
        """Return (image, detections) stamps within the tolerance; the nearest is known once a later image is there."""
        free = sorted(self._images.keys() - exact.keys())
        pairs = []
        for stamp in sorted(self._detections.keys() - exact.keys()):
            if not free or self._newest_ns is None or self._newest_ns < stamp:
                continue
            place = bisect_left(free, stamp)
            nearest = min(free[max(0, place - 1) : place + 1], key=lambda image: (abs(image - stamp), image))
            if abs(nearest - stamp) <= 1e9 * self.config.tolerance_s:
                pairs.append((nearest, stamp))
                free.remove(nearest)
        return pairs

    def _has_all(self, image: int) -> bool:
        """Tell whether the image's camera info and depth are there, or are not to be expected any more."""
        given_up = self._newest_ns is not None and self._newest_ns - image >= _PATIENCE_NS
        return given_up or (self._has_info(image) and self._has_depth(image))

    def _has_info(self, image: int) -> bool:
        """Tell whether the image's camera info is there, or none of its own is to be expected."""
        if image in self._infos or self._own_infos_in_a_row < _SYNCHRONISED:
            return True
        return max(self._infos) > image

    def _has_depth(self, image: int) -> bool:
        """Tell whether the image's depth is there, a later one shows that it was lost, or none has ever come."""
        if not self.needs_depth or not self.received["depth"] or self._depth_of(image) is not None:
            return True
        return any(stamp > image + 1e9 * self.config.tolerance_s for stamp in self._depths)

    def _depth_of(self, image: int) -> int | None:
        """Return the stamp of the image's depth: its own, or the nearest within the tolerance."""
        if image in self._depths:
            return image
        nearest = min(self._depths, key=lambda stamp: (abs(stamp - image), stamp), default=None)
        return nearest if nearest is not None and abs(nearest - image) <= 1e9 * self.config.tolerance_s else None

    def _take(self, image: int, detections: int | None) -> Frame:
        info = self._infos.get(image, next(reversed(self._infos.values())))
        self.lost_infos += image not in self._infos and self._own_infos_in_a_row >= _SYNCHRONISED
        boxes = None if detections is None else self._detections.pop(detections)
        depth = self._depth_of(image)
        frame = Frame(self._images[image], info, boxes, None if depth is None else self._take_depth(depth))
        self._own_infos_in_a_row = self._own_infos_in_a_row + 1 if image in self._infos else 0
        self._remove_image(image)
        _keep(self._done, image, None, 4 * self.config.max_images)
        return frame

    def _take_depth(self, stamp: int) -> Any:
        message = self._depths.pop(stamp)
        self._depth_bytes -= len(message.data)
        return message

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


def _keep(buffer: OrderedDict[int, Any], stamp: int, content: Any, most: int) -> None:
    """Add as the newest; the oldest give way beyond `most`."""
    buffer[stamp] = content
    buffer.move_to_end(stamp)
    while len(buffer) > most:
        buffer.popitem(last=False)
