import numpy as np
import pytest

from elevator_rectify.core import Camera
from test.scenes import DISTORTED, distorted_camera


@pytest.mark.parametrize("model", [*DISTORTED, "none"])
def test_pixels_to_rays_and_back(model: str) -> None:
    camera = (
        Camera.from_matrix([[320, 0, 320], [0, 320, 240], [0, 0, 1]], 640, 480)
        if model == "none"
        else distorted_camera(model)
    )
    pixels = np.random.default_rng(0).uniform([80, 60], [560, 420], (50, 2))
    # The iterative inversion stops at 1e-10 in the normalised plane or after 60 steps.
    np.testing.assert_allclose(camera.pixels(camera.rays(pixels)), pixels, atol=1e-4)


def test_points_behind_the_camera_have_no_pixel() -> None:
    camera = distorted_camera("plumb_bob")
    assert np.isnan(camera.project(np.array([[0.0, 0.0, -1.0]]))).all()
    assert np.isfinite(camera.project(np.array([[0.0, 0.0, 1.0]]))).all()


@pytest.mark.parametrize(
    ("K", "D", "model", "word"),
    [
        (np.zeros((3, 3)), [], "plumb_bob", "uncalibrated"),
        (np.diag([-1.0, 1.0, 1.0]), [], "plumb_bob", "uncalibrated"),
        (np.full((3, 3), np.nan), [], "plumb_bob", "finite"),
        (np.eye(3), [0.1] * 3, "plumb_bob", "3 coefficients"),
        (np.eye(3), [0.1] * 4, "fisheye?", "fisheye?"),
    ],
)
def test_impossible_cameras_are_named(K: object, D: list[float], model: str, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        Camera.from_matrix(K, 640, 480, D, model)


def test_zero_coefficients_mean_no_distortion() -> None:
    assert not Camera.from_matrix(np.eye(3), 2, 2, np.zeros(5)).distorted


def test_an_equidistant_lens_without_coefficients_is_no_pinhole() -> None:
    camera = Camera.from_matrix([[300, 0, 320], [0, 300, 240], [0, 0, 1]], 640, 480, [], "equidistant")
    angle = np.deg2rad(30.0)
    # r = f theta, where a pinhole has f tan theta: 157 px instead of 173.
    np.testing.assert_allclose(camera.pixels(np.array([[np.tan(angle), 0.0]])), [[320 + 300 * angle, 240]], atol=1e-6)


def test_calibrations_of_another_length_are_what_they_mean() -> None:
    K, five = [[300, 0, 320], [0, 300, 240], [0, 0, 1]], [-0.2, 0.1, 1e-3, 2e-3, 0.01]
    plain = Camera.from_matrix(K, 640, 480, five)
    for D, model in (([*five, 0, 0, 0], "plumb_bob"), (five, "rational_polynomial")):
        other = Camera.from_matrix(K, 640, 480, D, model)
        np.testing.assert_array_equal(other.pixels(np.array([[0.3, -0.2]])), plain.pixels(np.array([[0.3, -0.2]])))


@pytest.mark.parametrize(
    "K", [[[320, 0, 0], [0, 320, 0], [320, 240, 1]], np.diag([320.0, 320.0, 0.0]), np.diag([320.0, 320.0, 2.0])]
)
def test_a_matrix_of_another_form_is_refused(K: object) -> None:
    with pytest.raises(ValueError, match="is not"):
        Camera.from_matrix(K, 640, 480)
