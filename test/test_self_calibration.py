"""The camera's calibration from views of a panel: exact without noise, honest with it, and known not to be known."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from elevator_rectify.core import Camera, fit_panel
from elevator_rectify.core.self_calibration import (
    PanelShape,
    Sighting,
    _linear,
    _residual,
    calibrated,
    shape_of_panel,
    sighting_of,
)
from elevator_rectify.recordings import calibrate_camera
from elevator_rectify.recordings.look import read_camera_info
from elevator_rectify.render.panel import regular_panel
from elevator_rectify.render.photograph import photograph
from elevator_rectify.render.scene import DetectorModel, Viewpoint, camera_pose, make_scene
from elevator_rectify.ros.camera_check import CameraCheck

PANEL = regular_panel(6, 3, 0.05)
GIVEN = Camera.from_matrix([[420, 0, 320], [0, 420, 240], [0, 0, 1]], 640, 480)


def true_camera(share: float = 1.0, k1: float = 0.0, ratio: float = 1.0) -> Camera:
    f = 420.0 * share
    K = [[f / np.sqrt(ratio), 0, 320], [0, f * np.sqrt(ratio), 240], [0, 0, 1]]
    return Camera.from_matrix(K, 640, 480, [k1, 0, 0, 0, 0])


def shape(aspect: float = 50 / 45) -> PanelShape:
    return PanelShape(
        np.arange(6.0),
        np.arange(3.0),
        np.zeros(6),
        np.zeros(3),
        np.array([0, 0, 0, 0, 1, 1]),
        np.zeros(3, dtype=np.int64),
        aspect,
    )


def sightings(camera: Camera, number: int, sigma_px: float, seed: int, tilted: bool = True) -> list[Sighting]:
    """Views whose start is off by some degrees and percents; some buttons are not seen."""
    rng, views = np.random.default_rng(seed), []
    for _ in range(number):
        tilt = rng.uniform(0.35, 0.8) if tilted else 0.0
        view = Viewpoint(tilt, rng.uniform(0, 6.28), rng.normal(0, 0.1), rng.uniform(0.7, 0.9))
        R, t = camera_pose(PANEL, camera, view)
        seen = np.flatnonzero(rng.random(18) > 0.1)
        pixels = camera.project(PANEL.points_m[seen] @ R.T + t) + rng.normal(0, sigma_px, (len(seen), 2))
        start = np.concatenate([cv2.Rodrigues(R)[0].ravel(), t / 0.045]) * (1.0 + rng.normal(0, 0.02, 6))
        views.append(Sighting(PANEL.cells[seen], pixels, np.full(len(seen), max(sigma_px, 0.05)), start))
    return views


def test_the_jacobian_is_that_of_central_differences() -> None:
    (view,) = sightings(true_camera(1.02, 0.03), 1, 0.0, 1)
    shared = np.array([0.01, 0.0, 0.02, 0.03, 0.1])
    error, J, weight = _linear(view, shape(), GIVEN, shared, view.pose)
    assert error.shape == weight.shape and J.shape == (len(error), 11)
    for k in range(11):
        ahead, back = (np.concatenate([view.pose, shared]) for _ in range(2))
        ahead[k] += 1e-4
        back[k] -= 1e-4
        both = [_residual(view, shape(), GIVEN, at[6:], at[:6]).ravel() for at in (back, ahead)]
        np.testing.assert_allclose(J[:, k], (both[0] - both[1]) / 2e-4, rtol=2e-3, atol=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_without_noise_the_camera_is_exact(seed: int) -> None:
    true = true_camera(1.05, -0.06)
    # The ratio of the pitches is off by 3 % to begin with.
    found = calibrated(sightings(true, 6, 0.0, seed), shape(50 / 45 * 1.03), GIVEN)
    assert found.focal_share == pytest.approx(1.05, abs=1e-4) and found.k1 == pytest.approx(-0.06, abs=1e-4)
    assert found.rms_px[0] > 10 * found.rms_px[1] and found.significant and "1.050" in str(found)


def test_pixels_that_are_not_square_are_found_where_they_are_asked_for() -> None:
    true = true_camera(1.0, 0.0, 1.02)
    found = calibrated(sightings(true, 8, 0.0, 5), shape(), GIVEN, pixel_ratio=True)
    assert found.ratio == pytest.approx(1.02, abs=1e-3) and np.isfinite(found.ratio_std)
    assert np.isinf(calibrated(sightings(true, 8, 0.0, 5), shape(), GIVEN).ratio_std)


def test_ten_views_know_the_focal_length_and_the_distortion_as_well_as_they_say() -> None:
    off = []
    for seed in range(20):
        rng = np.random.default_rng([seed, 3])
        share, k1 = float(np.exp(rng.uniform(-0.06, 0.06))), float(rng.uniform(-0.08, 0.08))
        found = calibrated(sightings(true_camera(share, k1), 10, 0.2, seed), shape(), GIVEN)
        off.append((np.log(found.focal_share / share), found.focal_std, found.k1 - k1, found.k1_std))
    f, f_std, k, k_std = np.abs(np.array(off)).T
    # A button known to 0.2 px, ten views: half a percent and .01.
    assert np.median(f) < 0.005 and np.median(k) < 0.01
    assert (f < 2.0 * f_std).mean() >= 0.9 and (k < 2.0 * k_std).mean() >= 0.9 and np.median(f / f_std) > 0.15


def test_views_from_the_front_do_not_tell_and_say_so() -> None:
    found = calibrated(sightings(true_camera(1.05), 6, 0.2, 7, tilted=False), shape(), GIVEN)
    assert found.focal_std > 0.03 and not found.significant
    with pytest.raises(ValueError, match="2 views, 3 needed"):
        calibrated(sightings(true_camera(), 2, 0.2, 7), shape(), GIVEN)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """One panel from six sides, by a camera of 420 px."""
    rng, folder, paths = np.random.default_rng(4), tmp_path_factory.mktemp("views"), []
    for k in range(6):
        view = Viewpoint(0.3 + 0.06 * k, 1.1 * k, 0.0, 0.8)
        scene = make_scene(PANEL, true_camera(), view, DetectorModel(), rng)
        paths.append(folder / f"{k}.png")
        cv2.imwrite(str(paths[-1]), photograph(scene, rng))
    return paths


def test_photographs_calibrate_the_camera(
    pictures: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output, drawn = tmp_path / "camera.yaml", tmp_path / "residuals.png"
    options = [*map(str, pictures), "--focal-px", "435", "-o", str(output), "--picture", str(drawn)]
    assert calibrate_camera.main(options) == 0
    assert "focal length over the given one" in capsys.readouterr().out
    camera = read_camera_info(output, 640, 480)
    assert camera.focal_px == pytest.approx(420.0, rel=0.01)
    assert cv2.imread(str(drawn)).shape == (480, 640, 3)
    assert yaml.safe_load(output.read_text())["projection_matrix"]["cols"] == 4
    assert calibrate_camera.main([*map(str, pictures[:2]), "--focal-px", "435", "-o", str(tmp_path / "no.yaml")]) == 1
    assert not (tmp_path / "no.yaml").exists()


def test_the_node_notices_a_wrong_focal_length_and_tells_it_once(pictures: list[Path]) -> None:
    given = Camera.from_matrix([[450, 0, 320], [0, 450, 240], [0, 0, 1]], 640, 480)
    check = CameraCheck()
    assert "not yet known" in check.text and not check.warning() and not check.found
    rng = np.random.default_rng(4)
    for k, path in enumerate(pictures):
        scene = make_scene(PANEL, true_camera(), Viewpoint(0.3 + 0.06 * k, 1.1 * k, 0.0, 0.8), DetectorModel(), rng)
        image = cv2.imread(str(path))
        fit = fit_panel(list(scene.detections), given, image=image)
        assert fit.ok and sighting_of(fit) is not None and shape_of_panel(fit).gaps == 0, fit.reason
        for _ in range(2):
            check.add(fit, given)
    assert check.settled(10.0)
    assert check.estimate is not None and check.estimate.focal_share == pytest.approx(420 / 450, rel=0.015)
    assert check.estimate.views == 5, "a view is counted once"
    assert "camera_info looks wrong" in check.warning() and not check.warning()
    assert check.found.startswith("focal length 0.9")
    # Another panel begins anew.
    other = regular_panel(5, 4)
    scene = make_scene(other, given, Viewpoint(0.4, 1.0, 0.0, 0.8), DetectorModel(), rng)
    fit = fit_panel(list(scene.detections), given, image=photograph(scene, rng))
    for _ in range(10):
        assert check.estimate is not None
        check.add(fit, given)
    assert "1 views" in check.text
