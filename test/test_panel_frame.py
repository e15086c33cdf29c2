"""The panel frame stays on the panel while rows and columns are hidden or come into view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elevator_rectify.core import fit_panel
from elevator_rectify.core.geometry.panel_frame import PanelFrame, began, followed
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.types import Array
from test.scenes import scene

SCENE = scene(5, 5, 3, tilt_deg=20.0, sigma_px=0.0)
TRUE = SCENE.t_camera_panel / SCENE.panel.pitch_m[0]


def fit_of(rows: range = range(5), columns: range = range(3), moved: Array | None = None) -> GridFit:
    """Fit to the centres of some rows and columns, without noise; moved: the camera's way in column pitches."""
    buttons = SCENE.panel.buttons
    kept = [
        (d.x_px, d.y_px)
        for d, k in zip(SCENE.detections, SCENE.button, strict=True)
        if buttons[k].row in rows and buttons[k].column in columns
    ]
    fit = fit_panel(np.array(kept), SCENE.camera)
    assert fit.ok, fit.reason
    way = np.zeros(3) if moved is None else moved
    return replace(fit, t_camera_panel=fit.t_camera_panel - way, grid_points=fit.grid_points - way)


def origin_of(held: PanelFrame) -> Array:
    return held.fit.point_at(held.origin)


@pytest.mark.parametrize(
    ("rows", "columns"),
    [(range(1, 5), range(3)), (range(5), range(1, 3)), (range(4), range(3)), (range(2, 5), range(2))],
)
def test_hidden_rows_and_columns_leave_origin_and_middle_where_they_are(rows: range, columns: range) -> None:
    first = began(fit_of(), 1)
    hidden = followed(first, fit_of(rows, columns), 2)
    again = followed(hidden, fit_of(), 3)
    assert hidden.since_ns == again.since_ns == 1
    for held in (hidden, again):
        # Noise-free: what is left is the fit's own tolerance, a thousandth of a pitch.
        assert np.linalg.norm(origin_of(held) - origin_of(first)) < 2e-3
        assert np.linalg.norm(held.fit.point_at(held.middle) - first.fit.point_at(first.middle)) < 2e-3
    assert not again.origin.any()


def test_small_motion_is_followed_and_what_may_be_another_row_begins_anew() -> None:
    R = fit_of().R_camera_panel
    first = began(fit_of(), 1)
    near = followed(first, fit_of(range(1, 5), moved=0.3 * R[:, 1]), 2)
    assert near.since_ns == 1
    assert np.linalg.norm(origin_of(near) + 0.3 * R[:, 1] - origin_of(first)) < 2e-3
    assert followed(first, fit_of(moved=0.5 * R[:, 0]), 2).since_ns == 2


def test_the_same_cells_do_not_drift_and_another_unit_begins_anew() -> None:
    held = began(fit_of(), 0)
    rng = np.random.default_rng(3)
    for k in range(1, 30):
        held = followed(held, fit_of(moved=rng.normal(0.0, 0.05, 3)), k)
    assert held.since_ns == 0 and not held.origin.any()
    assert followed(held, replace(fit_of(), metric=True), 31).since_ns == 31
