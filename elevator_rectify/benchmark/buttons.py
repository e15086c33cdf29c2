"""Labels and missing buttons on real panels (outlines with their floors): inferred, corrected, found, or refused."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.real import boxes_to_detections, centred_camera, panel_corner
from elevator_rectify.core.buttons import find_button
from elevator_rectify.core.camera import Camera
from elevator_rectify.core.config import Config, with_values
from elevator_rectify.core.labels import canonical
from elevator_rectify.core.misread import HIGHEST, LOWEST, confusion
from elevator_rectify.core.pipeline import fit_panel
from elevator_rectify.core.types import Detection, GridFit
from elevator_rectify.make_bag import ASSUMED_FOCAL

# The pitch is assumed: only labels are judged here.
_CONFIG = with_values(Config(), {"scale.column_pitch_m": 0.045, "target.max_lateral_std_m": 1.0})
_UNREAD, _MISREAD, _ABSENT = 0.2, 0.1, 0.2
_NEAR = 0.35
_CONSTANT_SCORE = 0.9


@dataclass(frozen=True)
class Entry:
    """A real panel: its name, camera, and buttons with their canonical labels as detections."""

    name: str
    camera: Camera
    detections: tuple[Detection, ...]


def entries(folder: Path) -> list[Entry]:
    """Return the panels whose buttons, all detected, make an accepted fit."""
    table = json.loads((folder / "panels_mixed.json").read_text())
    found = [_entry(name, entry) for name, entry in table.items()]
    return [e for e in found if len(e.detections) >= 6 and fit_panel(list(e.detections), e.camera, _CONFIG).ok]


def _entry(name: str, entry: dict[str, Any]) -> Entry:
    regions = [r for r in entry["regions"] if r["kind"] == "button"]
    camera = centred_camera(panel_corner(entry), ASSUMED_FOCAL)
    boxes = np.array([r["box"] for r in regions]).reshape(-1, 4)
    labels = [canonical(r["text"] or "") for r in regions]
    given = [
        replace(d, label=t, score=_CONSTANT_SCORE) for d, t in zip(boxes_to_detections(boxes), labels, strict=True)
    ]
    return Entry(name, camera, tuple(given))


def is_floor(label: str) -> bool:
    """Tell whether a label is a numbered floor."""
    return label.lstrip("-").isdigit()


@dataclass(frozen=True)
class Inference:
    """Buttons removed from one panel: how many, how many of them inferred, inferred wrongly, and the inferred ones'
    distances in pitches."""

    removed: int
    right: int
    wrong: int
    distances: tuple[float, ...]


def run_removed(task: tuple[Entry, float, int]) -> Inference | None:
    """Remove a share of one panel's buttons (0: none) and infer them from the rest: (panel, share, seed)."""
    entry, share, seed = task
    rng = np.random.default_rng([seed, len(entry.detections), int(1000 * share)])
    keep = rng.random(len(entry.detections)) >= share
    fit = fit_panel([d for d, k in zip(entry.detections, keep, strict=True) if k], entry.camera, _CONFIG)
    if not fit.ok:
        return None
    gone = [d for d, k in zip(entry.detections, keep, strict=True) if not k]
    return _compared(fit, gone)


def _compared(fit: GridFit, gone: list[Detection]) -> Inference:
    """Match inferred buttons and removed ones by their places."""
    inferred = np.array([b.image_px for b in fit.buttons if b.state == "inferred"]).reshape(-1, 2)
    centres = np.array([[d.x_px, d.y_px] for d in gone]).reshape(-1, 2)
    sizes = np.array([np.sqrt(d.width_px * d.height_px) for d in gone])
    distance = np.linalg.norm(inferred[:, None] - centres[None], axis=-1)
    hit = distance < _NEAR * sizes
    steps = np.linalg.norm(np.diff(fit.grid_px, axis=1), axis=-1)
    near = distance.min(axis=1)[hit.any(axis=1)] / float(np.median(steps)) if len(gone) else np.zeros(0)
    return Inference(len(gone), int(hit.any(axis=0).sum()), int((~hit.any(axis=1)).sum()), tuple(near.tolist()))


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
        given.append(replace(d, label=label, score=score if informative else _CONSTANT_SCORE))
    return given


def run_read(task: tuple[Entry, int, bool]) -> Reading | None:
    """Spoil one panel's labels, correct them, and ask for some: (panel, seed, informative scores)."""
    entry, seed, informative = task
    rng = np.random.default_rng([seed, len(entry.detections), informative])
    given = spoilt_labels(entry, rng, informative)
    fit = fit_panel(given, entry.camera, _CONFIG)
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
        choice = find_button(fit, name, _CONFIG.target)
        asked += 1
        if choice.button is not None:
            answered += 1
            right += entry.detections[choice.button.detection].label == name
    others = [str(n) for n in range(-2, 60) if str(n) not in there]
    for name in rng.choice(others, max(1, round(len(there) * _ABSENT / (1.0 - _ABSENT))), replace=False):
        absent += 1
        wrong += find_button(fit, str(name), _CONFIG.target).button is not None
    return asked, answered, right, absent, wrong


def buttons_table(folder: Path, seed: int, repeats: int) -> str:
    """Return the tables of missing buttons and of labels."""
    panels = entries(folder)
    lines = [f"{len(panels)} real panels, each {repeats} times", f"{'removed':<9}{'recall':>8}{'precision':>11}"]
    lines[-1] += f"{'false a panel':>15}{'median distance, pitch':>24}"
    for share in (0.0, 0.1, 0.2, 0.3):
        tasks = [(p, share, seed + n) for n in range(repeats) for p in panels]
        results = [r for r in parallel(run_removed, tasks, f"{share:.0%} removed") if r is not None]
        removed, right, wrong = (sum(getattr(r, name) for r in results) for name in ("removed", "right", "wrong"))
        distances = [d for r in results for d in r.distances]
        lines.append(
            f"{share:<9.0%}{right / max(1, removed):>8.3f}{right / max(1, right + wrong):>11.3f}"
            f"{wrong / len(results):>15.3f}{np.median(distances) if distances else np.nan:>24.4f}"
        )
    for informative in (True, False):
        tasks_read = [(p, seed + n, informative) for n in range(repeats) for p in panels]
        readings = [r for r in parallel(run_read, tasks_read, "labels") if r is not None]
        lines += _reading_lines(readings, "informative" if informative else "constant")
    return "\n".join(lines)


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
