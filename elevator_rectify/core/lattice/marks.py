"""A mark beside every button, a label plate or braille, doubles the grid: every second line has smaller boxes."""

from __future__ import annotations

import numpy as np

from elevator_rectify.core.geometry.pose import on_plane
from elevator_rectify.core.types import Array, BoolArray, FitResult, IntArray

# Smaller than a button by this in ln size (six tenths of it) is a mark; of nearly its size is a plate with the label,
# or the button beside one.
MARK = 0.5
# So many lines at least, in which boxes on every second line are smaller by this in ln size. Of 200 real panels one is
# like that, and it has a plate beside every button.
_LINES, _SMALLER = 3, 0.25
# So large a share of the detections are small; this quantile of all sizes is a button's.
_MARKS_SHARE, _OF_BUTTONS = 0.3, 0.75


def second_lines(fit: FitResult, index: IntArray, log_sizes: Array) -> tuple[BoolArray, float]:
    """Return which of the usable detections (M,) are on every second line of a fit, accepted or refused, with smaller
    boxes than on the lines between, and by how much in ln size; none, and 0, where it is not so.

    index: (M,) into the fit's cells; log_sizes: (M,) ln of the boxes' linear size, NaN where it is unknown.
    """
    cells = fit.cells[index]
    on = (cells[:, 0] >= 0) & np.isfinite(log_sizes)
    found = np.zeros(len(index), dtype=bool)
    if not on.any():
        return found, 0.0
    # The same size on a tilted plane is seen with an area that falls with the cube of its depth.
    size = log_sizes[on] + 1.5 * np.log(fit.grid_points[cells[on, 0], cells[on, 1], 2])
    for axis in (0, 1):
        lines, line = np.unique(cells[on, axis], return_inverse=True)
        usual = np.array([np.median(size[line == k]) for k in range(len(lines))])
        for second in (0, 1):
            small, large = usual[second::2], usual[1 - second :: 2]
            if len(lines) >= _LINES and small.max() < large.min() - _SMALLER:
                found[np.flatnonzero(on)] = line % 2 == second
                return found, float(np.median(large) - np.median(small))
    return found, 0.0


def marks_as_before(previous: FitResult, rays: Array, log_sizes: Array) -> BoolArray:
    """Return which of the usable detections, rays (M, 2), are marks by their size where the frame before left as many
    out; none where it did not."""
    if not previous.ok or (previous.cells[:, 0] < 0).mean() < _MARKS_SHARE:
        return np.zeros(len(rays), dtype=bool)
    depth = on_plane(previous.R_camera_panel, previous.t_camera_panel, rays)[1]
    size = log_sizes + 1.5 * np.log(np.maximum(depth, 1e-9))
    if not np.isfinite(size).any():
        return np.zeros(len(rays), dtype=bool)
    small = size < np.nanquantile(size, _OF_BUTTONS) - MARK
    return np.asarray(small & (small.mean() >= _MARKS_SHARE))
