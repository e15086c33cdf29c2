"""The metric scale from depth, and the smoothing from frame to frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elevator_rectify.core import Config, fit_panel
from elevator_rectify.core.config import ScaleConfig, SmoothingConfig, with_values
from elevator_rectify.core.geometry.pose import covariance_at, residual_covariance_at
from elevator_rectify.core.geometry.rotations import rotation
from elevator_rectify.core.geometry.scale import as_far_apart, neighbours_apart, resized, scaled, with_scale
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.track import smoothed
from elevator_rectify.core.types import Array, IntArray
from elevator_rectify.render.levels import LEVELS, random_scene
from elevator_rectify.render.panel import PITCH_M
from elevator_rectify.render.scene import Scene
from test.scenes import rotation_error_deg, scene

NO_PITCH = ScaleConfig()


def test_the_ratio_of_known_pitches_is_kept() -> None:
    off = []
    for row_pitch in (0.0, 1.1 * PITCH_M):
        values = {"scale.column_pitch_m": PITCH_M, "scale.column_pitch_std_m": 1e-4, "scale.row_pitch_m": row_pitch}
        config = with_values(Config(), {**values, "scale.row_pitch_std_m": 1e-4})
        fits = [(v, fit_panel(v.centres_px, v.camera, config)) for v in (scene(k, sigma_px=1.5) for k in range(12))]
        off.append([abs(float(np.log(f.pitch[1] / f.pitch[0] / 1.1))) for _, f in fits if f.ok])
        errors = [rotation_error_deg(f.R_camera_panel, v.R_camera_panel) for v, f in fits if f.ok]
        assert len(errors) >= 9 and np.mean(errors) < 1.5
    # The ratio is given to .3 %; centres alone know it ten times less.
    assert np.max(off[1]) < 0.006 and np.mean(off[0]) > 4.0 * np.mean(off[1])


# One column of floors above the middle of a pair, which is a pitch apart: a lattice of half of that.
_ABOVE_A_PAIR = np.array([[0, 1], [1, 1], [2, 1], [3, 1], [4, 0], [4, 2]])


@pytest.mark.parametrize(
    ("cells", "shown", "apart"),
    [
        (_ABOVE_A_PAIR, [], 2.0),
        (_ABOVE_A_PAIR, [13], 1.0),
        (np.vstack([_ABOVE_A_PAIR, [3, 2]]), [], 1.0),
        (np.array([[0, 0], [1, 1], [2, 0], [3, 2]]), [], 1.0),
    ],
)
def test_the_column_pitch_is_that_of_neighbours_in_a_row(cells: IntArray, shown: list[int], apart: float) -> None:
    nodes = np.stack(np.meshgrid(np.arange(3.0), np.arange(5.0)), axis=-1)
    assert neighbours_apart(nodes, cells, np.array(shown, dtype=np.int64)) == apart


def test_a_column_above_a_pair_is_as_far_away_as_it_is() -> None:
    at = (_ABOVE_A_PAIR - [0, 1])[:, ::-1] * [0.5 * PITCH_M, 1.1 * PITCH_M]
    view = scene(3, tilt_deg=20.0)
    pixels = view.camera.project(at @ view.R_camera_panel[:, :2].T + view.t_camera_panel)
    fit = fit_panel(pixels, view.camera, Config(scale=ScaleConfig(column_pitch_m=PITCH_M)))
    assert (fit.rows, fit.columns, fit.inliers, fit.apart) == (5, 3, 6, 2.0)
    assert fit.column_pitch == pytest.approx(PITCH_M)
    # Without noise but for what the priors of the shape add.
    assert np.linalg.norm(fit.grid_points[0, 1] - view.t_camera_panel) < 0.02 * np.linalg.norm(view.t_camera_panel)


def test_neighbours_that_were_seen_before_keep_their_distance() -> None:
    view = scene(3)
    before = fit_panel(view.centres_px, view.camera)
    hidden = resized(replace(before, apart=2.0), 0.5)
    now = as_far_apart(hidden, before)
    assert now.apart == before.apart
    np.testing.assert_allclose(now.t_camera_panel, before.t_camera_panel)
    np.testing.assert_allclose(now.covariance, before.covariance)
    assert as_far_apart(before, hidden) is before
    assert as_far_apart(hidden, replace(before, columns=9)) is hidden


def depth_of(view: Scene) -> Array:
    """The depth that a perfect camera would see of the panel's plane."""
    camera = view.camera
    pixels = (
        np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).reshape(-1, 2).astype(float)
    )
    rays = np.c_[camera.rays(pixels), np.ones(len(pixels))]
    normal = view.R_camera_panel[:, 2]
    depth = (normal @ view.t_camera_panel) / (rays @ normal)
    return np.where(depth > 0, depth, np.nan).reshape(camera.height, camera.width)


