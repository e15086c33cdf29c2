"""Lines beyond the detections: rows and columns that were missed wholly, where the picture shows their buttons."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elevator_rectify.core.alignment import Places, joined, undetected
from elevator_rectify.core.config import Config
from elevator_rectify.core.layout import Layout, LayoutFit
from elevator_rectify.core.measured import MeasuredFit, fitted
from elevator_rectify.core.types import IntArray

# At most so many lines are added on each side.
_MOST_LINES = 2
# What lies outside of the detections must be nearer to its place, in half sizes, and more like the others.
_FARTHEST, _LEAST_CORRELATION, _LEAST_SHARE = 0.2, 0.6, 0.8
# Axis (0: rows, 1: columns), and whether the line comes before the first or behind the last.
_SIDES = ((0, True), (0, False), (1, True), (1, False))


def widened(measured: MeasuredFit, config: Config) -> MeasuredFit:
    """Return the fit with lines added where the picture shows buttons beyond the outer ones; itself where not."""
    fit, places = measured.fit, measured.places
    for side in _SIDES:
        for _ in range(_MOST_LINES):
            # In line with the others, or else half a pitch aside, as last rows often are.
            tried = (_with_line(measured, fit, places, *side, stagger) for stagger in (0.0, 1.0))
            found = next((wider for wider in tried if wider is not None), None)
            if found is None:
                break
            fit, places = found
    if fit is measured.fit:
        return measured
    return fitted(fit, places, measured.scatter, measured.view, config, steps=2)


def _with_line(
    measured: MeasuredFit, fit: LayoutFit, places: Places, axis: int, before: bool, stagger: float
) -> tuple[LayoutFit, Places] | None:
    """Return fit and places with one more line, None where the picture shows no button in it."""
    wider, moved, new = _wider(fit, axis, before, stagger)
    view = measured.view
    shown = undetected(wider, new, places, view.template, view.picture, view.window, measured.half)
    off = np.hypot(*(shown.offset / measured.half).T)
    least = max(_LEAST_CORRELATION, _LEAST_SHARE * float(np.median(places.correlation[places.seen])))
    sure = (off < _FARTHEST) & (shown.correlation > least)
    if not sure.any():
        return None
    kept = Places(*(getattr(shown, name)[sure] for name in Places.__dataclass_fields__))
    return replace(wider, node=moved[fit.node]), joined(replace(places, node=moved[places.node]), kept)


def _wider(fit: LayoutFit, axis: int, before: bool, stagger: float) -> tuple[LayoutFit, IntArray, IntArray]:
    """Return the fit with one more line, the new indices of its nodes, and the nodes of the line."""
    layout = fit.layout if axis == 0 else fit.layout.transposed
    ends, shift = (layout.rows[0] - 1.0, layout.rows[-1] + 1.0), int(before)
    at = 0 if before else len(layout.rows)
    longer = Layout(
        np.insert(layout.rows, at, ends[not before]),
        layout.columns,
        np.insert(layout.row_stagger, at, stagger),
        layout.column_stagger,
        tuple(b + shift for b in layout.row_breaks),
        layout.column_breaks,
    )
    row, column = (i + shift * (k == 0) for k, i in enumerate(np.indices((len(layout.rows), len(layout.columns)))))
    line = (np.full(len(layout.columns), at), np.arange(len(layout.columns)))
    if axis == 1:
        longer, row, column, line = longer.transposed, column.T, row.T, line[::-1]
    columns = len(longer.columns)
    return replace(fit, layout=longer), (row * columns + column).ravel(), line[0] * columns + line[1]
