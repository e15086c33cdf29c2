"""Whether a press is confirmed: lamps painted over real pictures that nothing was fitted to."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from elevator_rectify.benchmark.end_to_end import judgeable
from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.presses import KINDS, LIT, presses
from elevator_rectify.core.lamps.watch import JUDGED, Watch, confirmed, ended, watched
from elevator_rectify.core.types import Array, BoolArray
from elevator_rectify.train.labelled import read_labelled

_STATUSES = ("confirmed", "not_lit", "blinks", "all_lit", "unseen", "panel_left")
# Presses of every kind on each panel.
_PRESSES = 2
_SIZES_PX = (0.0, 14.0, 20.0, 30.0, np.inf)


@dataclass(frozen=True)
class Outcome:
    """One press: what happened, the answer, the button's size in pixels, the log odds of every frame that showed it."""

    kind: str
    status: str
    side_px: float
    log_odds: tuple[float, ...]


def run_panel(task: tuple[str, str, int]) -> list[Outcome]:
    """Watch all presses on one picture: (folder, name, number of each kind without a lamp)."""
    folder, name, dark = task
    found = []
    for press in presses(folder, name, _PRESSES, JUDGED, dark=dark):
        watch, answer = Watch(press.label, press.before), None
        for now in press.after:
            watch = watched(watch, now)
            answer = answer or confirmed(watch)
        before = press.before[0]
        side = float(before.side_px[before.labels.index(press.label)])
        odds = tuple(s.log_odds for s in watch.sights if s.seen)
        found.append(Outcome(press.kind, (answer or ended(watch)).status, side, odds))
    return found


def lamps_table(folder: Path, figures: Figures, dark: int = _PRESSES) -> str:
    """Return the table over the validation part, of so many presses of each kind without a lamp on every panel."""
    names = [p.name for p in read_labelled(folder, validation=True) if judgeable(p)]
    several = parallel(run_panel, [(str(folder), name, dark) for name in names], "lamps")
    found = [outcome for outcomes in several for outcome in outcomes]
    lines = [f"{'presses on ' + str(sum(map(bool, several))) + ' real panels':<28}{'':>8}"]
    lines[0] += "".join(f"{s:>12}" for s in _STATUSES)
    for kind in KINDS:
        lines.append(_line(kind, [o for o in found if o.kind == kind], figures))
    for low, high in pairwise(_SIZES_PX):
        of_size = [o for o in found if low <= o.side_px < high]
        for name, chosen in (("lit", [o for o in of_size if o.kind in LIT]),
                             ("not lit", [o for o in of_size if o.kind not in LIT])):  # fmt: skip
            lines.append(_line(f"{name}, {low:.0f} to {high:.0f} px", chosen))
    odds = np.array([odd for o in found for odd in o.log_odds])
    lit = np.array([o.kind in LIT for o in found for _ in o.log_odds], dtype=bool)
    lines.append(f"single frames: area under the curve {area_under_curve(odds, lit):.3f}")
    return "\n".join(lines)


def _line(name: str, found: list[Outcome], figures: Figures | None = None) -> str:
    counts = Counter(o.status for o in found)
    if figures is not None:
        figures.rate(f"lamps, {name}, confirmed", [o.status == "confirmed" for o in found])
    shares = "".join(f"{counts[status] / max(1, len(found)):>12.3f}" for status in _STATUSES)
    return f"{name:<28}{len(found):>8}{shares}"


def area_under_curve(score: Array, positive: BoolArray) -> float:
    """Return the probability that a positive scores above a negative (Hastie, Tibshirani and Friedman, 9.2.5)."""
    rank = np.argsort(np.argsort(score, kind="stable"), kind="stable")
    ones, zeros = int(positive.sum()), int((~positive).sum())
    return float((rank[positive].sum() - ones * (ones - 1) / 2) / max(1, ones * zeros))