def test_depth_gives_the_metric_scale_through_holes_and_a_hand() -> None:
    view = scene(3, tilt_deg=30.0, sigma_px=0.0)
    fit = fit_panel(view.centres_px, view.camera)
    depth = depth_of(view)
    rng = np.random.default_rng(0)
    depth[rng.random(depth.shape) < 0.3] = np.nan
    depth[:, 300:340] = 0.1
    found, source = with_scale(fit, view.camera, depth, NO_PITCH)
    assert source == "depth" and found.metric
    # Nearest pixel of a tilted plane: within the systematic share.
    assert found.pitch[0] == pytest.approx(PITCH_M, rel=0.01)
    assert np.linalg.norm(found.t_camera_panel - view.t_camera_panel) < 0.01 * np.linalg.norm(view.t_camera_panel)
    np.testing.assert_allclose(found.grid_points[0, 0], found.t_camera_panel)
    assert np.linalg.eigvalsh(found.covariance)[0] > 0


def test_depth_and_pitch_are_combined_or_contradict_each_other() -> None:
    view = scene(3, sigma_px=0.0)
    fit, depth = fit_panel(view.centres_px, view.camera), depth_of(view)
    both, source = with_scale(fit, view.camera, depth, ScaleConfig(PITCH_M, 0.001))
    alone, _ = with_scale(fit, view.camera, depth, NO_PITCH)
    assert source == "column pitch and depth"
    assert both.covariance[2, 2] < alone.covariance[2, 2]
    neither, source = with_scale(fit, view.camera, depth, ScaleConfig(2 * PITCH_M, 0.001))
    assert not neither.metric and "by the depth" in source


@pytest.mark.parametrize("fault", ["size", "holes", "no plane"])
def test_an_unusable_depth_image_leaves_the_scale_unknown_and_says_why(fault: str) -> None:
    view = scene(3, sigma_px=0.0)
    fit, depth = fit_panel(view.centres_px, view.camera), depth_of(view)
    if fault == "size":
        depth = depth[::2]
    elif fault == "holes":
        depth[:] = np.nan
    else:
        depth = depth * np.random.default_rng(0).uniform(0.5, 1.5, depth.shape)
    found, source = with_scale(fit, view.camera, depth, NO_PITCH)
    assert not found.metric and source.startswith("unknown: the depth image")
    with_pitch, source = with_scale(fit, view.camera, depth, ScaleConfig(PITCH_M, 0.001))
    assert with_pitch.metric and source.startswith("column pitch: ")


def test_scaling_a_fit_is_fitting_with_the_pitch() -> None:
    view = scene(4, sigma_px=0.5)
    given = ScaleConfig(PITCH_M, 0.001)
    known = fit_panel(view.centres_px, view.camera, replace(Config(), scale=given))
    ours = scaled(fit_panel(view.centres_px, view.camera), given.column_pitch_m, given.column_pitch_std_m)
    for name in ("t_camera_panel", "pitch", "covariance", "grid_panel", "grid_points"):
        np.testing.assert_allclose(getattr(ours, name), getattr(known, name), rtol=1e-9, atol=1e-12)


def test_a_depth_in_millimetres_is_not_taken_for_metres() -> None:
    view = scene(4, sigma_px=0.5)
    fit = fit_panel(view.centres_px, view.camera)
    for factor, known in ((1.0, True), (1000.0, False), (0.001, False)):
        metric, said = with_scale(fit, view.camera, factor * depth_of(view), NO_PITCH)
        assert metric.metric == known and ("another unit" in said) != known


def moved_grid(fit: GridFit, step: Array) -> Array:
    """Return the grid's points (R C, 3) of a fit whose (t, rotation, ln aspect, breaks) are moved."""
    rows = int(fit.row_block[-1])
    down = np.concatenate([[0.0], np.cumsum(step[7 : 7 + rows])])[fit.row_block]
    along = np.concatenate([[0.0], np.cumsum(step[7 + rows :])])[fit.column_block]
    panel = fit.grid_panel + np.stack(np.broadcast_arrays(along[None], down[:, None]), axis=-1) * fit.pitch
    panel = panel * np.array([1.0, np.exp(step[6])])
    return (panel.reshape(-1, 2) @ (rotation(step[3:6]) @ fit.R_camera_panel)[:, :2].T) + fit.t_camera_panel + step[:3]


