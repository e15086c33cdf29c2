from dataclasses import replace

import cv2
import numpy as np
import pytest

from elevator_rectify.benchmark.inexact import wrong_camera
from elevator_rectify.core import Camera, Config, fit_panel, fit_panels
from elevator_rectify.core.config import HypothesesConfig, JointConfig, with_values
from elevator_rectify.core.geometry.rotations import rotations
from elevator_rectify.core.lattice.hypotheses import (
    fit_homographies,
    grown_hypotheses,
    lattice_coordinates,
    nearest_nodes,
)
from elevator_rectify.core.lattice.refinement import Poses, jacobians, mirrored, poses_from_maps, projected, stepped
from elevator_rectify.core.result import judged, layout_of
from elevator_rectify.core.types import IntArray
from elevator_rectify.recordings.evaluate import cells_right
from elevator_rectify.render.levels import LEVELS, random_scene
from elevator_rectify.render.panel import PITCH_M, Button, Look, Panel, framed, regular_panel, with_gap
from elevator_rectify.render.scene import DetectorModel, Scene, Viewpoint, make_scene, paper_camera
from test.scenes import rotation_error_deg, scene

CAMERA = paper_camera()
# The prior of the pitch ratio pulls by next to nothing where there is no noise to speak of.
EXACT = with_values(Config(), {"joint.log_aspect_std": 10.0})


def random_poses(number: int, seed: int = 0) -> Poses:
    rng = np.random.default_rng(seed)
    t = np.column_stack([rng.normal(0, 1, (number, 2)), rng.uniform(6, 12, number)])
    return Poses(
        rotations(rng.normal(0, 0.4, (number, 3))),
        t,
        rng.normal(0, 0.2, number),
        rng.uniform(0, 3, (number, 2)),
        np.zeros(number),
    )


def view_of(panel: Panel, seed: int, tilt_deg: float = 25.0, sigma_px: float = 0.0) -> Scene:
    rng = np.random.default_rng(seed)
    view = Viewpoint(np.deg2rad(tilt_deg), rng.uniform(0, 6.28), np.deg2rad(rng.uniform(-5, 5)), 0.7)
    return make_scene(panel, CAMERA, view, DetectorModel(sigma_px), rng)


def brick_panel(rows: int, columns: int) -> Panel:
    buttons = [
        Button((c + 0.5 * (r % 2)) * PITCH_M, r * PITCH_M, r, c, r % 2)
        for r in range(rows)
        for c in range(columns - r % 2)
    ]
    return framed(tuple(buttons), (PITCH_M, PITCH_M), Look())


def share_right(truth: Scene, cells: IntArray) -> float:
    return cells_right(cells, truth.panel.cells[truth.button], truth.panel.blocks[truth.button])


def test_jacobian_equals_central_differences() -> None:
    poses = random_poses(4)
    lattice = np.random.default_rng(1).uniform(-2, 5, (4, 9, 2))
    _, J, d_uv = jacobians(poses, lattice)
    h = 1e-6
    for k in range(7):
        step = np.zeros((4, 7))
        step[:, k] = h
        numeric = (projected(stepped(poses, step), lattice)[0] - projected(stepped(poses, -step), lattice)[0]) / (2 * h)
        np.testing.assert_allclose(J[..., k], numeric, atol=1e-8)
    for k in range(2):
        offset = h * np.eye(2)[k]
        numeric = (projected(poses, lattice + offset)[0] - projected(poses, lattice - offset)[0]) / (2 * h)
        np.testing.assert_allclose(d_uv[..., k], numeric, atol=1e-8)


def test_maps_and_poses_are_inverse() -> None:
    poses = random_poses(5)
    back = poses_from_maps(-2.0 * poses.maps, poses.centre, poses.brick)
    np.testing.assert_allclose(back.R, poses.R, atol=1e-9)
    np.testing.assert_allclose(back.t, poses.t, atol=1e-9)
    np.testing.assert_allclose(back.log_aspect, poses.log_aspect, atol=1e-9)


