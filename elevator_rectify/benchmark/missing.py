"""Buttons removed from real panels (outlines with their floors), and which of them are inferred from the rest."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from elevator_rectify.benchmark.real import boxes_to_detections, panel_size
from elevator_rectify.core.config import Config, with_values
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.pipeline import fit_panel
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.reading.labels import canonical
from elevator_rectify.core.types import Array, BoolArray, Detection, IntArray
from elevator_rectify.recordings.make_bag import photograph_camera

# The pitch is assumed: only labels are judged here.
CONFIG = with_values(Config(), {"scale.column_pitch_m": 0.045, "target.max_lateral_std_m": 1.0})
CONSTANT_SCORE = 0.9
# A place is a button's where it is nearer to its centre than this share of its size.
_NEAR = 0.35


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
    return [e for e in found if len(e.detections) >= 6 and fit_panel(list(e.detections), e.camera, CONFIG).ok]


def _entry(name: str, entry: dict[str, Any]) -> Entry:
    regions = [r for r in entry["regions"] if r["kind"] == "button"]
    camera = photograph_camera(panel_size(entry), None)
    boxes = np.array([r["box"] for r in regions]).reshape(-1, 4)
    labels = [canonical(r["text"] or "") for r in regions]
    given = [replace(d, label=t, score=CONSTANT_SCORE) for d, t in zip(boxes_to_detections(boxes), labels, strict=True)]
    return Entry(name, camera, tuple(given))


@dataclass(frozen=True)
class Inference:
    """Buttons removed from one panel: how many, how many of them inferred, inferred wrongly, the inferred ones'
    distances in pitches; whether the rest was accepted."""

    removed: int
    right: int
    wrong: int
    distances: tuple[float, ...]
    accepted: bool


def without_some(entry: Entry, share: float, seed: int) -> tuple[list[Detection], list[Detection]]:
    """Return the detections that are left where a share of them is removed at random, and the removed ones."""
    rng = np.random.default_rng([seed, len(entry.detections), int(1000 * share)])
    keep = rng.random(len(entry.detections)) >= share
    left = [d for d, k in zip(entry.detections, keep, strict=True) if k]
    return left, [d for d, k in zip(entry.detections, keep, strict=True) if not k]


def run_removed(task: tuple[Entry, float, int]) -> Inference:
    """Remove a share of one panel's buttons (0: none) and infer them from the rest: (panel, share, seed)."""
    entry, share, seed = task
    left, gone = without_some(entry, share, seed)
    fit = fit_panel(left, entry.camera, CONFIG)
    if not fit.ok:
        return Inference(len(gone), 0, 0, (), False)
    inferred = np.array([b.image_px for b in fit.buttons if b.state == "inferred"]).reshape(-1, 2)
    hit, distance = near(inferred, gone)
    steps = np.linalg.norm(np.diff(fit.grid_px, axis=1), axis=-1)
    found = distance.min(axis=1)[hit.any(axis=1)] / float(np.median(steps)) if len(gone) else np.zeros(0)
    return Inference(len(gone), int(hit.any(axis=0).sum()), int((~hit.any(axis=1)).sum()), tuple(found.tolist()), True)


def near(places_px: Array, gone: list[Detection]) -> tuple[BoolArray, Array]:
    """Return (N, M) which places are those of removed buttons, and the distances in pixels."""
    centres = np.array([[d.x_px, d.y_px] for d in gone]).reshape(-1, 2)
    sizes = np.array([np.sqrt(d.width_px * d.height_px) for d in gone])
    distance = np.linalg.norm(places_px[:, None] - centres[None], axis=-1)
    return distance < _NEAR * sizes, distance


def removed_line(results: list[Inference], share: float) -> str:
    """Return one line of the table of removed buttons."""
    judged = [r for r in results if r.accepted]
    removed, right, wrong = (sum(getattr(r, name) for r in judged) for name in ("removed", "right", "wrong"))
    distances = [d for r in judged for d in r.distances]
    return (
        f"{share:<9.0%}{len(judged) / len(results):>9.3f}{right / max(1, removed):>8.3f}"
        f"{right / max(1, right + wrong):>11.3f}{wrong / max(1, len(judged)):>15.3f}"
        f"{np.median(distances) if distances else np.nan:>24.4f}"
    )


REMOVED_HEADER = (
    f"{'removed':<9}{'accepted':>9}{'recall':>8}{'precision':>11}{'false a panel':>15}{'median distance, pitch':>24}"
)


def empty_cells(fit: GridFit, gone: list[Detection]) -> tuple[IntArray, BoolArray]:
    """Return the cells (E,) of an accepted fit that may hold a missed button, and (R C,) where a removed one was."""
    places = fit.reading.places
    empty = np.flatnonzero(~(places.filled | places.taken | places.beyond)[: places.cells])
    return empty, np.asarray(near(fit.grid_px.reshape(-1, 2), gone)[0].any(axis=1))
