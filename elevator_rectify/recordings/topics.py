"""Which topics of a bag are the image, its camera_info and its detections: by type, by stamps that meet, by content."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from elevator_rectify.ros.bag import BadBag, Record, Unreadable, bag_topics, read_bag
from elevator_rectify.ros.config import DETECTION_TYPES
from elevator_rectify.ros.convert import stamp_ns

# The node's own topics, wherever its namespace puts them.
OUTPUT_PREFIX = "/elevator_rectify/"
_TRUTH_PREFIX = "/truth/"
# Message types that serve as each stream, in order of preference; of detections boxes with sizes and labels come first.
STREAM_TYPES = {
    "image": ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"),
    "camera_info": ("sensor_msgs/msg/CameraInfo",),
    "detections": tuple(reversed(DETECTION_TYPES.values())),
}
_DEPTH_ENCODINGS = ("16UC1", "32FC1")
# So many messages of each topic are looked at, of so many in all.
_SAMPLED, _MOST = 60, 20_000
# Centres in pixels lie further apart than anything in metres that a robot plans.
_LEAST_SPREAD = 30.0


@dataclass(frozen=True)
class InputTopics:
    """Where the three streams are in a bag."""

    image: str
    camera_info: str
    detections: str


@dataclass
class _Sample:
    """What is seen of one topic: its type, its first messages' stamps, the frame and content of the first."""

    kind: str
    stamps: set[int] = field(default_factory=set)
    frame: str = ""
    plausible: bool = True


def find_topics(
    path: Path, given: dict[str, str | None], usable: Callable[[str], bool] = lambda kind: True
) -> InputTopics:
    """Return the bag's input topics: the given ones, else those whose stamps meet; BadBag where one is missing.

    usable: tells which types may be chosen, such as those that are installed.
    """
    topics = recorded_topics(path)
    candidates = {stream: _candidates(path, stream, topics, given.get(stream), usable) for stream in STREAM_TYPES}
    if all(len(names) == 1 for names in candidates.values()):
        return InputTopics(**{stream: names[0] for stream, names in candidates.items()})
    samples = _sampled(path, {name: topics[name] for names in candidates.values() for name in names})
    pairs = [(i, d) for i in candidates["image"] for d in candidates["detections"]]
    image, detections = max(pairs, key=lambda pair: _pair_rank(pair, samples))
    info = max(candidates["camera_info"], key=lambda name: _info_rank(name, image, samples))
    return InputTopics(image, info, detections)


def recorded_topics(path: Path) -> dict[str, str]:
    """Return {topic: type} of what may be an input: neither the truth nor the node's own outputs."""
    return {
        name: kind
        for name, (kind, _) in bag_topics(path).items()
        if not name.startswith(_TRUTH_PREFIX) and OUTPUT_PREFIX not in name
    }


def _candidates(
    path: Path, stream: str, topics: dict[str, str], wish: str | None, usable: Callable[[str], bool]
) -> list[str]:
    """Return the topics that may be the stream, the likeliest by type and name first."""
    kinds = STREAM_TYPES[stream]
    if wish is not None:
        if topics.get(wish) not in kinds:
            raise BadBag(f"{path} has no topic {wish} of type {' or '.join(kinds)}; it has {_listed(topics)}")
        return [wish]
    fitting = [name for kind in kinds for name in sorted(topics) if topics[name] == kind and usable(kind)]
    if not fitting:
        raise BadBag(f"{path} has no {stream}: no topic of type {' or '.join(kinds)}; it has {_listed(topics)}")
    return sorted(fitting, key=lambda name: stream not in name)


def _listed(topics: dict[str, str]) -> str:
    return ", ".join(f"{name} ({kind})" for name, kind in sorted(topics.items())) or "none"


def _sampled(path: Path, kinds: dict[str, str]) -> dict[str, _Sample]:
    """Look at the first messages of the topics."""
    samples = {name: _Sample(kind) for name, kind in kinds.items()}
    try:
        for record in read_bag(path, set(kinds)):
            sample = samples[record.topic]
            if len(sample.stamps) < _SAMPLED:
                _look(sample, record)
            if record.number > _MOST or all(len(s.stamps) >= _SAMPLED for s in samples.values()):
                break
    except BadBag:
        pass
    return samples


def _look(sample: _Sample, record: Record) -> None:
    try:
        message = record.message
    except Unreadable:
        sample.plausible = False
        return
    if not sample.stamps:
        sample.frame = str(message.header.frame_id)
    sample.stamps.add(stamp_ns(message.header))
    sample.plausible = sample.plausible and _plausible(message)


def _plausible(message: Any) -> bool:
    """Tell whether a message may be what its type serves for here: no depth image, no poses in metres."""
    if hasattr(message, "encoding"):
        return message.encoding not in _DEPTH_ENCODINGS
    if hasattr(message, "poses") and len(message.poses) > 1:
        places = np.array([[pose.position.x, pose.position.y] for pose in message.poses])
        return bool(np.ptp(places, axis=0).max() > _LEAST_SPREAD)
    return True


def _meeting(one: set[int], other: set[int]) -> float:
    """Return the share of the second's stamps, while the first lasts, that the first has too."""
    if not one or not other:
        return 0.0
    within = [stamp for stamp in other if min(one) <= stamp <= max(one)]
    return len(one & other) / max(1, len(within))


def _pair_rank(pair: tuple[str, str], samples: dict[str, _Sample]) -> tuple[float, ...]:
    """Return what the right image and detections have most of; later candidates must be better, not equal."""
    image, detections = (samples[name] for name in pair)
    meeting = _meeting(image.stamps, detections.stamps)
    same_frame = image.frame == detections.frame or not detections.frame
    return float(image.plausible), float(detections.plausible), round(meeting, 1), float(same_frame)


def _info_rank(name: str, image: str, samples: dict[str, _Sample]) -> tuple[float, ...]:
    """Return what the image's camera_info has most of: its frame, its stamps, its namespace."""
    info, picture = samples[name], samples[image]
    shared = sum(a == b for a, b in zip(PurePosixPath(name).parts, PurePosixPath(image).parts, strict=False))
    return float(info.frame == picture.frame), round(_meeting(picture.stamps, info.stamps), 1), float(shared)
