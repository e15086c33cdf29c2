"""From the picture alone to the button: real panels with true boxes, and with our own detector and reader."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from elevator_rectify.benchmark.detector import boxes_of, matched, nearness
from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.no_panel import no_panel_line
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.core import (
    Camera,
    Config,
    Detection,
    GridFit,
    ScaleConfig,
    TargetConfig,
    find_button,
    find_panel,
    fit_panel,
)
from elevator_rectify.core.reading.labels import canonical
from elevator_rectify.core.reading.plates import PLATE
from elevator_rectify.core.reading.target import index_of
from elevator_rectify.core.types import IntArray
from elevator_rectify.train.labelled import LabelledPicture, read_labelled

# The pictures were stretched to a square: the aspect of their pixels is one of the usual ones, unknown which.
ASPECTS = (1.0, 3 / 4, 4 / 3, 9 / 16, 16 / 9)
_FOCAL = 0.9
# Parts without a panel of every held-out picture.
_PARTS = 8
_FEWEST, _LINES, _ABSENT = 6, 2, 5
_NEAR = 0.3
# Annotated where nothing can be read; a small s is a star before the floor.
_UNREAD, _STARRED = ("empty", "blur", "unknown", "-"), re.compile(r"s([0-9A-Z].?)?")
# Lengths in column pitches: a target needs no metres here.
CONFIG = Config(
    scale=ScaleConfig(column_pitch_m=1.0, column_pitch_std_m=0.0), target=TargetConfig(max_lateral_std_m=0.2)
)


@dataclass(frozen=True)
class Panel:
    """One picture: accepted by the guessed aspect, by any of the usual ones; true buttons on cells or off-grid, of all;
    labels right, of; asked for labels that are there: right, wrong, of; for some that are not: answered, of."""

    accepted: bool
    any_aspect: bool
    placed: int
    buttons: int
    labels_right: int
    labels: int
    inferred_wrong: int
    found_right: int
    found_wrong: int
    asked: int
    absent_answered: int
    absent: int


def stretched_camera(aspect: float, side: int) -> Camera:
    """Return the camera of a square picture whose original had that ratio of width to height."""
    longer = max(aspect, 1.0)
    fx, fy = _FOCAL * longer / aspect * side, _FOCAL * longer * side
    middle = (side - 1) / 2
    return Camera.from_matrix([[fx, 0, middle], [0, fy, middle], [0, 0, 1]], side, side)


def first_accepted(picture: LabelledPicture, detections: list[Detection]) -> tuple[GridFit, Camera] | None:
    """Return the fit by the first of the usual aspects by which it is accepted, and that camera; None where none is."""
    for aspect in ASPECTS:
        camera = stretched_camera(aspect, picture.image.shape[1])
        fit = fit_panel(detections, camera, CONFIG, image=picture.image)
        if fit.ok:
            return fit, camera
    return None


def judgeable(picture: LabelledPicture) -> bool:
    """Tell whether there are six buttons in at least two rows and two columns, by the boxes' overlap."""
    boxes = picture.boxes_px[picture.is_button]
    if len(boxes) < _FEWEST:
        return False
    for axis in (0, 1):
        centre = np.sort((boxes[:, axis] + boxes[:, axis + 2]) / 2)
        if 1 + int((np.diff(centre) > 0.5 * np.median(boxes[:, axis + 2] - boxes[:, axis])).sum()) < _LINES:
            return False
    return True


def true_detections(picture: LabelledPicture) -> list[Detection]:
    """Return the buttons' true boxes with their labels, as a perfect detector would."""
    found = []
    for box, label, button in zip(picture.boxes_px, picture.labels, picture.is_button, strict=True):
        if button:
            x0, y0, x1, y1 = (float(v) for v in box)
            text = "" if label in _UNREAD else "*" + label[1:] if _STARRED.fullmatch(label) else label
            found.append(Detection((x0 + x1) / 2 - 0.5, (y0 + y1) / 2 - 0.5, x1 - x0, y1 - y0, text, 1.0))
    return found


def run_panel(task: tuple[str, str, bool]) -> Panel:
    """Fit one picture: (folder, name, with our own detector and reader)."""
    folder, name, own = task
    (picture,) = read_labelled(Path(folder), names=(name,))
    truth = true_detections(picture)
    fits = []
    for aspect in ASPECTS:
        camera = stretched_camera(aspect, picture.image.shape[1])
        by_boxes = None if own else fit_panel(truth, camera, CONFIG, image=picture.image)
        fits.append(by_boxes or find_panel(picture.image, camera, CONFIG))
    fit = fits[0]
    placed = _placed(fit, truth)
    rng = np.random.default_rng([len(truth), int(name)])
    return Panel(
        fit.ok, any(f.ok for f in fits), int((placed >= 0).sum()), len(truth), *_labels(fit, truth, placed),
        _inferred_wrong(fit, truth), *_asked(fit, truth, placed, rng),
    )  # fmt: skip


