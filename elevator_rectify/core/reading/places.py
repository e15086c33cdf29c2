"""The places of a fitted panel where buttons are or may be: its cells, and detections beside them on the same plane."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from elevator_rectify.core.geometry.pose import on_plane
from elevator_rectify.core.reading.labels import canonical
from elevator_rectify.core.types import Array, BoolArray, Detection, FitResult, IntArray, KnownPanel

# A detection so far from the outer lines, in pitches, is of something else than the panel.
_REACH = 2.0
# Buttons so near to each other, in pitches, are one.
_SAME_PLACE = 0.6
# So near to a row or column, in pitches, it belongs to that.
_IN_LINE = 0.35
# A button's height over the usual one.
_SMALLEST, _LARGEST = 0.5, 2.0


@dataclass(frozen=True)
class PanelPlaces:
    """K places: rows x columns cells row by row, then the detections beside them.

    line: (K, 2) row and column counted from the upper left, of the others the nearest ones or a half between; at:
    (K, 2) the same as places, half a line further where staggered. panel: (K, 2) in the panel frame, in the fit's
    unit. detection: (K,) that stands for each, -1 for none; label, read: (K,) canonical and as written, '' for none;
    score: (K,); readings: (K,) all labels that were read with their probabilities, () where only `label` is known.
    shown: (K,) whether the picture shows a button there; taken: (K,) empty cells that overlap with a detection beside
    them; beyond: (K,) cells half a pitch outside of the grid's box.
    """

    cells: int
    line: Array
    at: Array
    panel: Array
    detection: IntArray
    label: tuple[str, ...]
    read: tuple[str, ...]
    score: Array
    shown: BoolArray
    taken: BoolArray
    beyond: BoolArray
    readings: tuple[tuple[tuple[str, float], ...], ...] = ()

    def read_at(self, k: int) -> tuple[tuple[str, float], ...]:
        """Return what was read at place k as a distribution, () where only its label is known."""
        return self.readings[k] if self.readings else ()

    @cached_property
    def filled(self) -> BoolArray:
        """Return (K,) where a button was detected, or is shown by the picture."""
        return np.asarray((self.detection >= 0) | self.shown)


def known_index(fit: FitResult, known: KnownPanel) -> IntArray:
    """Return (K,) the places of a taught panel's buttons, in the order of `known_places`."""
    beside = known.cells[:, 0] < 0
    behind = fit.rows * fit.columns + np.cumsum(beside) - 1
    return np.asarray(np.where(beside, behind, known.cells @ np.array([fit.columns, 1])))


def known_places(fit: FitResult, known: KnownPanel) -> PanelPlaces:
    """Return the places of a fit to a taught panel: its cells, then its buttons beside them."""
    cells, place_of = fit.grid_panel.reshape(-1, 2), known_index(fit, known)
    panel = np.concatenate([cells, np.zeros((int((known.cells[:, 0] < 0).sum()), 2))])
    # The panel's places in the fit's unit.
    panel[place_of] = known.places * (fit.pitch / known.pitch)
    detection = np.full(len(panel), -1, dtype=np.int64)
    for k in reversed(_ranked(fit)):
        if fit.matched[k] >= 0:
            detection[place_of[fit.matched[k]]] = k
    shown, label = np.zeros(len(panel), dtype=bool), [""] * len(panel)
    shown[place_of] = fit.shown
    for k, place in enumerate(place_of):
        label[place] = known.labels[k]
    given = [fit.detections[k] if k >= 0 and fit.detections else None for k in detection.tolist()]
    line, at = _lines(fit, panel[len(cells) :])
    none = np.zeros(len(panel), dtype=bool)
    return PanelPlaces(
        cells=len(cells),
        line=line,
        at=at,
        panel=panel,
        detection=detection,
        label=tuple(label),
        read=tuple(d.label if d is not None else "" for d in given),
        score=np.array([_score(d) for d in given]),
        shown=shown,
        taken=none,
        beyond=none,
        readings=tuple(readings_of(d) for d in given),
    )


def places_of(fit: FitResult) -> PanelPlaces:
    """Return the places of a fit that has a grid."""
    if fit.known is not None:
        return known_places(fit, fit.known)
    ranked, cells = _ranked(fit), fit.grid_panel.reshape(-1, 2)
    detection = _in_cells(fit, ranked)
    beside, panel = _beside(fit, detection >= 0, ranked)
    taken = (_distances(fit, cells, panel) < _SAME_PLACE).any(axis=1) & (detection < 0)
    shown = np.zeros(len(cells), dtype=bool)
    if fit.measurement is not None:
        shown = np.isfinite(fit.measurement.correlation).ravel()
    detection = np.concatenate([detection, beside])
    given = [fit.detections[k] if k >= 0 and fit.detections else None for k in detection.tolist()]
    for (row, column), button in fit.undetected.items():
        place = row * fit.columns + column
        if detection[place] < 0 and shown[place]:
            given[place], shown[place] = button, button is not None
    line, at = _lines(fit, panel)
    none = np.zeros(len(beside), dtype=bool)
    return PanelPlaces(
        cells=len(cells),
        line=line,
        at=at,
        panel=np.concatenate([cells, panel]),
        detection=detection,
        label=tuple(canonical(d.label) if d is not None else "" for d in given),
        read=tuple(d.label if d is not None else "" for d in given),
        score=np.array([_score(d) for d in given]),
        shown=np.concatenate([shown, none]),
        taken=np.concatenate([taken, none]),
        beyond=np.concatenate([_beyond(fit).ravel(), none]),
        readings=tuple(readings_of(d) for d in given),
    )


