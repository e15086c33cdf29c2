"""Fits which empty cells hold a missed button, on real panels with buttons removed; writes core/filled.json."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from elevator_rectify.benchmark.buttons import spoilt_labels
from elevator_rectify.benchmark.missing import CONFIG, Entry, empty_cells, entries, without_some
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.calibrate.logistic import logistic_regression
from elevator_rectify.core.pipeline import fit_panel
from elevator_rectify.core.reading.filled import COEFFICIENTS, FEATURES, features
from elevator_rectify.core.types import Array, Detection

# Shares removed, and how often: a detector misses about a tenth, and often nothing.
_DRAWS = ((0.0, 4), (0.1, 16), (0.2, 8))
# Labels as they are printed, or none, or some unread and misread.
_LABELS = ("printed", "none", "spoilt")
_RIDGE = 10.0
_FOLDS = 8
_LIMITS = (0.8, 0.85, 0.9, 0.95)


@dataclass(frozen=True)
class Cells:
    """Empty cells (N,) of one draw: features (N, F), whether a removed button was there; the panel, how many buttons
    were removed of it, the share, and how its labels were."""

    x: Array
    held: Array
    panel: str
    removed: int
    share: float
    labels: str


def draw(task: tuple[Entry, float, int, str]) -> Cells | None:
    """Remove buttons of one panel: (panel, share, seed, labels); None where the rest is refused."""
    entry, share, seed, labels = task
    left, gone = without_some(entry, share, seed)
    fit = fit_panel(_labelled(replace(entry, detections=tuple(left)), labels, seed), entry.camera, CONFIG)
    if not fit.ok:
        return None
    open_cells, held = empty_cells(fit, gone)
    places = fit.reading.places
    x = features(fit, places, fit.reading.floor_nats, open_cells)
    return Cells(x, held[open_cells].astype(float), entry.name, len(gone), share, labels)


def _labelled(entry: Entry, labels: str, seed: int) -> list[Detection]:
    if labels == "none":
        return [replace(d, label="") for d in entry.detections]
    if labels == "spoilt":
        return spoilt_labels(entry, np.random.default_rng([seed, len(entry.detections)]), informative=seed % 2 == 0)
    return list(entry.detections)


def fitted(cells: list[Cells]) -> tuple[float, Array]:
    """Return the constant and coefficients of the logistic model."""
    X, y = np.concatenate([c.x for c in cells]), np.concatenate([c.held for c in cells])
    mean, std = X.mean(axis=0), np.maximum(X.std(axis=0), 1e-6)
    Z = np.column_stack([np.ones(len(X)), (X - mean) / std])
    beta = logistic_regression(Z, y, np.ones(len(y)), ridge=_RIDGE)
    coefficients = beta[1:] / std
    return float(beta[0] - mean @ coefficients), coefficients


def main(folder: Path, seed: int) -> int:
    """Draw, fit, write the model, and print how well models of other panels tell."""
    if not (folder / "panels_mixed.json").exists():
        print(f"there is no {folder}/panels_mixed.json: the model can be fitted only with it")
        return 1
    panels = entries(folder)
    tasks = [
        (panel, share, seed + n, labels)
        for share, times in _DRAWS
        for n in range(times)
        for panel in panels
        for labels in _LABELS
    ]
    cells = [c for c in parallel(draw, tasks, "removing buttons") if c is not None]
    constant, coefficients = fitted(cells)
    table = {
        "constant": round(constant, 4),
        "coefficients": {name: round(float(c), 4) for name, c in zip(FEATURES, coefficients, strict=True)},
    }
    COEFFICIENTS.write_text(json.dumps(table, indent=2) + "\n")
    print(f"wrote {COEFFICIENTS}\n{cross_validated([p.name for p in panels], cells)}")
    return 0


def cross_validated(names: list[str], cells: list[Cells]) -> str:
    """Return the table of what models of seven eighths of the panels say of the others."""
    fold = dict(zip(names, np.random.default_rng(1).permutation(len(names)) % _FOLDS, strict=True))
    lines = [f"{'labels':<9}{'above':>6}{'recall':>8}{'precision':>11}{'false a panel':>15}{'of intact ones':>16}"]
    models = [fitted([c for c in cells if fold[c.panel] != k]) for k in range(_FOLDS)]
    probability = [_probability(c, *models[fold[c.panel]]) for c in cells]
    for labels in _LABELS:
        for limit in _LIMITS:
            lines.append(_line([(c, p) for c, p in zip(cells, probability, strict=True) if c.labels == labels], limit))
    return "\n".join(lines)


def _probability(cells: Cells, constant: float, coefficients: Array) -> Array:
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(cells.x @ coefficients + constant, -30.0, 30.0))))


def _line(judged: list[tuple[Cells, Array]], limit: float) -> str:
    some = [(c, p > limit) for c, p in judged if c.share == 0.1]
    intact = [(c, p > limit) for c, p in judged if c.share == 0.0]
    removed = sum(c.removed for c, _ in some)
    right = sum(float(c.held[above].sum()) for c, above in some)
    wrong = sum(float((1.0 - c.held[above]).sum()) for c, above in some)
    false_intact = sum(float(above.sum()) for _, above in intact) / len(intact)
    return (
        f"{judged[0][0].labels:<9}{limit:>6.2f}{right / removed:>8.3f}{right / max(1.0, right + wrong):>11.3f}"
        f"{wrong / len(some):>15.3f}{false_intact:>16.3f}"
    )
