"""How well our own reader reads the buttons of real pictures that it was not trained on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from elevator_rectify.benchmark.detector import SIZES
from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.core.reading.labels import canonical
from elevator_rectify.core.reading.reader import read_boxes
from elevator_rectify.core.reading.vocabulary import SYMBOLS, encoded
from elevator_rectify.core.types import Array, Detection
from elevator_rectify.train.labelled import read_labelled

_BOUNDS = (12, 16, 24, 40)
_SURE, _BINS = 0.9, 10


@dataclass(frozen=True)
class Answer:
    """One button: what is printed, what was read and how surely, its size in pixels."""

    true: str
    read: str
    probability: float
    size_px: float

    @property
    def right(self) -> bool:
        """Tell whether it means the same."""
        return canonical(self.true) == canonical(self.read)


def run_picture(task: tuple[str, str]) -> list[Answer]:
    """Read the true boxes of one picture: (folder, name); those of which nobody can say what they read are left out."""
    (picture,) = read_labelled(Path(task[0]), names=(task[1],))
    chosen = [k for k, label in enumerate(picture.labels) if picture.is_button[k] and readable(label)]
    detections = [true_box(picture.boxes_px[k]) for k in chosen]
    answers = []
    for k, read in zip(chosen, read_boxes(picture.image, detections), strict=True):
        label, probability = read.labels[0] if read.labels else ("", 0.0)
        size = float((picture.boxes_px[k, 2:] - picture.boxes_px[k, :2]).min())
        true = picture.labels[k]
        answers.append(Answer("*" + true[1:] if true.startswith("s") else true, label, probability, size))
    return answers


def readable(label: str) -> bool:
    """Tell whether a label, as annotated, is a text or a symbol that the vocabulary has."""
    said = encoded(label)
    return said is not None and (said[0] == "text" or said[0] in SYMBOLS)


def true_box(box: Array) -> Detection:
    """Return an annotated box (4,) as a detection."""
    x0, y0, x1, y1 = (float(v) for v in box)
    return Detection((x0 + x1) / 2.0, (y0 + y1) / 2.0, x1 - x0, y1 - y0)


def reader_table(folder: Path, figures: Figures, workers: int | None = None) -> str:
    """Return the table over the validation part."""
    names = [p.name for p in read_labelled(folder, validation=True)]
    results = parallel(run_picture, [(str(folder), name) for name in names], "reader", workers)
    answers = [a for several in results for a in several]
    kinds = {
        "texts": [a for a in answers if a.true not in SYMBOLS],
        "numbers": [a for a in answers if a.true.lstrip("-").isdigit()],
        "symbols": [a for a in answers if a.true in SYMBOLS],
        "all": answers,
    }
    lines = [f"{'right':<10}{'buttons':>8}{'all':>7}" + "".join(f"{s:>13}" for s in SIZES)]
    for name, chosen in kinds.items():
        size = np.digitize([a.size_px for a in chosen], _BOUNDS)
        right = np.array([a.right for a in chosen])
        figures.rate(f"reader, {name} right+", right)
        parts = [right[size == k].mean() if (size == k).any() else np.nan for k in range(len(SIZES))]
        lines.append(f"{name:<10}{len(chosen):>8}{right.mean():>7.3f}" + "".join(f"{p:>13.3f}" for p in parts))
    p, right = np.array([a.probability for a in answers]), np.array([a.right for a in answers])
    figures.rate("reader, right where it says .9 or more+", right[p >= _SURE])
    sure = p >= _SURE
    lines.append(
        f"says .9 or more of {sure.mean():.3f}, right of those {right[sure].mean():.3f}; "
        f"calibration error {calibration_error(p, right):.3f}"
    )
    return "\n".join(lines)


def calibration_error(probability: Array, right: Array) -> float:
    """Return the expected calibration error over ten bins."""
    place = np.minimum((probability * _BINS).astype(int), _BINS - 1)
    bins = [place == b for b in np.unique(place)]
    return float(sum(abs(probability[b].mean() - right[b].mean()) * b.mean() for b in bins))