def test_mirrored_tilt_looks_the_same_from_far_away_and_twice_is_the_same() -> None:
    poses = random_poses(5)
    far = replace(poses, t=poses.t * 1e4)
    lattice = np.random.default_rng(1).uniform(-2, 5, (5, 9, 2))
    other = mirrored(far)
    np.testing.assert_allclose(projected(other, lattice)[0] * 1e4, projected(far, lattice)[0] * 1e4, atol=0.05)
    assert np.abs(other.R - far.R).max() > 0.1
    np.testing.assert_allclose(mirrored(other).R, far.R, atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(other.R), 1.0)


def test_homographies_are_recovered_from_exact_points() -> None:
    G = random_poses(6).maps
    G /= G[:, 2:, 2:]
    cells = np.tile(np.stack(np.meshgrid(np.arange(-1.0, 3), np.arange(-1.0, 4)), -1).reshape(-1, 2), (6, 1, 1))
    mapped = cells @ np.swapaxes(G[:, :, :2], 1, 2) + G[:, None, :, 2]
    z = mapped[..., :2] / mapped[..., 2:]
    np.testing.assert_allclose(fit_homographies(cells, z, np.ones(z.shape[:2]), np.full(6, 1e-9)), G, atol=1e-6)
    np.testing.assert_allclose(lattice_coordinates(G, z), cells, atol=1e-9)


def test_singular_maps_and_points_beyond_the_horizon_are_far_away() -> None:
    assert (lattice_coordinates(np.zeros((1, 3, 3)), np.zeros((1, 2, 2))) > 1e5).all()
    G = np.eye(3)[None].copy()
    G[0, 2, 0] = 1.0
    assert (lattice_coordinates(G, np.array([[[2.0, 0.0], [0.5, 0.0]]]))[0] > 1e5).all(axis=1).tolist() == [True, False]


def test_brick_nodes_shift_odd_rows() -> None:
    q = np.array([[[0.4, 0.1], [0.4, 1.1], [-0.6, -1.0]]])
    np.testing.assert_array_equal(nearest_nodes(q, np.ones(1))[0], np.array([[0, 0], [0.5, 1], [-0.5, -1]]))
    np.testing.assert_array_equal(nearest_nodes(q, np.zeros(1))[0], [[0, 0], [0, 1], [-1, -1]])


def test_a_good_hypothesis_is_among_those_grown() -> None:
    truth = scene(2, rows=6, columns=3, tilt_deg=40.0, sigma_px=1.0)
    rays = CAMERA.rays(truth.centres_px)
    maps, brick = grown_hypotheses(rays, 1.5 / CAMERA.focal_px, HypothesesConfig())
    q = lattice_coordinates(maps, np.broadcast_to(rays, (len(maps), *rays.shape)))
    nodes = nearest_nodes(q, brick)
    true = truth.panel.cells[truth.button][:, ::-1]
    # One integer shift explains all points.
    assert any(brick[k] == 0 and np.ptp(nodes[k] - true, axis=0).max() == 0 for k in range(len(maps)))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("tilt_deg", [10.0, 40.0])
def test_noise_free_panel_is_exact(seed: int, tilt_deg: float) -> None:
    truth = scene(seed, tilt_deg=tilt_deg)
    fit = fit_panel(truth.centres_px, CAMERA, EXACT)
    assert fit.status == "ok", fit.reason
    assert (fit.rows, fit.columns) == (6, 3) and share_right(truth, fit.cells) == 1.0
    assert rotation_error_deg(fit.R_camera_panel, truth.R_camera_panel) < 0.01
    assert np.linalg.norm(fit.t_camera_panel * PITCH_M - truth.t_camera_panel) < 1e-4


def test_a_gap_of_no_whole_pitch_and_a_staggered_row_are_modelled() -> None:
    truth = view_of(with_gap(regular_panel(6, 3), 0.45, ("<>", "><")), 1)
    fit = fit_panel(truth.centres_px, CAMERA, EXACT)
    assert fit.ok and share_right(truth, fit.cells) == 1.0
    np.testing.assert_allclose(fit.row_positions, [0, 1, 2, 3, 4, 5, 6.45], atol=0.01)
    assert fit.row_staggered.tolist() == [False] * 6 + [True]
    assert fit.row_block.tolist() == [0] * 6 + [1]
    placed = fit.grid_px[fit.cells[:, 0], fit.cells[:, 1]]
    np.testing.assert_allclose(placed, truth.centres_px, atol=0.05)