def test_the_covariance_elsewhere_on_the_panel_is_that_of_all_that_moves_it() -> None:
    """Of each parameter alone, against finite differences: pose, aspect, gaps between blocks."""
    fits = [fit_panel(s.centres_px, s.camera) for s in (random_scene(LEVELS["gaps"], 5, k) for k in range(20))]
    fit = next(f for f in fits if f.ok and f.row_block[-1] > 0)
    places, small = fit.grid_panel.reshape(-1, 2), 1e-6
    for k in range(len(fit.shape_covariance)):
        step = np.zeros(len(fit.shape_covariance))
        step[k] = small
        derivative = (moved_grid(fit, step) - moved_grid(fit, -step)) / (2.0 * small)
        alone = replace(fit, shape_covariance=np.outer(step, step) / small**2)
        expected = derivative[:, :, None] * derivative[:, None, :]
        found = residual_covariance_at(alone, places)[:, :3, :3]
        np.testing.assert_allclose(found, expected, atol=1e-6 * expected.max())


def test_an_error_of_the_scale_moves_a_place_along_its_line_of_sight() -> None:
    view = scene(4, sigma_px=0.5)
    fit = fit_panel(view.centres_px, view.camera, replace(Config(), scale=ScaleConfig(PITCH_M, 0.002)))
    exact = replace(fit, scale_std_share=0.0)
    places, points = fit.grid_panel.reshape(-1, 2), fit.grid_points.reshape(-1, 3)
    more = (covariance_at(fit, places) - covariance_at(exact, places))[:, :3, :3]
    np.testing.assert_allclose(more, (0.002 / PITCH_M) ** 2 * points[:, :, None] * points[:, None, :], atol=1e-12)
    np.testing.assert_allclose(covariance_at(fit, places[:1])[0], fit.covariance, rtol=1e-9, atol=1e-12)


def frames(seed: int, number: int) -> list[tuple[Scene, GridFit]]:
    views = [replace_noise(seed, k) for k in range(number)]
    config = replace(Config(), scale=ScaleConfig(PITCH_M, 0.001))
    return [(view, fit_panel(view.centres_px, view.camera, config)) for view in views]


def replace_noise(seed: int, k: int) -> Scene:
    still = scene(seed, tilt_deg=25.0)
    noise = np.random.default_rng([seed, k]).normal(0.0, 0.8, still.centres_px.shape)
    moved = tuple(
        replace(d, x_px=d.x_px + dx, y_px=d.y_px + dy) for d, (dx, dy) in zip(still.detections, noise, strict=True)
    )
    return replace(still, detections=moved)


def test_smoothing_helps_a_still_camera_and_keeps_grid_and_pose_together() -> None:
    still = SmoothingConfig(speed_m_per_s=0.01, turn_rad_per_s=0.01)
    track, raw, smooth = None, [], []
    for k, (view, fit) in enumerate(frames(5, 25)):
        track, found = smoothed(track, fit, view.camera, k * 33_000_000, still)
        raw.append(rotation_error_deg(fit.R_camera_panel, view.R_camera_panel))
        smooth.append(rotation_error_deg(found.R_camera_panel, view.R_camera_panel))
        np.testing.assert_allclose(found.grid_points[0, 0], found.t_camera_panel, atol=1e-9)
        np.testing.assert_allclose(found.grid_px, view.camera.project(found.grid_points), atol=1e-6)
    assert np.mean(smooth[5:]) < 0.7 * np.mean(raw[5:])


def test_a_jump_is_shown_as_a_jump() -> None:
    (view, first), (_, second) = frames(6, 2)
    track, _ = smoothed(None, first, view.camera, 0, SmoothingConfig())
    far = replace(second, t_camera_panel=second.t_camera_panel + np.array([0.3, 0.0, 0.0]))
    _, found = smoothed(track, far, view.camera, 33_000_000, SmoothingConfig())
    assert found is far


def test_nothing_is_smoothed_over_a_refusal_an_older_frame_another_panel_or_a_pause() -> None:
    (view, first), (_, second) = frames(7, 2)
    track, _ = smoothed(None, first, view.camera, 10**9, SmoothingConfig())
    refused = replace(second, status="ambiguous")
    assert smoothed(track, refused, view.camera, 2 * 10**9, SmoothingConfig()) == (track, refused)
    assert smoothed(track, second, view.camera, 10**9, SmoothingConfig()) == (track, second)
    other = replace(second, rows=second.rows + 1)
    assert smoothed(track, other, view.camera, 10**9 + 1, SmoothingConfig())[1] is other
    assert smoothed(track, second, view.camera, 4 * 10**9, SmoothingConfig())[1] is second
