"""Pictures without a panel: parts of real pictures beside their panels, in which nothing is to be found."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.core import Camera, find_panel
from elevator_rectify.core.types import Image
from elevator_rectify.train.labelled import LabelledPicture, read_labelled

# Parts are squares of at least so many pixels, away from every box by this share of its size; so many tries for one.
_LEAST_PX, _AWAY, _TRIES = 110, 0.6, 60
_SIDE_PX, _FOCAL = 416, 0.9


def part_without_panel(picture: LabelledPicture, rng: np.random.Generator) -> Image | None:
    """Return a square part of the picture without any annotated box, None where there is no room."""
    size = np.tile(picture.boxes_px[:, 2:] - picture.boxes_px[:, :2], 2) * np.array([-_AWAY, -_AWAY, _AWAY, _AWAY])
    boxes = picture.boxes_px + size
    height, width = picture.image.shape[:2]
    for _ in range(_TRIES):
        side = int(rng.integers(_LEAST_PX, min(height, width)))
        x, y = int(rng.integers(0, width - side + 1)), int(rng.integers(0, height - side + 1))
        apart = (boxes[:, 2] < x) | (boxes[:, 0] > x + side) | (boxes[:, 3] < y) | (boxes[:, 1] > y + side)
        if apart.all():
            part = picture.image[y : y + side, x : x + side]
            return np.asarray(cv2.resize(part, (_SIDE_PX, _SIDE_PX), interpolation=cv2.INTER_CUBIC))
    return None


def run_without(task: tuple[str, str, int]) -> bool | None:
    """Tell whether a panel is found in a part without one: (folder, name, number); None where there is no room."""
    (picture,) = read_labelled(Path(task[0]), names=(task[1],))
    image = part_without_panel(picture, np.random.default_rng([int(task[1]), task[2]]))
    return None if image is None else find_panel(image, Camera.centred(_SIDE_PX, _SIDE_PX, _FOCAL * _SIDE_PX)).ok


def no_panel_line(folder: Path, figures: Figures, each: int, workers: int | None = None) -> str:
    """Return the line of the pictures without a panel, `each` parts of every held-out picture."""
    names = [p.name for p in read_labelled(folder, validation=True)]
    tasks = [(str(folder), name, number) for number in range(each) for name in names]
    found = [ok for ok in parallel(run_without, tasks, "without a panel", workers) if ok is not None]
    figures.rate("pictures without a panel, accepted-", found)
    return f"parts of real pictures without a panel: {len(found)}, accepted {sum(found)}"