def readings_of(detection: Detection | None) -> tuple[tuple[str, float], ...]:
    """Return the canonical labels that were read, each once, with their probabilities."""
    found: dict[str, float] = {}
    for text, p in () if detection is None else detection.readings:
        if (label := canonical(text)) and 0.0 < p <= 1.0:
            found[label] = found.get(label, 0.0) + float(p)
    total = max(1.0, sum(found.values()))
    return tuple((label, p / total) for label, p in sorted(found.items(), key=lambda item: -item[1]))


def _in_cells(fit: FitResult, ranked: list[int]) -> IntArray:
    """Return (R C,) the detection that stands for each cell, -1 for none."""
    detection = np.full(fit.rows * fit.columns, -1, dtype=np.int64)
    for k in reversed(ranked):
        if fit.cells[k, 0] >= 0:
            detection[fit.cells[k, 0] * fit.columns + fit.cells[k, 1]] = k
    return detection


def _ranked(fit: FitResult) -> list[int]:
    """Return the detections, those with a label and of higher score first."""
    if not fit.detections:
        return list(range(len(fit.cells)))
    key = [(not canonical(d.label), -_score(d), k) for k, d in enumerate(fit.detections)]
    return [k for *_, k in sorted(key)]


def _score(detection: Detection | None) -> float:
    return float(detection.score) if detection is not None and math.isfinite(detection.score) else 0.0


def _beside(fit: FitResult, filled: BoolArray, ranked: list[int]) -> tuple[IntArray, Array]:
    """Return the detections (L,) on the panel's plane, beside its cells but of its buttons' size, and (L, 2) where.

    filled (R C,): cells with a detection.
    """
    out = np.array([k for k in ranked if fit.detections and fit.cells[k, 0] < 0], dtype=np.int64)
    if not len(out):
        return out, np.zeros((0, 2))
    panel, depth = on_plane(fit.R_camera_panel, fit.t_camera_panel, fit.rays[out])
    box = fit.grid_panel.reshape(-1, 2)
    with np.errstate(invalid="ignore"):
        inside = (panel > box.min(axis=0) - _REACH * fit.pitch) & (panel < box.max(axis=0) + _REACH * fit.pitch)
        keep = inside.all(axis=1) & (depth > 0) & _usual_size(fit, out, depth)
    keep[keep] &= (_distances(fit, panel[keep], box[filled]) >= _SAME_PLACE).all(axis=1)
    index: list[int] = []
    for k in np.flatnonzero(keep).tolist():
        if (_distances(fit, panel[[k]], panel[index]) >= _SAME_PLACE).all():
            index.append(k)
    return out[index], panel[index]


def _usual_size(fit: FitResult, index: IntArray, depth: Array) -> BoolArray:
    """Tell which detections, at their depths, are about as large as the grid's buttons; all where sizes are unknown."""
    size = np.sqrt([max(0.0, d.width_px * d.height_px) for d in fit.detections])
    on = fit.cells[:, 0] >= 0
    usual = np.median(size[on] * fit.grid_points[fit.cells[on, 0], fit.cells[on, 1], 2])
    ratio = size[index] * depth / max(float(usual), 1e-12)
    return np.asarray((size[index] <= 0) | (usual <= 0) | ((ratio > _SMALLEST) & (ratio < _LARGEST)))


def _distances(fit: FitResult, one: Array, other: Array) -> Array:
    """Return the distances (N, M) of places on the panel in pitches."""
    return np.asarray(np.linalg.norm((one[:, None] - other[None]) / fit.pitch, axis=-1))


def _lines(fit: FitResult, panel: Array) -> tuple[Array, Array]:
    """Return line and at (K, 2) of the cells and of places (L, 2) beside them."""
    row, column = np.divmod(np.arange(fit.rows * fit.columns), fit.columns)
    cells = np.column_stack([row, column]).astype(float)
    at = cells + 0.5 * np.column_stack([fit.column_staggered[column], fit.row_staggered[row]])
    beside = [
        _index(panel[:, axis] / fit.pitch[axis], lines)
        for axis, lines in ((1, fit.row_positions), (0, fit.column_positions))
    ]
    between = np.column_stack(beside)
    nearest = np.round(between)
    line = np.where(np.abs(between - nearest) < _IN_LINE, nearest, np.floor(between) + 0.5)
    return np.concatenate([cells, line]), np.concatenate([at, between])


def _index(place: Array, lines: Array) -> Array:
    """Return places in pitches as fractional numbers of lines, which ascend; beyond the outer ones in pitches."""
    inside = np.interp(place, lines, np.arange(len(lines), dtype=float))
    return np.asarray(inside + np.minimum(place - lines[0], 0.0) + np.maximum(place - lines[-1], 0.0))


def _beyond(fit: FitResult) -> BoolArray:
    """Return (rows, columns) True for the last cells of staggered lines: half a pitch outside of the box."""
    last = np.zeros((fit.rows, fit.columns), dtype=bool)
    if fit.row_staggered.any() and not fit.row_staggered.all():
        last[fit.row_staggered, -1] = True
    if fit.column_staggered.any() and not fit.column_staggered.all():
        last[-1, fit.column_staggered] = True
    return last
