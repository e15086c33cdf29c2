"""One column of floors with controls: layouts that no lattice of two columns seeds."""

from __future__ import annotations

import numpy as np
import pytest

from elevator_rectify.core import Camera, Config, Detection, fit_panel
from elevator_rectify.core.geometry.rotations import rotation, rotation_angle_rad
from elevator_rectify.core.lattice.columns import column_layouts
from elevator_rectify.core.types import Array
from elevator_rectify.render.scene import paper_camera

_AREA, _SIGMA = 1.0, 1e-3
_TILTED = np.array([-0.5, 0.45, 0.03])


def _panel(floors: int, gap: float, half: float, below: bool = True, middle: bool = False) -> Array:
    """Return the buttons' places (N, 2) in row pitches: a column at x = 0, two or three controls beyond its end."""
    column = np.column_stack([np.zeros(floors), np.arange(floors)])
    row = floors - 1 + gap if below else -gap
    controls = [[-half, row], [half, row]] + ([[0.0, row]] if middle else [])
    return np.concatenate([column, controls])


def _seen(places: Array, turn: Array) -> tuple[Array, Array]:
    """Return rays (N, 2) of a panel turned by a rotation vector, and the rotation."""
    R = rotation(turn)
    points = (places - places.mean(axis=0)) @ R[:, :2].T + [0.2, -0.1, 7.0]
    return points[:, :2] / points[:, 2:], R


def _angle_deg(R: Array, other: Array) -> float:
    return float(np.rad2deg(rotation_angle_rad(R.T @ other)))


@pytest.mark.parametrize("gap", [1.0, 1.7, 2.4])
@pytest.mark.parametrize(("below", "middle"), [(True, False), (False, False), (True, True)])
def test_a_column_with_controls_is_exact_without_noise(gap: float, below: bool, middle: bool) -> None:
    rays, R = _seen(_panel(5, gap, 1.0, below, middle), _TILTED)
    for order in (np.arange(len(rays)), np.random.default_rng(1).permutation(len(rays))):
        best = max(column_layouts(rays[order], _SIGMA, _AREA, Config()), key=lambda f: f.log_likelihood)
        assert (best.inlier > 0.5).all()
        # Both pitches are one, so that the prior of their ratio does not pull.
        assert _angle_deg(R, best.pose.R[0]) < 0.01


def test_a_control_below_the_column_and_one_beside_it() -> None:
    places = np.concatenate([_panel(4, 1.6, 0.8)[:4], [[0.0, 4.6], [1.0, 4.6]]])
    rays, R = _seen(places, _TILTED)
    best = max(column_layouts(rays, _SIGMA, _AREA, Config()), key=lambda f: f.log_likelihood)
    assert (best.inlier > 0.5).all() and _angle_deg(R, best.pose.R[0]) < 0.1


def test_what_has_no_column_or_no_controls_has_no_such_layout() -> None:
    column, _ = _seen(_panel(6, 1.5, 0.8)[:6], _TILTED)
    assert column_layouts(column, _SIGMA, _AREA, Config()) == []
    two, _ = _seen(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.3], [1.0, 2.3]]), _TILTED)
    assert column_layouts(two, _SIGMA, _AREA, Config()) == []


def test_a_panel_of_one_column_and_controls_is_fitted() -> None:
    camera: Camera = paper_camera()
    rays, R = _seen(_panel(5, 1.7, 0.8), _TILTED)
    pixels = camera.pixels(rays) + np.random.default_rng(5).normal(0.0, 0.2, rays.shape)
    detections = [Detection(float(x), float(y), 24.0, 24.0) for x, y in pixels]
    fit = fit_panel(detections, camera)
    assert (fit.cells >= 0).all() and fit.rows == 6
    # The covariance may be too wide to accept it by the boxes alone, but the pose is near.
    assert fit.status in ("ok", "uncertain", "low_confidence") and _angle_deg(R, fit.R_camera_panel) < 5.0
