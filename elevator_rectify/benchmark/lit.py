"""Whether a lamp is lit, told by a single picture: the lamps of real panels, marked by eye."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from elevator_rectify.benchmark.end_to_end import first_accepted, true_detections
from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.lamps import area_under_curve
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.reader import calibration_error
from elevator_rectify.core.lamps.lit import lit_log_odds, lit_probability, said
from elevator_rectify.core.lamps.patches import Patches, patches_of
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.types import Array, BoolArray, IntArray
from elevator_rectify.train.labelled import is_validation, read_labelled
from elevator_rectify.train.lit_marks import Marks, read_marks

_SIZES_PX = (0.0, 14.0, 20.0, 30.0, np.inf)


def marked_names(validation: bool) -> list[str]:
    """Return the names of the pictures that were looked at, of one part."""
    return [name for name in read_marks() if is_validation(name) == validation]


def truth_of(fit: GridFit, marks: Marks) -> IntArray:
    """Return of each detected button of a fit to the true boxes (K,) 1 where it is lit, 0 where not, -1 unsure."""
    indices = [b.detection for b in fit.buttons if b.detection >= 0]
    return np.array([-1 if k in marks.unsure else int(k in marks.lit) for k in indices], dtype=np.int64)


@dataclass(frozen=True)
class Told:
    """What is said of the buttons (K,) of one picture: log odds, truth, size in pixels and label."""

    odds: Array
    lit: BoolArray
    side_px: Array
    labels: tuple[str, ...]


def told(task: tuple[str, str]) -> Told | None:
    """Return what is said of the marked buttons of one picture, None where it is refused: (folder, name)."""
    (picture,) = read_labelled(Path(task[0]), names=(task[1],))
    accepted = first_accepted(picture, true_detections(picture))
    if accepted is None:
        return None
    fit, camera = accepted
    patches: Patches = patches_of(picture.image, camera, fit, fit.buttons)
    truth = truth_of(fit, read_marks()[task[1]])
    sure = truth >= 0
    labels = tuple(label for label, known in zip(patches.labels, sure, strict=True) if known)
    return Told(lit_log_odds(patches)[sure], truth[sure] > 0, patches.side_px[sure], labels)


def lit_table(folder: Path, figures: Figures) -> str:
    """Return the table over the validation part."""
    several = [t for t in parallel(told, [(str(folder), name) for name in marked_names(True)], "lit") if t]
    lit, side_px = (np.concatenate([getattr(t, part) for t in several]) for part in ("lit", "side_px"))
    p = np.concatenate([lit_probability(t.odds, t.labels) for t in several])
    seen = np.isfinite(p)
    answer = np.array([said(value) for value in p])
    title = f"buttons of {len(several)} real panels"
    lines = [f"{title:<28}{'':>8}{'yes':>8}{'no':>8}{'unseen':>8}"]
    for low, high in pairwise(_SIZES_PX):
        for name, is_so in (("lit", lit), ("dark", ~lit)):
            lines.append(
                _line(f"{name}, {low:.0f} to {high:.0f} px", answer[is_so & (low <= side_px) & (side_px < high)])
            )
    for name, is_so in (("lit", lit), ("dark", ~lit)):
        lines.append(_line(name, answer[is_so]))
        wrong = "no" if name == "lit" else "yes"
        figures.rate(f"lit, {name} told as the other-", list(answer[is_so] == wrong))
    right = [_share(lit[answer == "yes"]), _share(~lit[answer == "no"])]
    lines.append(
        f"area under the curve {area_under_curve(p[seen], lit[seen]):.3f}, calibration error "
        f"{calibration_error(p[seen], lit[seen].astype(float)):.3f}; right of yes {right[0]:.3f}, of no {right[1]:.3f}"
    )
    return "\n".join(lines)


def _line(name: str, answer: Array) -> str:
    shares = "".join(f"{_share(answer == word):>8.3f}" for word in ("yes", "no", "unseen"))
    return f"{name:<28}{len(answer):>8}{shares}"


def _share(which: BoolArray) -> float:
    return float(which.mean()) if len(which) else float("nan")
