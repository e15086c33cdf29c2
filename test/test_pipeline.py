from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from elevator_rectify.core import Camera, Config, Detection, fit_panel
from elevator_rectify.core.config import METHODS, ScaleConfig, with_values
from elevator_rectify.core.types import Array
from elevator_rectify.recordings.evaluate import cells_right
from elevator_rectify.render.panel import PITCH_M
from elevator_rectify.render.scene import paper_camera
from test.scenes import DISTORTED, distorted_camera, rotation_error_deg, scene

CAMERA = paper_camera()
FAST = with_values(
    Config(), {"em.max_iterations": 20, "rounds.max_rounds": 3, "size.max_rows": 4, "size.max_columns": 4}
)


@pytest.mark.parametrize("seed", range(6))
def test_noise_free_panel_is_exact(seed: int) -> None:
    truth = scene(seed, tilt_deg=15.0)
    config = with_values(Config(), {"method": "paper", "rounds.tolerance": 1e-10, "rounds.max_rounds": 300})
    fit = fit_panel(truth.centres_px, CAMERA, config)
    assert fit.status == "ok", fit.reason
    assert (fit.rows, fit.columns) == (6, 3)
    # The rounds converge linearly: what is left is some ten times the last step.
    assert rotation_error_deg(fit.R_camera_panel, truth.R_camera_panel) < 1e-5
    assert np.linalg.norm(fit.t_camera_panel * PITCH_M - truth.t_camera_panel) < 1e-7
    assert fit.pitch[1] == pytest.approx(1.1, abs=1e-7)
    assert cells_right(fit.cells, truth.panel.cells[truth.button], truth.panel.blocks[truth.button]) == 1.0


def test_metric_pitch_scales_pose_and_grid_and_adds_its_uncertainty() -> None:
    truth = scene(1, tilt_deg=15.0, sigma_px=0.5)
    plain = fit_panel(truth.centres_px, CAMERA)
    config = replace(Config(), scale=ScaleConfig(PITCH_M, 0.004))
    metric = fit_panel(truth.centres_px, CAMERA, config)
    assert metric.metric and not plain.metric
    np.testing.assert_allclose(metric.t_camera_panel, plain.t_camera_panel * PITCH_M)
    np.testing.assert_allclose(metric.grid_px, plain.grid_px, atol=1e-9)
    exact = fit_panel(truth.centres_px, CAMERA, replace(Config(), scale=ScaleConfig(PITCH_M, 0.0)))
    expected = 0.004**2 * np.outer(plain.t_camera_panel, plain.t_camera_panel)
    np.testing.assert_allclose((metric.covariance - exact.covariance)[:3, :3], expected, rtol=1e-6, atol=1e-12)


def test_order_of_detections_does_not_matter() -> None:
    truth = scene(3, sigma_px=0.8)
    order = np.random.default_rng(1).permutation(len(truth.centres_px))
    one, other = fit_panel(truth.centres_px, CAMERA), fit_panel(truth.centres_px[order], CAMERA)
    np.testing.assert_array_equal(one.R_camera_panel, other.R_camera_panel)
    np.testing.assert_array_equal(one.cells[order], other.cells)


@pytest.mark.parametrize("model", DISTORTED)
def test_distortion_is_removed_and_the_grid_drawn_back_through_it(model: str) -> None:
    truth = scene(2, tilt_deg=10.0, camera=distorted_camera(model))
    fit = fit_panel(truth.centres_px, truth.camera)
    assert fit.ok, fit.reason
    assert rotation_error_deg(fit.R_camera_panel, truth.R_camera_panel) < 0.05
    cells = fit.cells
    np.testing.assert_allclose(fit.grid_px[cells[:, 0], cells[:, 1]], truth.centres_px, atol=0.05)


def test_covariance_is_symmetric_and_positive() -> None:
    fit = fit_panel(scene(4, tilt_deg=15.0, sigma_px=1.0).centres_px, CAMERA)
    assert fit.ok
    np.testing.assert_allclose(fit.covariance, fit.covariance.T, rtol=1e-9)
    assert np.linalg.eigvalsh(fit.covariance)[0] > 0


LINE = np.column_stack([np.linspace(100, 500, 9), np.linspace(100, 300, 9)])