def test_a_small_gap_bends_no_tilt() -> None:
    """A gap below half a pitch keeps every button near its node: only the score test sees it."""
    panel = regular_panel(8, 3)
    moved = tuple(replace(b, y_m=b.y_m + (0.2 * PITCH_M if b.row >= 6 else 0.0)) for b in panel.buttons)
    truth = view_of(replace(panel, buttons=moved), 3, sigma_px=0.5)
    fit = fit_panel(truth.centres_px, CAMERA)
    assert fit.ok and fit.row_block.max() == 1
    assert fit.row_positions[6] - fit.row_positions[5] == pytest.approx(1.2, abs=0.05)
    assert rotation_error_deg(fit.R_camera_panel, truth.R_camera_panel) < 1.5


def test_a_column_apart_is_modelled() -> None:
    panel = regular_panel(6, 3)
    moved = tuple(replace(b, x_m=b.x_m + (0.4 * PITCH_M if b.column == 2 else 0.0)) for b in panel.buttons)
    truth = view_of(replace(panel, buttons=moved), 5, sigma_px=0.3)
    fit = fit_panel(truth.centres_px, CAMERA)
    assert fit.ok and share_right(truth, fit.cells) == 1.0
    np.testing.assert_allclose(fit.column_positions, [0, 1, 2.4], atol=0.05)
    assert fit.column_block.tolist() == [0, 0, 1]


def test_a_brick_layout_is_found() -> None:
    truth = view_of(brick_panel(6, 4), 2, sigma_px=0.5)
    fit = fit_panel(truth.centres_px, CAMERA)
    assert fit.ok, fit.reason
    assert share_right(truth, fit.cells) == 1.0
    assert sorted({bool(s) for s in fit.row_staggered}) == [False, True]


def test_order_of_detections_does_not_matter() -> None:
    truth = random_scene(LEVELS["medium"], 5, 1)
    order = np.random.default_rng(1).permutation(len(truth.centres_px))
    one, other = fit_panel(truth.centres_px, CAMERA), fit_panel(truth.centres_px[order], CAMERA)
    np.testing.assert_array_equal(one.R_camera_panel, other.R_camera_panel)
    np.testing.assert_array_equal(one.cells[order], other.cells)


def test_false_detections_beside_the_panel_end_as_outliers() -> None:
    truth = scene(4, rows=7, columns=3, sigma_px=0.7, false=0.2)
    fit = fit_panel(truth.centres_px, CAMERA)
    assert fit.ok and share_right(truth_only(truth), fit.cells[truth.button >= 0]) == 1.0
    assert (fit.cells[truth.button < 0, 0] == -1).mean() >= 0.75


def truth_only(truth: Scene) -> Scene:
    return replace(truth, button=truth.button[truth.button >= 0])


def test_a_far_panel_is_ambiguous_and_both_poses_are_returned() -> None:
    """From very far a panel's perspective is below the noise: the tilt may be mirrored."""
    telephoto = Camera.from_matrix([[60000.0, 0, 320], [0, 60000.0, 240], [0, 0, 1]], 640, 480)
    rng = np.random.default_rng(0)
    truth = make_scene(regular_panel(5, 3), telephoto, Viewpoint(0.6, 0.7, 0.0, 0.7), DetectorModel(0.5), rng)
    fit = fit_panel(truth.centres_px, telephoto)
    assert fit.status == "ambiguous" and len(fit.alternatives) == 1 and not fit.ok
    errors = [rotation_error_deg(f.R_camera_panel, truth.R_camera_panel) for f in (fit, *fit.alternatives)]
    assert min(errors) < 5.0 < max(errors)


def test_the_previous_fit_starts_the_next_and_is_dropped_when_the_panel_changes() -> None:
    first, second = scene(1, sigma_px=0.5), scene(9, rows=8, columns=4, tilt_deg=40.0, sigma_px=0.5)
    fit = fit_panel(first.centres_px, CAMERA)
    moved = fit_panel(first.centres_px + 3.0, CAMERA, previous=fit)
    assert moved.ok and np.array_equal(moved.cells, fit.cells)
    scratch = fit_panel(first.centres_px + 3.0, CAMERA)
    assert rotation_error_deg(moved.R_camera_panel, scratch.R_camera_panel) < 0.2
    other = fit_panel(second.centres_px, CAMERA, previous=fit)
    np.testing.assert_array_equal(other.R_camera_panel, fit_panel(second.centres_px, CAMERA).R_camera_panel)