def _placed(fit: GridFit, truth: list[Detection]) -> IntArray:
    """Return for each true button the place of the fitted panel that holds it, -1 for none."""
    taken = np.full(len(truth), -1)
    if not fit.ok:
        return taken
    places = [k for k, b in enumerate(fit.buttons) if b.state != "empty"]
    at = np.array([fit.buttons[k].image_px for k in places]).reshape(-1, 2) + 0.5
    boxes = boxes_of(truth)
    for k, true in enumerate(matched(nearness(np.concatenate([at, at], axis=1), boxes), 1.0 - _NEAR)):
        if true >= 0:
            taken[true] = places[k]
    return taken


def _labels(fit: GridFit, truth: list[Detection], placed: IntArray) -> tuple[int, int]:
    # What is taken for a label plate has no label of its own.
    read = [k for k, d in enumerate(truth) if d.label and placed[k] >= 0 and fit.buttons[placed[k]].label != PLATE]
    return sum(fit.buttons[placed[k]].label == canonical(truth[k].label) for k in read), len(read)


def _inferred_wrong(fit: GridFit, truth: list[Detection]) -> int:
    """Count the inferred buttons that lie on no true one."""
    inferred = np.array([b.image_px for b in fit.buttons if b.state == "inferred"]).reshape(-1, 2) + 0.5
    if not len(inferred):
        return 0
    return int((nearness(np.concatenate([inferred, inferred], axis=1), boxes_of(truth)).max(axis=1) < 0.5).sum())


def _asked(
    fit: GridFit, truth: list[Detection], placed: IntArray, rng: np.random.Generator
) -> tuple[int, int, int, int, int]:
    there = sorted({canonical(d.label) for d in truth if d.label} - {""})
    # By the label of the true button there; what the annotators could not read (None) is neither right nor wrong.
    labels = {int(placed[k]): canonical(d.label) or None for k, d in enumerate(truth) if placed[k] >= 0}

    def found(name: str) -> str | None:
        """Return what is truly written on the button that is found, '' where there is none, None for no answer."""
        button = find_button(fit, name, CONFIG.target).button
        return None if button is None else labels.get(index_of(fit, button), "")

    answers = [(name, found(name)) for name in there]
    right = sum(answer == name for name, answer in answers)
    wrong = sum(answer is not None and answer != name for name, answer in answers)
    others = rng.choice([str(n) for n in range(1, 60) if str(n) not in there], _ABSENT, replace=False)
    answered = sum(found(str(name)) is not None for name in others)
    return right, wrong, len(there), answered, _ABSENT


HEADER = (
    f"{'':<12}{'panels':>7}{'accepted':>9}{'any aspect':>11}{'placed':>8}{'all placed':>11}{'labels':>8}"
    f"{'false inf.':>11}{'find right':>11}{'wrong %':>9}{'absent %':>9}"
)


def end_to_end_table(folder: Path, figures: Figures, pictures: int = 0, workers: int | None = None) -> str:
    """Return the table over the validation part's panels; pictures: only so many, 0 for all."""
    panels = [p.name for p in read_labelled(folder, validation=True) if judgeable(p)]
    panels = panels[:pictures] if pictures else panels
    lines = [HEADER]
    for name, own in (("true boxes", False), ("own", True)):
        results = parallel(run_panel, [(str(folder), p, own) for p in panels], f"end to end, {name}", workers)
        lines.append(_line(name, results, figures))
    return "\n".join([*lines, no_panel_line(folder, figures, 1 if pictures else _PARTS, workers)])


def _line(name: str, results: list[Panel], figures: Figures) -> str:
    def total(part: str, chosen: list[Panel]) -> int:
        return int(sum(getattr(r, part) for r in chosen))

    def share(part: str, of: str, chosen: list[Panel], better: str = "+") -> float:
        hits, number = total(part, chosen), total(of, chosen)
        figures.share(f"real panels, {name}, {part.replace('_', ' ')}{better}", hits, number)
        return hits / max(1, number)

    good = [r for r in results if r.accepted]
    full = [r.placed == r.buttons for r in good]
    figures.rate(f"real panels, {name}, accepted+", [r.accepted for r in results])
    figures.rate(f"real panels, {name}, accepted with one of five aspects+", [r.any_aspect for r in results])
    figures.rate(f"real panels, {name}, all buttons of the accepted placed+", full)
    return (
        f"{name:<12}{len(results):>7}{len(good) / max(1, len(results)):>9.3f}"
        f"{np.mean([r.any_aspect for r in results]):>11.3f}{share('placed', 'buttons', good):>8.3f}"
        f"{np.mean(full) if full else np.nan:>11.3f}{share('labels_right', 'labels', good):>8.3f}"
        f"{total('inferred_wrong', good) / max(1, len(good)):>11.3f}{share('found_right', 'asked', results):>11.3f}"
        f"{100 * share('found_wrong', 'asked', results, '-'):>9.2f}"
        f"{100 * share('absent_answered', 'absent', results, '-'):>9.2f}"
    )
