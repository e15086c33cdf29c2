"""Labels of real panels (outlines with their floors): unread, misread, corrected, found, or refused."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.missing import (
    CONFIG,
    CONSTANT_SCORE,
    REMOVED_HEADER,
    Entry,
    Inference,
    entries,
    removed_line,
    run_removed,
)
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.core.pipeline import fit_panel
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.reading.misread import HIGHEST, LOWEST, confusion
from elevator_rectify.core.reading.target import find_button
from elevator_rectify.core.types import Detection

_UNREAD, _MISREAD, _ABSENT = 0.2, 0.1, 0.2


def is_floor(label: str) -> bool:
    """Tell whether a label is a numbered floor."""
    return label.lstrip("-").isdigit()


@dataclass(frozen=True)
class Reading:
    """Numbered floors of one panel with spoilt labels: all, right as read, right afterwards, right made wrong; and
    targets: asked for and there, answered, answered rightly; asked for and not there, answered."""

    floors: int
    before: int
    after: int
    spoilt: int
    asked: int
    answered: int
    right: int
    absent: int
    absent_answered: int


def spoilt_labels(entry: Entry, rng: np.random.Generator, informative: bool) -> list[Detection]:
    """Return the detections with a fifth of the floors unread and a tenth misread; scores tell, or are all the same."""
    given = []
    for d in entry.detections:
        label, chance, good = d.label, rng.random(), True
        if is_floor(label) and LOWEST <= int(label) <= HIGHEST:
            if chance < _UNREAD:
                label = ""
            elif chance < _UNREAD + _MISREAD:
                label, good = str(rng.choice(len(confusion()), p=confusion()[int(label) - LOWEST]) + LOWEST), False
        score = float(np.clip(rng.normal(0.9 if good else 0.65, 0.06 if good else 0.15), 0.05, 1.0))
        given.append(replace(d, label=label, score=score if informative else CONSTANT_SCORE))
    return given


def run_read(task: tuple[Entry, int, bool]) -> Reading | None:
    """Spoil one panel's labels, correct them, and ask for some: (panel, seed, informative scores)."""
    entry, seed, informative = task
    rng = np.random.default_rng([seed, len(entry.detections), informative])
    given = spoilt_labels(entry, rng, informative)
    fit = fit_panel(given, entry.camera, CONFIG)
    if not fit.ok:
        return None
    found = {b.detection: b.label for b in fit.buttons if b.detection >= 0}
    floors = [k for k, d in enumerate(entry.detections) if is_floor(d.label) and k in found]
    truth = [entry.detections[k].label for k in floors]
    before = [given[k].label == t for k, t in zip(floors, truth, strict=True)]
    after = [found[k] == t for k, t in zip(floors, truth, strict=True)]
    spoilt = sum(b and not a for b, a in zip(before, after, strict=True))
    return Reading(len(floors), sum(before), sum(after), spoilt, *_asked(fit, entry, rng))


def _asked(fit: GridFit, entry: Entry, rng: np.random.Generator) -> tuple[int, int, int, int, int]:
    """Ask for labels of the panel, and for floors that it does not have."""
    there = sorted({d.label for d in entry.detections if d.label})
    asked = answered = right = absent = wrong = 0
    for name in there:
        choice = find_button(fit, name, CONFIG.target)
        asked += 1
        if choice.button is not None:
            answered += 1
            right += entry.detections[choice.button.detection].label == name
    others = [str(n) for n in range(-2, 60) if str(n) not in there]
    for name in rng.choice(others, max(1, round(len(there) * _ABSENT / (1.0 - _ABSENT))), replace=False):
        absent += 1
        wrong += find_button(fit, str(name), CONFIG.target).button is not None
    return asked, answered, right, absent, wrong


def buttons_table(folder: Path, seed: int, repeats: int, yardstick: float, figures: Figures) -> str:
    """Return the tables of missing buttons and of labels; yardstick: milliseconds that times are divided by."""
    panels = entries(folder)
    lines = [f"{len(panels)} real panels, each {repeats} times", REMOVED_HEADER]
    for share in (0.0, 0.1, 0.2, 0.3):
        tasks = [(p, share, seed + n) for n in range(repeats) for p in panels]
        results = parallel(run_removed, tasks, f"{share:.0%} removed")
        lines.append(removed_line(results, share))
        _record_removed(figures, results, f"outlined panels, {share:.0%} removed,")
    for informative in (True, False):
        tasks_read = [(p, seed + n, informative) for n in range(repeats) for p in panels]
        readings = [r for r in parallel(run_read, tasks_read, "labels") if r is not None]
        scores = "informative" if informative else "constant"
        lines += _reading_lines(readings, scores)
        _record_read(figures, readings, f"outlined panels, scores {scores},")
    return "\n".join([*lines, "\n" + _time_line(panels, seed, yardstick)])


def _record_removed(figures: Figures, results: list[Inference], name: str) -> None:
    judged = [r for r in results if r.accepted]
    removed, right, wrong = (sum(getattr(r, part) for r in judged) for part in ("removed", "right", "wrong"))
    figures.share(f"{name} accepted+", len(judged), len(results))
    figures.share(f"{name} recall+", right, removed)
    figures.share(f"{name} precision+", right, right + wrong)


def _record_read(figures: Figures, readings: list[Reading], name: str) -> None:
    def total(part: str) -> int:
        return int(sum(getattr(r, part) for r in readings))

    figures.share(f"{name} floors right+", total("after"), total("floors"))
    figures.share(f"{name} right ones made wrong-", total("spoilt"), total("floors"))
    figures.share(f"{name} asked and answered+", total("answered"), total("asked"))
    figures.share(f"{name} answers right+", total("right"), total("answered"))
    figures.share(f"{name} answered though absent-", total("absent_answered"), total("absent"))


def _time_line(panels: list[Entry], seed: int, yardstick: float) -> str:
    """Return how long labels, missing buttons and all that `fit.buttons` has take, of panels with spoilt labels."""
    times = []
    for number, entry in enumerate(panels):
        fit = fit_panel(spoilt_labels(entry, np.random.default_rng([seed, number]), True), entry.camera)
        # A fit keeps what it was asked for: every copy is asked anew.
        for copy in [replace(fit) for _ in range(5)]:
            start = time.perf_counter()
            _ = copy.buttons
            times.append(1e3 * (time.perf_counter() - start) / yardstick)
    return f"buttons and labels of a panel take {np.median(times):.2f} yardsticks, p95 {np.percentile(times, 95):.2f}"


def _reading_lines(readings: list[Reading], scores: str) -> list[str]:
    def total(name: str) -> int:
        return int(sum(getattr(r, name) for r in readings))

    floors, asked, absent = total("floors"), total("asked"), total("absent")
    return [
        f"\nscores {scores}: {floors} numbered floors, right {total('before') / floors:.3f} as read, "
        f"{total('after') / floors:.3f} corrected; right ones made wrong {100.0 * total('spoilt') / floors:.2f} %",
        f"asked for {asked} labels that are there: answered {total('answered') / asked:.3f}, of the answers right "
        f"{total('right') / max(1, total('answered')):.4f}; for {absent} that are not: answered "
        f"{100.0 * total('absent_answered') / absent:.2f} %",
    ]
