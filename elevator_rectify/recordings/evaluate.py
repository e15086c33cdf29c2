"""Compares a fit with the truth."""

from __future__ import annotations

import numpy as np

from elevator_rectify.core.types import Array, IntArray

# A detection belongs to a grid centre or a true button within this share of the grid's local pitch.
_NEAR_PITCH = 0.35


def right_cells(detections_px: Array, grid_px: Array, buttons_px: Array, true_cells: IntArray) -> float:
    """Return the share of detected true buttons whose grid cell is right relative to the others of their block.

    detections_px: (N, 2); grid_px: (rows, columns, 2) fitted; buttons_px: (M, 2) true; true_cells: (M, 3) column, row,
    block. Cells are relative: each block may be shifted as a whole.
    """
    pitch = _local_pitch(grid_px)
    button, button_px = _nearest(detections_px, buttons_px)
    cell, cell_px = _nearest(detections_px, grid_px.reshape(-1, 2))
    limit = _NEAR_PITCH * pitch[cell]
    real = button_px < limit
    if not real.any():
        return float("nan")
    placed = real & (cell_px < limit)
    row, column = np.divmod(cell, grid_px.shape[1])
    offsets = np.column_stack([column, row]) - true_cells[button, :2]
    blocks = true_cells[button, 2]
    right = sum(_most_common(offsets[placed & (blocks == block)]) for block in np.unique(blocks[real]))
    return float(right / real.sum())


def cells_right(cells: IntArray, true_cells: IntArray, blocks: IntArray) -> float:
    """Return the share of true buttons in the right relative cell. cells: (N, 2) fitted, -1 for outliers."""
    placed = cells[:, 0] >= 0
    offsets = cells - true_cells
    return float(
        sum(_most_common(offsets[placed & (blocks == block)]) for block in np.unique(blocks)) / max(1, len(cells))
    )


def _most_common(rows: IntArray) -> int:
    return int(np.unique(rows, axis=0, return_counts=True)[1].max()) if len(rows) else 0


def _nearest(points: Array, targets: Array) -> tuple[IntArray, Array]:
    distance = np.linalg.norm(points[:, None] - targets[None], axis=2)
    return distance.argmin(axis=1), distance.min(axis=1)


def _local_pitch(grid_px: Array) -> Array:
    """Return the distance of each grid centre (flattened) to its nearest neighbour."""
    flat = grid_px.reshape(-1, 2)
    distance = np.linalg.norm(flat[:, None] - flat[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    return np.asarray(distance.min(axis=1))
