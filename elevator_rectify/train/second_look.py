"""What a second look at the labelled pictures adds: things that were taken for buttons, and buttons left without a box.

The detector's false ones on the training part, looked at one by one: holes of speakers, dates burnt into the picture,
text on signs, tiles are no buttons and are shown more often; what may be a button that nobody boxed is not learnt from.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SECOND_LOOK = Path(__file__).with_name("second_look.json")


@dataclass(frozen=True)
class SecondLook:
    """Of one picture the boxes (N, 4) xmin, ymin, xmax, ymax in pixels of what is no button, and of what may be one."""

    no_button_px: Array
    unsure_px: Array


NOTHING_SEEN = SecondLook(np.zeros((0, 4)), np.zeros((0, 4)))


def read_second_look(path: Path = SECOND_LOOK) -> dict[str, SecondLook]:
    """Return the second looks by the pictures' names."""
    entries = json.loads(path.read_text())
    return {
        name: SecondLook(*(np.array(entry.get(key, ()), dtype=float).reshape(-1, 4) for key in ("no_button", "unsure")))
        for name, entry in entries.items()
    }
