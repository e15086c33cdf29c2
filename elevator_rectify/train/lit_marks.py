"""Which lamps are lit in the labelled pictures, marked by eye, one by one, from the buttons' enlarged pictures.

Only some of the pictures were looked at. What may be a lamp or a coloured cap is neither learnt from nor judged by.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

MARKS = Path(__file__).with_name("lit_marks.json")


@dataclass(frozen=True)
class Marks:
    """Of one picture the buttons, in the order of their boxes, that are lit, and those that cannot be told."""

    lit: frozenset[int]
    unsure: frozenset[int]


def read_marks(path: Path = MARKS) -> dict[str, Marks]:
    """Return the marks by the names of the pictures that were looked at."""
    entries = json.loads(path.read_text())
    return {name: Marks(frozenset(e.get("lit", ())), frozenset(e.get("unsure", ()))) for name, e in entries.items()}
