"""Lines beyond the detections: rows and columns that were missed wholly, where the picture shows their buttons."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.config import Config
from elevator_rectify.core.lattice.layout import Layout, LayoutFit
from elevator_rectify.core.picture.alignment import Places, chosen, joined, seen_at
from elevator_rectify.core.picture.measured import MeasuredFit, fitted
from elevator_rectify.core.types import Array, IntArray

# At most so many lines are added on each side.
_MOST_LINES = 2
# What lies outside of the detections must be nearer to its place, in half sizes, and more like the others.
_FARTHEST, _LEAST_CORRELATION, _LEAST_SHARE = 0.2, 0.6, 0.8


@dataclass(frozen=True)
class _Side:
    """A line to come: of axis 0 (rows) or 1 (columns), before the first or behind the last, staggered (1.0) or not."""

    axis: int
    before: bool
    stagger: float = 0.0


# In line with the others; the first and last rows are half a pitch aside on many panels.
_SIDES = (
    *(_Side(axis, before) for axis in (0, 1) for before in (True, False)),
    _Side(0, True, 1.0),
    _Side(0, False, 1.0),
)


def widened(measured: MeasuredFit, config: Config) -> MeasuredFit:
    """Return the fit with lines added where the picture shows buttons beyond the outer ones; itself where not."""
    fit, places = measured.fit, measured.places
    for _ in range(_MOST_LINES):
        sides, points, found = _shown(measured, fit, places)
        if not sides:
            break
        for side in sides:
            wider, moved, _ = _wider(fit, side)
            fit, places = replace(wider, node=moved[fit.node]), replace(places, node=moved[places.node])
        nodes = fit.layout.nodes.reshape(-1, 2)
        node = np.linalg.norm(nodes - points[:, None], axis=-1).argmin(axis=1)
        places = joined(places, replace(found, node=node))
    if fit is measured.fit:
        return measured
    return fitted(fit, places, measured.scatter, measured.view, config, steps=2)


def _shown(measured: MeasuredFit, fit: LayoutFit, places: Places) -> tuple[list[_Side], Array, Places]:
    """Return the lines in which the picture shows buttons, and of these (M,) the lattice points (M, 2) and places."""
    view, new = measured.view, [_points(fit, side) for side in _SIDES]
    points, line = np.concatenate(new), np.repeat(np.arange(len(_SIDES)), [len(n) for n in new])
    names = np.arange(len(points))
    found = seen_at(fit, points, names, places, view.template, view.picture, view.window, view.half)
    least = max(_LEAST_CORRELATION, _LEAST_SHARE * float(np.median(places.correlation[places.seen])))
    sure = (np.hypot(*(found.offset / view.half).T) < _FARTHEST) & (found.correlation > least)
    lines: dict[tuple[int, bool], int] = {}
    for k in np.unique(line[found.node[sure]]).tolist():
        lines.setdefault((_SIDES[k].axis, _SIDES[k].before), k)
    kept = sure & np.isin(line[found.node], list(lines.values()))
    return [_SIDES[k] for k in sorted(lines.values())], points[found.node[kept]], chosen(found, kept)


def _points(fit: LayoutFit, side: _Side) -> Array:
    """Return the lattice points (M, 2) of a line to come."""
    wider, _, new = _wider(fit, side)
    return np.asarray(wider.layout.nodes.reshape(-1, 2)[new])


def _wider(fit: LayoutFit, side: _Side) -> tuple[LayoutFit, IntArray, IntArray]:
    """Return the fit with one more line, the new indices of its nodes, and the nodes of the line."""
    layout = fit.layout if side.axis == 0 else fit.layout.transposed
    shift, at = int(side.before), 0 if side.before else len(layout.rows)
    longer = Layout(
        np.insert(layout.rows, at, layout.rows[0] - 1.0 if side.before else layout.rows[-1] + 1.0),
        layout.columns,
        np.insert(layout.row_stagger, at, side.stagger),
        layout.column_stagger,
        tuple(b + shift for b in layout.row_breaks),
        layout.column_breaks,
    )
    row, column = np.indices((len(layout.rows), len(layout.columns)))
    row, line = row + shift, (np.full(len(layout.columns), at), np.arange(len(layout.columns)))
    if side.axis == 1:
        longer, row, column, line = longer.transposed, column.T, row.T, line[::-1]
    columns = len(longer.columns)
    return replace(fit, layout=longer), (row * columns + column).ravel(), line[0] * columns + line[1]
