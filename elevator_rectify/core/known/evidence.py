"""What the readings of detections say of which button of a taught panel each of them is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from elevator_rectify.core.reading.labels import canonical
from elevator_rectify.core.reading.misread import right_alone
from elevator_rectify.core.reading.places import readings_of
from elevator_rectify.core.types import Array, BoolArray, Detection

# A label is on one button in so many; a sure reading is wrong, or the panel was taught wrongly, that often.
_LABELS, _WRONG = 50.0, 0.03
# Readings that are surer than this tell whether it is this panel at all.
_SURE = 0.8


def distribution(detection: Detection) -> dict[str, float]:
    """Return what the detection's button may be labelled, with probabilities; what is missing to 1 is unread."""
    found, label = dict(readings_of(detection)), canonical(detection.label)
    if not found and label:
        score = float(np.nan_to_num(detection.score))
        return {label: float(right_alone(label, np.array(score)))}
    return found


def reading_nats(detections: Sequence[Detection], labels: Sequence[str]) -> Array:
    """Return (N, K) ln of how much likelier each reading is where the detection is a button with that label."""
    nats = np.zeros((len(detections), len(labels)))
    for n, detection in enumerate(detections):
        read = distribution(detection)
        total = min(1.0, sum(read.values()))
        if total <= 0.0:
            continue
        p = np.array([read.get(label, 0.0) for label in labels])
        likelier = 1.0 - total + (1.0 - _WRONG) * p * _LABELS + _WRONG * total
        nats[n] = np.where([label != "" for label in labels], np.log(likelier), 0.0)
    return nats


def agreeing(detections: Sequence[Detection], labels: Sequence[str]) -> tuple[BoolArray, BoolArray]:
    """Return (N,) which detections are surely read, and which of them as the label (N,) that they should have."""
    likeliest = [max(distribution(d).items(), key=lambda item: item[1], default=("", 0.0)) for d in detections]
    sure = np.array([p > _SURE for _, p in likeliest], dtype=bool) & np.array([label != "" for label in labels])
    return sure, sure & np.array([read == label for (read, _), label in zip(likeliest, labels, strict=True)])
