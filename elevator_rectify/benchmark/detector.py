"""How well our own detector finds the buttons of real pictures that it was not trained on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.core.detector.detect import detect_buttons
from elevator_rectify.core.types import Array, BoolArray, Detection
from elevator_rectify.train.labelled import read_labelled

SIZES = ("under 12", "12 to 16", "16 to 24", "24 to 40", "40 and more")
_BOUNDS = (12, 16, 24, 40)
_NEAR = 0.3
_FOUND, _FALSE = 0.9, 1


@dataclass(frozen=True)
class Picture:
    """One picture's count: found (by size), all (by size), false ones, and those of them that lie on other things."""

    found: tuple[int, ...]
    all: tuple[int, ...]
    false: int
    on_other: int

    @property
    def good(self) -> bool:
        """Tell whether 90 % were found with at most one false."""
        return sum(self.found) >= _FOUND * sum(self.all) and self.false <= _FALSE


def boxes_of(detections: list[Detection]) -> Array:
    """Return (N, 4) xmin, ymin, xmax, ymax in the annotations' count of pixels."""
    centre = np.array([[d.x_px, d.y_px] for d in detections]).reshape(-1, 2) + 0.5
    half = np.array([[d.width_px, d.height_px] for d in detections]).reshape(-1, 2) / 2.0
    return np.concatenate([centre - half, centre + half], axis=1)


def iou(boxes: Array, true: Array) -> Array:
    """Return (N, M) the intersections over unions."""
    low = np.maximum(boxes[:, None, :2], true[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], true[None, :, 2:])
    both = np.prod(np.maximum(high - low, 0.0), axis=2)
    area = [np.prod(b[:, 2:] - b[:, :2], axis=1) for b in (boxes, true)]
    return np.asarray(both / np.maximum(area[0][:, None] + area[1][None] - both, 1e-9))


def nearness(boxes: Array, true: Array) -> Array:
    """Return (N, M) 1 - the distance of the centres over the true box's smaller side: .7 is within .3 of the size."""
    centre = [(b[:, :2] + b[:, 2:]) / 2.0 for b in (boxes, true)]
    size = (true[:, 2:] - true[:, :2]).min(axis=1)
    return np.asarray(1.0 - np.linalg.norm(centre[0][:, None] - centre[1][None], axis=2) / size)


def matched(likeness: Array, least: float) -> Array:
    """Return for each of N detections (best first) the true box that it takes, -1 for none; each is taken once."""
    free, taken = np.ones(likeness.shape[1], dtype=bool), np.full(len(likeness), -1)
    for k, row in enumerate(likeness):
        best = int(np.argmax(np.where(free, row, -np.inf))) if len(row) else -1
        if best >= 0 and free[best] and row[best] >= least:
            taken[k], free[best] = best, False
    return taken


CRITERIA: dict[str, tuple[Callable[[Array, Array], Array], float]] = {
    "centre within .3": (nearness, 1.0 - _NEAR),
    "IoU .5": (iou, 0.5),
}


def run_picture(task: tuple[str, str]) -> dict[str, Picture]:
    """Return the counts of one picture by criterion: (folder, name)."""
    (picture,) = read_labelled(Path(task[0]), names=(task[1],))
    boxes = boxes_of(detect_buttons(picture.image))
    true, other = (picture.boxes_px[k].astype(float) for k in (picture.is_button, ~picture.is_button))
    return {name: _counted(boxes, true, other, *criterion) for name, criterion in CRITERIA.items()}


def _counted(
    boxes: Array, true: Array, other: Array, likeness: Callable[[Array, Array], Array], least: float
) -> Picture:
    taken = matched(likeness(boxes, true), least) if len(true) else np.full(len(boxes), -1)
    size = np.digitize((true[:, 2:] - true[:, :2]).min(axis=1) if len(true) else np.zeros(0), _BOUNDS)
    found = size[taken[taken >= 0]]
    wrong: BoolArray = taken < 0
    on_other = (iou(boxes[wrong], other) > 0.3).any(axis=1).sum() if len(other) else 0
    counts = [tuple(int((s == k).sum()) for k in range(len(SIZES))) for s in (found, size)]
    return Picture(counts[0], counts[1], int(wrong.sum()), int(on_other))


def detector_table(folder: Path, figures: Figures, workers: int | None = None) -> str:
    """Return the table over the validation part."""
    names = [p.name for p in read_labelled(folder, validation=True)]
    results = parallel(run_picture, [(str(folder), name) for name in names], "detector", workers)
    head = f"{'':<18}{'precision':>10}{'recall':>8}{'F1':>7}" + "".join(f"{s:>13}" for s in SIZES)
    lines = [f"{len(names)} pictures held out; recall by the smaller side in pixels", head]
    for name in CRITERIA:
        lines.append(_line(name, [result[name] for result in results], figures))
    centre = [result["centre within .3"] for result in results]
    good = [p.good for p in centre]
    figures.rate("detector, pictures with 90 % found and at most one false+", good)
    found, on_other = sum(sum(p.found) for p in centre), sum(p.on_other for p in centre)
    lines.append(
        f"pictures with 90 % found and at most one false: {np.mean(good):.3f}; precision against things that are no "
        f"buttons: {found / max(1, found + on_other):.3f}"
    )
    return "\n".join(lines)


def _line(name: str, pictures: list[Picture], figures: Figures) -> str:
    by_size, total = (np.sum([getattr(p, part) for p in pictures], axis=0) for part in ("found", "all"))
    found, false = int(by_size.sum()), sum(p.false for p in pictures)
    precision, recall = found / max(1, found + false), found / max(1, int(total.sum()))
    figures.share(f"detector, {name}, precision+", found, found + false)
    figures.share(f"detector, {name}, recall+", found, int(total.sum()))
    f1 = 2 * precision * recall / max(1e-9, precision + recall)
    sizes = "".join(f"{share:>13.3f}" for share in by_size / np.maximum(1, total))
    return f"{name:<18}{precision:>10.3f}{recall:>8.3f}{f1:>7.3f}{sizes}"