@pytest.mark.parametrize(
    ("detections", "status"),
    [
        (np.zeros((0, 2)), "too_few_detections"),
        (np.full((30, 2), 100.0), "too_few_detections"),
        (np.full((30, 2), np.nan), "too_few_detections"),
        (np.full((30, 2), -1e9), "too_few_detections"),
        (np.array([[10.0, 10.0], [20.0, 20.0]]), "too_few_detections"),
        (LINE, "collinear"),
    ],
)
def test_no_panel_is_a_status_with_a_reason(detections: Array, status: str) -> None:
    fit = fit_panel(detections, CAMERA)
    assert fit.status == status and fit.reason and not fit.ok
    assert np.isnan(fit.R_camera_panel).all() and np.isnan(fit.covariance).all()
    assert fit.cells.shape == (len(detections), 2) and (fit.cells == -1).all()


def test_wrong_shape_is_an_exception() -> None:
    with pytest.raises(ValueError, match=r"\(N, 2\)"):
        fit_panel(np.zeros((4, 3)), CAMERA)


def test_bad_detections_do_not_disturb_the_good_ones() -> None:
    truth = scene(5, sigma_px=0.5)
    spoiled = np.vstack([truth.centres_px, [[np.nan, 3.0], [np.inf, np.inf], [-50.0, 20.0], [9e9, 1.0]]])
    clean, fit = fit_panel(truth.centres_px, CAMERA), fit_panel(spoiled, CAMERA)
    np.testing.assert_array_equal(clean.R_camera_panel, fit.R_camera_panel)
    assert (fit.cells[-4:] == -1).all()


def test_ten_thousand_detections_are_capped_at_the_best_scored() -> None:
    truth = scene(6, sigma_px=0.5)
    rng = np.random.default_rng(0)
    noise = [Detection(x, y, score=0.1) for x, y in rng.uniform(0, 470, (10000, 2))]
    good = [replace(d, score=0.9) for d in truth.detections]
    config = with_values(Config(), {"input.max_detections": len(good)})
    fit = fit_panel(noise + good, CAMERA, config)
    np.testing.assert_array_equal(fit.R_camera_panel, fit_panel(good, CAMERA).R_camera_panel)


def test_printed_method_runs_and_differs() -> None:
    truth = scene(7, sigma_px=0.5)
    printed = fit_panel(truth.centres_px, CAMERA, replace(Config(), method="paper_as_printed"))
    assert printed.method == "paper_as_printed"
    assert not np.array_equal(
        printed.R_camera_panel, fit_panel(truth.centres_px, CAMERA, replace(Config(), method="paper")).R_camera_panel
    )


FLOATS = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True), st.floats(-10, 700), st.integers(0, 20).map(lambda n: 30.0 * n)
)


@pytest.mark.parametrize("method", METHODS)
@settings(max_examples=60, deadline=None, derandomize=True)
@given(points=arrays(np.float64, st.tuples(st.integers(0, 14), st.just(2)), elements=FLOATS))
@pytest.mark.filterwarnings("error")
def test_any_numbers_give_a_result_without_warnings(points: Array, method: str) -> None:
    fit = fit_panel(points, CAMERA, with_values(FAST, {"method": method}))
    assert fit.status
    if fit.ok:
        assert np.isfinite(fit.t_camera_panel).all() and np.isfinite(fit.covariance).all()


def test_config_refuses_unknown_and_impossible_values() -> None:
    with pytest.raises(ValueError, match=r"em\.no_such"):
        with_values(Config(), {"em.no_such": 1})
    with pytest.raises(ValueError, match="inlier_share"):
        with_values(Config(), {"em.inlier_share": 2.0})
    with pytest.raises(ValueError, match="max_rows"):
        with_values(Config(), {"size.max_rows": 2.5})
    with pytest.raises(ValueError, match="method"):
        Config(method="magic")


def test_camera_of_another_kind_of_lens() -> None:
    narrow = Camera.from_matrix([[1000, 0, 640], [0, 1000, 480], [0, 0, 1]], 1280, 960)
    truth = scene(8, camera=narrow, sigma_px=0.3)
    fit = fit_panel(truth.centres_px, narrow)
    assert fit.status in ("ok", "uncertain", "not_converged")
