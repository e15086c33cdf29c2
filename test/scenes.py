"""Panels of known truth for the tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from elevator_rectify.core import Camera, KnownPanel
from elevator_rectify.core.geometry.rotations import rotation_angle_rad
from elevator_rectify.core.reading import reader
from elevator_rectify.core.types import Array, Image
from elevator_rectify.render.panel import PITCH_M, Panel, regular_panel
from elevator_rectify.render.scene import PAPER_K, DetectorModel, Scene, Viewpoint, make_scene, paper_camera

DISTORTED = {
    "plumb_bob": [-0.28, 0.07, 0.0005, -0.0004, 0.0],
    "rational_polynomial": [0.2, 0.01, 0.0002, 0.0001, 0.002, 0.5, 0.06, 0.004],
    "equidistant": [-0.02, 0.005, -0.001, 0.0002],
}


def scene(
    seed: int,
    rows: int = 6,
    columns: int = 3,
    tilt_deg: float = 25.0,
    sigma_px: float = 0.0,
    camera: Camera | None = None,
    **detector: float,
) -> Scene:
    rng = np.random.default_rng(seed)
    view = Viewpoint(np.deg2rad(tilt_deg), rng.uniform(0, 6.28), np.deg2rad(rng.uniform(-4, 4)), 0.7)
    panel = regular_panel(rows, columns, PITCH_M * 1.1)
    return make_scene(panel, camera or paper_camera(), view, DetectorModel(sigma_px, **detector), rng)


def distorted_camera(model: str) -> Camera:
    return Camera.from_matrix(PAPER_K, 640, 480, DISTORTED[model], model)


def rotation_error_deg(R: Array, truth: Array) -> float:
    return float(np.rad2deg(rotation_angle_rad(R.T @ truth)))


def known_of(panel: Panel, name: str = "lobby") -> KnownPanel:
    """The panel as it was drawn; buttons of a last row that is half a pitch off lie beside the lattice."""
    at = panel.points_m[:, :2]
    pitch = np.array(panel.pitch_m)
    cells = np.where((panel.blocks == 0)[:, None], panel.cells, -1)
    rows, columns = cells.max(axis=0) + 1
    return KnownPanel(
        name=name,
        labels=tuple(b.label for b in panel.buttons),
        places=at,
        sizes=np.full((len(at), 2), 0.028),
        cells=cells,
        metric=True,
        pitch=pitch,
        row_positions=np.arange(rows, dtype=float),
        column_positions=np.arange(columns, dtype=float),
        row_staggered=np.zeros(rows, dtype=bool),
        column_staggered=np.zeros(columns, dtype=bool),
        row_block=np.zeros(rows, dtype=np.int64),
        column_block=np.zeros(columns, dtype=np.int64),
    )


def patches_read(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return a list that grows by the number of patches whenever some are read."""
    counts, logits_of = list[int](), reader.logits_of

    def logits(patches: Sequence[Image], weights: Path = reader.WEIGHTS) -> Array:
        counts.append(len(patches))
        return logits_of(patches, weights)

    monkeypatch.setattr(reader, "logits_of", logits)
    return counts
