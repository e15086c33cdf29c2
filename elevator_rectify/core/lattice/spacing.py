"""Lines that are evenly spaced in the picture are no tilted panel's: its gaps would have to undo the perspective."""

from __future__ import annotations

import numpy as np

from elevator_rectify.core.types import Array, FitResult

# So many gaps tell; evenly spaced: to this coefficient of variation in the picture, or to that with lines left out
# between; of so much more on the panel. No accepted fit of 185 to turned real panels is like that, of those to
# trapezoids that face the camera nine in ten are.
_GAPS, _EVEN, _EVEN_WITHOUT, _UNEVEN = 3, 0.08, 0.05, 0.12


def undone_perspective(fit: FitResult) -> str:
    """Return why the fit's rows or columns cannot be a panel's, '' where they can.

    The picture shows them evenly spaced, although the panel is tilted and its gaps differ.
    """
    for axis, lines, name in ((0, fit.row_positions, "rows"), (1, fit.column_positions, "columns")):
        used = np.flatnonzero(np.bincount(fit.cells[fit.cells[:, 0] >= 0, axis]))
        if len(used) <= _GAPS:
            continue
        along = np.nanmean(np.moveaxis(fit.grid_px, axis, 0)[used], axis=1)
        seen, panel = np.linalg.norm(np.diff(along, axis=0), axis=1), np.diff(lines[used])
        whole = np.round(seen / seen.min())
        for share, limit in ((np.ones(len(seen)), _EVEN), (whole, _EVEN_WITHOUT)):
            if _variation(seen / share) < limit and _variation(panel / share) > _UNEVEN:
                return f"the {name} are evenly spaced in the picture: a tilted panel's gaps would have to undo that"
    return ""


def _variation(values: Array) -> float:
    """Return the coefficient of variation."""
    return float(values.std() / values.mean())