def test_two_panels_in_one_image_are_both_fitted() -> None:
    left = np.stack(np.meshgrid(np.linspace(60, 200, 3), np.linspace(60, 400, 6)), -1).reshape(-1, 2)
    right = np.stack(np.meshgrid(np.linspace(420, 580, 3), np.linspace(80, 300, 4)), -1).reshape(-1, 2)
    fits = fit_panels(np.vstack([left, right]) + np.random.default_rng(0).normal(0, 0.5, (30, 2)), CAMERA)
    found = [set(np.flatnonzero(fit.cells[:, 0] >= 0)) for fit in fits if np.isfinite(fit.t_camera_panel).all()]
    assert found[0] == set(range(18)) and set(range(18, 30)) <= found[1]
    with_one = fit_panels(left, CAMERA)
    assert len(with_one) == 1 and with_one[0].inliers == 18


def test_covariance_covers_the_error() -> None:
    """Of 60 medium fits the 95 % region holds the true rotation in at least 85 % (three standard deviations)."""
    inside = []
    for trial in range(60):
        truth = random_scene(LEVELS["medium"], 77, trial)
        fit = fit_panel(truth.centres_px, CAMERA)
        if fit.ok:
            R = truth.R_camera_panel @ fit.R_camera_panel.T
            error = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
            inside.append(error @ np.linalg.solve(fit.covariance[3:, 3:], error) < 7.815)
    assert len(inside) > 40 and np.mean(inside) > 0.85


@pytest.mark.parametrize("roll_deg", [90.0, -100.0, 180.0])
def test_a_known_roll_of_the_camera_is_allowed_for(roll_deg: float) -> None:
    truth = scene(3, sigma_px=0.5)
    roll = np.deg2rad(roll_deg)
    Rz = rotations(np.array([[0.0, 0.0, roll]]))[0]
    square = Camera.from_matrix([[320.0, 0, 400], [0, 320.0, 400], [0, 0, 1]], 800, 800)
    turned = square.pixels(CAMERA.rays(truth.centres_px) @ Rz[:2, :2].T)
    fit = fit_panel(turned, square, with_values(Config(), {"joint.camera_roll_rad": float(roll)}))
    assert fit.ok, fit.reason
    assert rotation_error_deg(fit.R_camera_panel, Rz @ truth.R_camera_panel) < 2.0


def test_focal_length_uncertainty_predicts_the_shift_that_a_wrong_one_causes() -> None:
    truth = scene(3, tilt_deg=35.0)
    share = 0.02
    longer = Camera.from_matrix([[320 * (1 + share), 0, 320], [0, 320 * (1 + share), 240], [0, 0, 1]], 640, 480)
    sure = with_values(EXACT, {"joint.focal_std_share": 0.0})
    plain, wrong = fit_panel(truth.centres_px, CAMERA, sure), fit_panel(truth.centres_px, longer, sure)
    unsure = fit_panel(truth.centres_px, CAMERA, with_values(EXACT, {"joint.focal_std_share": share}))
    added = unsure.covariance - plain.covariance
    shift = np.linalg.norm(wrong.t_camera_panel - plain.t_camera_panel)
    assert np.sqrt(np.trace(added[:3, :3])) == pytest.approx(shift, rel=0.1)


@pytest.mark.parametrize(("longer", "k1"), [(1.05, 0.0), (0.95, 0.0), (1.0, 0.05), (1.0, -0.05)])
def test_covariance_covers_the_error_of_an_inexact_calibration(longer: float, k1: float) -> None:
    """Of 40 scenes with exact centres, all but a few are within the 95 % region: .93 (f) and .90 (k1) are asked."""
    inside = []
    for seed in range(40):
        truth = scene(seed, sigma_px=0.2, tilt_deg=float(seed))
        fit = fit_panel(truth.centres_px, wrong_camera(CAMERA, longer, k1))
        if fit.ok:
            error = cv2.Rodrigues(truth.R_camera_panel @ fit.R_camera_panel.T)[0].ravel()
            inside.append(error @ np.linalg.solve(fit.covariance[3:, 3:], error) < 7.815)
    assert len(inside) > 30 and np.mean(inside) >= 0.9


