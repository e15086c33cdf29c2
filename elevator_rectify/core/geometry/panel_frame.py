"""The panel frame from frame to frame: it stays where it is on the panel while rows and columns come into view or are
hidden."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.types import Array, FitResult

# From one frame to the next the panel moves by less than this share of a pitch before the camera, or it is not told
# which cell is which; cells that are the same are nearer to each other than that one.
_MOVES, _SAME_CELL = 0.35, 0.15


@dataclass(frozen=True)
class PanelFrame:
    """Where on an accepted fit's panel (2,) the frame's origin lies, and the middle of the cells that there were when
    it began, in the fit's unit; since_ns: stamp of the image that it began with."""

    fit: FitResult
    origin: Array
    middle: Array
    since_ns: int


def began(fit: FitResult, stamp_ns: int) -> PanelFrame:
    """Return the frame of an accepted fit by itself: its origin is the centre of cell (0, 0)."""
    return PanelFrame(fit, np.zeros(2), (fit.grid_panel[0, 0] + fit.grid_panel[-1, -1]) / 2.0, stamp_ns)


def followed(last: PanelFrame | None, fit: FitResult, stamp_ns: int) -> PanelFrame:
    """Return the frame of the panel before where the accepted fit surely shows its cells, else a new one."""
    shift = None if last is None or last.fit.metric != fit.metric else _shift(last.fit, fit)
    if last is None or shift is None:
        return began(fit, stamp_ns)
    return replace(last, fit=fit, origin=last.origin + shift, middle=last.middle + shift)


def _shift(last: FitResult, fit: FitResult) -> Array | None:
    """Return how far (2,) the last fit's places are from those with the same coordinates on this one's panel.

    None where it cannot be told. Cells are paired, not measured: what is wrong by a hair does not add up.
    """
    if fit.known is not None:
        return np.zeros(2)
    pitch = float(fit.pitch.min())
    # Where the last origin would be if the camera stood still.
    still = (last.t_camera_panel - fit.t_camera_panel) @ fit.R_camera_panel[:, :2]
    before, now = last.grid_panel.reshape(-1, 2), fit.grid_panel.reshape(-1, 2)
    if np.linalg.norm(still) < _MOVES * pitch and _alike(before, now, _SAME_CELL * pitch):
        return np.zeros(2)
    shifts = now[None] - before[:, None]
    moved = np.linalg.norm(shifts - still, axis=-1)
    # Of the shifts that are near enough the one that brings most cells together; the first of them.
    near = np.argwhere(moved < _MOVES * pitch)
    if not len(near):
        return None
    agree = [int((np.linalg.norm(shifts - shifts[i, j], axis=-1) < _SAME_CELL * pitch).sum()) for i, j in near]
    i, j = near[int(np.argmax(agree))]
    return np.asarray(shifts[i, j])


def _alike(before: Array, now: Array, tolerance: float) -> bool:
    """Tell whether nothing changed, as in nearly every frame: the same cells at the same places (N, 2)."""
    return before.shape == now.shape and bool((np.abs(now - before) < tolerance).all())
