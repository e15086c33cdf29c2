"""The labelled pictures of real panels: read them, part them for validation."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

# Of every so many pictures one is kept for validation: those whose number leaves this remainder.
VALIDATION_EVERY = 8
VALIDATION_REMAINDER = 3
# Classes of things that are no buttons, by their whole name or, with a final *, its beginning.
OTHER_THINGS = ("led", "indicator", "keyhole", "bt_keyhole", "switch", "bt_switch", "speaker", "text*")


@dataclass(frozen=True)
class LabelledPicture:
    """A picture (H, W, 3) uint8 BGR with its boxes (N, 4) xmin, ymin, xmax, ymax in pixels and their labels."""

    name: str
    image: NDArray[np.uint8]
    boxes_px: NDArray[np.float32]
    labels: tuple[str, ...]

    @property
    def is_button(self) -> NDArray[np.bool_]:
        """Return (N,) which boxes are buttons rather than other things."""
        return np.array([not is_other_thing(label) for label in self.labels], dtype=bool)


def is_other_thing(label: str) -> bool:
    """Tell whether the class is a display, keyhole, speaker or another thing that cannot be pressed."""
    return any(label == name or (name.endswith("*") and label.startswith(name[:-1])) for name in OTHER_THINGS)


def is_validation(name: str) -> bool:
    """Tell whether the picture of that name (a number) is kept for validation."""
    return int(name) % VALIDATION_EVERY == VALIDATION_REMAINDER


def read_labelled(folder: Path, validation: bool | None = None, names: tuple[str, ...] = ()) -> list[LabelledPicture]:
    """Read the pictures in the order of their numbers; validation: only that part, None for all; names: only those."""
    entries: dict[str, Any] = json.loads((folder / "panels_labelled.json").read_text())
    chosen = names or sorted(entries, key=int)
    chosen = [name for name in chosen if validation is None or is_validation(name) == validation]
    return [_picture(folder, name, entries[name]) for name in chosen]


def _picture(folder: Path, name: str, entry: dict[str, Any]) -> LabelledPicture:
    image = cv2.imread(str(folder / "pictures" / f"{name}.jpg"), cv2.IMREAD_COLOR)
    if image is None:
        raise FileNotFoundError(f"{folder / 'pictures' / f'{name}.jpg'} cannot be read")
    boxes = np.array(entry["boxes"], dtype=np.float32).reshape(-1, 4)
    return LabelledPicture(name, image, boxes, tuple(entry["labels"]))
