"""Lattices found at half their pitch: columns staggered against each other look like twice as many rows, half empty."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elevator_rectify.core.config import JointConfig
from elevator_rectify.core.lattice.layout import Layout, LayoutFit, evaluate, refine_layout
from elevator_rectify.core.lattice.search import with_columns_as_rows
from elevator_rectify.core.types import Array


def coarsened(fit: LayoutFit, rays: Array, sigma: float, area: float, config: JointConfig) -> LayoutFit:
    """Return the fit with twice the pitch along rows or columns where that explains the detections better."""
    fit = _with_coarser_rows(fit, rays, sigma, area, config)
    return with_columns_as_rows(_with_coarser_rows, fit, rays, sigma, area, config)


def _with_coarser_rows(fit: LayoutFit, rays: Array, sigma: float, area: float, config: JointConfig) -> LayoutFit:
    parity = _parities(fit)
    if parity is None:
        return fit
    layout = fit.layout
    rows = layout.rows[0] / 2.0 + np.arange(np.ceil(len(layout.rows) / 2.0))
    wider = Layout(rows, layout.columns, np.zeros(len(rows)), parity)
    pose = replace(
        fit.pose, log_aspect=fit.pose.log_aspect + np.log(2.0), centre=fit.pose.centre * np.array([1.0, 0.5])
    )
    trial = refine_layout(evaluate(pose, wider, rays, sigma, area, config), rays, sigma, area, config, steps=3)
    return trial if trial.log_likelihood > fit.log_likelihood else fit


def _parities(fit: LayoutFit) -> Array | None:
    """Return for each column whether its buttons are in odd rows only, else None; and where there is no such order."""
    layout = fit.layout
    regular = not (layout.row_stagger.any() or layout.column_stagger.any() or layout.row_breaks)
    if not regular or len(layout.rows) < 3 or (np.abs(np.diff(layout.rows) - 1.0) > 1e-6).any():
        return None
    row, column = np.divmod(fit.node[fit.inlier > 0.5], len(layout.columns))
    parity = np.zeros(len(layout.columns))
    for c in range(len(layout.columns)):
        mine = row[column == c] % 2
        if not len(mine) or mine.min() != mine.max():
            return None
        parity[c] = float(mine[0])
    # All odd or all even: every other row is empty, and the first one counts.
    return parity - parity.min() if parity.min() == 0.0 else None
