"""Lattices that are too coarse: where the picture shows buttons half-way between, there are twice as many lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elevator_rectify.core.lattice.layout import LayoutFit
from elevator_rectify.core.picture.alignment import Places, undetected
from elevator_rectify.core.picture.patches import Picture, Window
from elevator_rectify.core.picture.template import Template
from elevator_rectify.core.types import Array, IntArray

# So large a share of the places half-way between must be buttons. The more detections, the less they all skip lines.
_SHARE, _MOST_BUTTONS = 0.6, 16
# Plates with the labels lie there too: buttons look like each other as much as this share of the usual correlation.
_ALIKE = 0.85


def halved(
    fit: LayoutFit, places: Places, template: Template, picture: Picture, window: Window, half: Array
) -> LayoutFit | None:
    """Return the fit with twice as many rows or columns, None where there are none between the known ones."""
    layout = fit.layout
    if len(places.node) > _MOST_BUTTONS:
        return None
    for axis in (1, 0):
        lines, breaks = ((layout.columns, layout.column_breaks), (layout.rows, layout.row_breaks))[axis]
        # Staggered columns become whole rows; staggered rows stay what they are.
        if (
            breaks
            or (layout.column_stagger, layout.row_stagger)[axis].any()
            or (np.abs(np.diff(lines) - 1) > 1e-6).any()
        ):
            continue
        finer, old = _finer(fit, axis)
        between = np.setdiff1d(np.arange(finer.layout.nodes.size // 2), old)
        narrower = Window(_narrow(window.half, axis), window.samples)
        shown = undetected(finer, between, places, template, picture, narrower, _narrow(half, axis))
        alike = shown.correlation > _ALIKE * float(np.median(places.correlation))
        if alike.sum() >= max(2.0, _SHARE * len(between)):
            return finer
    return None


def _finer(fit: LayoutFit, axis: int) -> tuple[LayoutFit, IntArray]:
    """Return the same plane with lines between the rows (axis 1) or columns (0), and the new indices of the nodes."""
    pose, layout = fit.pose, fit.layout
    lines, stagger = ((layout.columns, layout.row_stagger), (layout.rows, layout.column_stagger))[axis]
    doubled = 2.0 * lines[0] + np.arange(2.0 * len(lines) - 1.0 + float(stagger.any()))
    scale = np.where(np.arange(2) == axis, 2.0, 1.0)
    r, c = np.indices((len(layout.rows), len(layout.columns)))
    if axis == 1:
        old = (2 * r + layout.column_stagger.astype(int)) * len(layout.columns) + c
        layout = replace(
            layout, rows=doubled, row_stagger=np.zeros(len(doubled)), column_stagger=0.0 * layout.column_stagger
        )
        pose = replace(pose, log_aspect=pose.log_aspect - np.log(2.0), centre=pose.centre * scale)
    else:
        old = r * len(doubled) + 2 * c + layout.row_stagger.astype(int)[:, None]
        layout = replace(
            layout, columns=doubled, column_stagger=np.zeros(len(doubled)), row_stagger=0.0 * layout.row_stagger
        )
        pose = replace(pose, t=pose.t * 2.0, log_aspect=pose.log_aspect + np.log(2.0), centre=pose.centre * scale)
    return replace(fit, pose=pose, layout=layout, node=old.ravel()[fit.node]), old.ravel()


def _narrow(half: Array, axis: int) -> Array:
    """Return a half size in the finer lattice's pitches."""
    return np.asarray(half * np.where(np.arange(2) == axis, 2.0, 1.0))
