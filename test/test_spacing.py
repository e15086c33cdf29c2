"""Evenly spaced lines in the picture: a trapezoid that faces the camera is no tilted panel with growing gaps."""

from __future__ import annotations

import numpy as np
import pytest

from elevator_rectify.core import fit_panel
from elevator_rectify.core.lattice.spacing import undone_perspective
from elevator_rectify.core.types import Array
from elevator_rectify.render.levels import LEVELS, random_scene
from elevator_rectify.render.scene import paper_camera
from test.scenes import scene


def trapezoid(rows: int, narrowing: float, rng: np.random.Generator) -> Array:
    """Return four columns (rows * 4, 2) that come nearer from row to row, at even distances of the rows."""
    row, column = np.indices((rows, 4)).reshape(2, -1)
    x = (column - 1.5) * (1.0 - narrowing * row)
    places = np.column_stack([x, row - (rows - 1) / 2]) * 45.0 + [320.0, 240.0]
    return np.asarray(places + rng.normal(0.0, 1.0, places.shape))


@pytest.mark.parametrize("rows", [4, 5, 6])
def test_a_trapezoid_that_faces_the_camera_is_refused_by_its_centres_alone(rows: int) -> None:
    fits = [fit_panel(trapezoid(rows, 0.12, np.random.default_rng(k)), paper_camera()) for k in range(5)]
    assert not any(fit.ok for fit in fits) and any("evenly spaced" in fit.reason for fit in fits)


def test_tilted_panels_are_left_alone_with_gaps_or_without() -> None:
    for number in range(6):
        for truth in (scene(number, tilt_deg=35.0), random_scene(LEVELS["gaps"], 61, number)):
            assert undone_perspective(fit_panel(truth.centres_px, truth.camera)) == ""
