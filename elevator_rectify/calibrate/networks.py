"""Makes the networks' scores probabilities, on the pictures that they were not trained on."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from elevator_rectify.benchmark.detector import iou, matched, nearness
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.reader import calibration_error, readable, true_box
from elevator_rectify.calibrate.logistic import logistic_regression
from elevator_rectify.core.detector import detect
from elevator_rectify.core.detector.peaks import features
from elevator_rectify.core.reading import reader
from elevator_rectify.core.reading.vocabulary import KINDS, SLOTS, encoded
from elevator_rectify.core.types import Array, IntArray
from elevator_rectify.train.labelled import read_labelled

_RIDGE = 0.01
_NEAR = 0.7
_TEMPERATURES = np.exp(np.linspace(np.log(0.5), np.log(4.0), 71))


def peaks_of(task: tuple[str, str]) -> tuple[Array, Array]:
    """Return features (N, P) and truth (N,) of every peak of a picture that says 'button': (folder, name)."""
    (picture,) = read_labelled(Path(task[0]), names=(task[1],))
    found = detect.find_boxes(picture.image)
    X, boxes = features(found)[found.is_button], found.boxes_px[found.is_button]
    true = picture.boxes_px[picture.is_button].astype(float)
    if not len(true):
        return X, np.zeros(len(X))
    likeness = np.maximum(nearness(boxes, true), 0.2 + iou(boxes, true))
    return X, (matched(likeness, _NEAR) >= 0).astype(float)


def calibrate_detector(folder: Path) -> None:
    """Fit the logistic of the peaks' features and write it beside the detector; judge it on the other half."""
    tasks = [(str(folder), p.name) for p in read_labelled(folder, validation=True)]
    found = parallel(peaks_of, tasks, "peaks")
    for fitted, judged in ((found[::2], found[1::2]), (found[1::2], found[::2])):
        beta = _fitted(fitted)
        X, right = (np.concatenate(part) for part in zip(*judged, strict=True))
        p = 1.0 / (1.0 + np.exp(-X @ beta))
        f1, limit = max((_f1(p > t, right), t) for t in np.linspace(0.1, 0.9, 33))
        print(f"other half: calibration error {calibration_error(p, right):.3f}, best F1 {f1:.3f} from {limit:.2f} on")
    beta = _fitted(found)
    detect.SCORES.write_text(json.dumps({"coefficients": [round(float(b), 4) for b in beta]}) + "\n")
    print(f"{sum(len(y) for _, y in found)} peaks: {detect.SCORES.read_text().strip()}")


def _fitted(found: list[tuple[Array, Array]]) -> Array:
    X, right = (np.concatenate(part) for part in zip(*found, strict=True))
    return logistic_regression(X, right, np.ones(len(right)), _RIDGE)


def _f1(said: Array, right: Array) -> float:
    """Return F1 among the peaks: true buttons without a peak are not counted here."""
    return float(2.0 * (said * right).sum() / max(1.0, said.sum() + right.sum()))


def logits_of(task: tuple[str, str]) -> list[tuple[Array, int, tuple[int, ...], bool]]:
    """Return logits, kind, slots and whether it is small of the readable buttons of a picture: (folder, name)."""
    (picture,) = read_labelled(Path(task[0]), names=(task[1],))
    chosen = [k for k, label in enumerate(picture.labels) if picture.is_button[k] and readable(label)]
    corners = reader.box_corners_px([true_box(picture.boxes_px[k]) for k in chosen])
    said = [encoded(picture.labels[k]) for k in chosen]
    logits, small = reader.quadrangle_logits(picture.image, corners), map(reader.is_small, corners)
    return [(row, KINDS.index(s[0]), s[1], t) for row, s, t in zip(logits, said, small, strict=True) if s]


def calibrate_reader(folder: Path) -> None:
    """Find the temperatures at which the true labels are likeliest, and write them beside the reader."""
    tasks = [(str(folder), p.name) for p in read_labelled(folder, validation=True)]
    examples = [e for several in parallel(logits_of, tasks, "logits") for e in several]
    found = {
        name: _best_temperature([e for e in examples if e[3] == small])
        for name, small in (("small", True), ("large", False))
    }
    reader.CALIBRATION.write_text(json.dumps({"temperature": found}) + "\n")
    print(f"{len(examples)} buttons: {reader.CALIBRATION.read_text().strip()}")


def _best_temperature(examples: list[tuple[Array, int, tuple[int, ...], bool]]) -> float:
    """Return the temperature of the least cost over the examples' logits, kinds and slots."""
    logits, kinds = np.stack([e[0] for e in examples]), np.array([e[1] for e in examples])
    slots = np.array([e[2] for e in examples])
    cost = [_cost(logits / t, kinds, slots) for t in _TEMPERATURES]
    return round(float(_TEMPERATURES[int(np.argmin(cost))]), 3)


def _cost(logits: Array, kinds: IntArray, slots: IntArray) -> float:
    """Return the mean negative log likelihood of kinds and, of texts, characters."""
    number = np.arange(len(kinds))
    total = -_log_softmax(logits[:, : len(KINDS)])[number, kinds]
    each = _log_softmax(logits[:, len(KINDS) :].reshape(len(kinds), SLOTS, -1))
    characters = -np.take_along_axis(each, slots[:, :, None], axis=2)[..., 0].sum(axis=1)
    return float((total + np.where(kinds == KINDS.index("text"), characters, 0.0)).mean())


def _log_softmax(x: Array) -> Array:
    x = x - x.max(axis=-1, keepdims=True)
    return np.asarray(x - np.log(np.exp(x).sum(axis=-1, keepdims=True)))