@pytest.mark.parametrize("k1", [0.02, -0.02])
def test_lens_uncertainty_predicts_the_shift_that_a_wrong_one_causes(k1: float) -> None:
    truth = scene(3, tilt_deg=35.0)
    bent = wrong_camera(CAMERA, 1.0, k1)
    sure = with_values(EXACT, {"joint.radial_std": 0.0})
    plain, wrong = fit_panel(truth.centres_px, CAMERA, sure), fit_panel(truth.centres_px, bent, sure)
    unsure = fit_panel(truth.centres_px, CAMERA, with_values(EXACT, {"joint.radial_std": abs(k1)}))
    added = unsure.covariance - plain.covariance
    shift = np.linalg.norm(wrong.t_camera_panel - plain.t_camera_panel)
    turn = rotation_error_deg(wrong.R_camera_panel, plain.R_camera_panel)
    # Linear: the curved lattice is fitted again, with others of its free lengths.
    assert np.sqrt(np.trace(added[:3, :3])) == pytest.approx(shift, rel=0.25)
    assert np.rad2deg(np.sqrt(np.trace(added[3:6, 3:6]))) == pytest.approx(turn, rel=0.25)


def test_joint_config_is_used() -> None:
    assert Config().joint == JointConfig() and Config().method == "joint"


def test_a_crowd_is_no_panel() -> None:
    """Ten thousand points are thinned evenly, not to a strip in which a lattice as fine as the noise fits them all."""
    for seed in range(3):
        points = np.random.default_rng(seed).uniform(-100, 800, (10_000, 2))
        assert not fit_panel(points, CAMERA).ok


@pytest.mark.parametrize("rows", [[0.0, 1, 2, 1.54], [0.0, 1, 1.2, 2]])
def test_rows_out_of_order_or_nearer_than_a_button_are_no_panel(rows: list[float]) -> None:
    truth = scene(3, rows=4, columns=3)
    fit = fit_panel(truth.detections, truth.camera)
    layout = layout_of(fit)
    wrong = replace(fit, row_positions=np.array(rows))
    assert fit.ok and judged(fit, layout, truth.camera, Config(), 0.0).ok
    assert judged(wrong, layout, truth.camera, Config(), 0.0).status == "no_lattice"


def test_a_lattice_as_fine_as_the_noise_is_refused() -> None:
    grid = np.stack(np.meshgrid(np.arange(20), np.arange(20)), axis=-1).reshape(-1, 2) * 5.0 + 200.0
    fit = fit_panel(grid + np.random.default_rng(0).normal(0, 1.5, grid.shape), CAMERA)
    assert not fit.ok


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 4, 5, 6, 8])
def test_columns_staggered_against_each_other(seed: int) -> None:
    """Read as a regular lattice, such a panel would hang more than 25 degrees askew."""
    rng = np.random.default_rng(seed)
    rows = int(rng.integers(4, 8))
    buttons = tuple(
        Button(c * PITCH_M, (r + 0.5 * c) * PITCH_M, r, c, 0, str(2 * r + c)) for r in range(rows) for c in range(2)
    )
    view = Viewpoint(np.deg2rad(rng.uniform(0, 35)), rng.uniform(0, 6.28), 0.03, 0.7)
    panel = framed(buttons, (PITCH_M, PITCH_M), Look())
    seen = make_scene(panel, CAMERA, view, DetectorModel(0.8), rng)
    fit = fit_panel(seen.centres_px, CAMERA)
    assert fit.ok and fit.rows == rows and fit.column_staggered.tolist() == [False, True]
    # 0.8 px on eight to fourteen buttons.
    assert rotation_error_deg(fit.R_camera_panel, seen.R_camera_panel) < 3.0
    assert cells_right(fit.cells, panel.cells[seen.button], panel.blocks[seen.button]) == 1.0
