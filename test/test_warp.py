import numpy as np
import pytest

from elevator_rectify.core import Camera, fit_panel, rectify_image
from elevator_rectify.core.config import ViewConfig
from elevator_rectify.core.types import Array
from elevator_rectify.render.photograph import photograph
from test.scenes import distorted_camera, scene


def dots(points: Array, width: int, height: int) -> Array:
    """A picture with a bright Gaussian spot at each point."""
    v, u = np.mgrid[:height, :width]
    picture = np.zeros((height, width))
    for x, y in points:
        picture += 255 * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * 1.5**2))
    return picture


def centroid(picture: Array, at: Array) -> Array:
    x, y = at.round().astype(int)
    window = picture[y - 6 : y + 7, x - 6 : x + 7].astype(float)
    v, u = np.mgrid[y - 6 : y + 7, x - 6 : x + 7]
    return np.array([(window * u).sum(), (window * v).sum()]) / window.sum()


@pytest.mark.parametrize("model", ["none", "plumb_bob", "equidistant"])
def test_rectified_picture_shows_the_buttons_where_its_camera_says(model: str) -> None:
    truth = scene(2, tilt_deg=20.0, camera=None if model == "none" else distorted_camera(model))
    camera, fit = truth.camera, fit_panel(truth.centres_px, truth.camera)
    picture = dots(truth.pixels, camera.width, camera.height)
    view = rectify_image(picture.clip(0, 255).astype(np.uint8), camera, fit)
    expected = view.camera.project(fit.grid_points.reshape(-1, 3) @ view.R_rectified_camera.T)
    whole = ((fit.grid_px > 8) & (fit.grid_px < [631, 471])).all(axis=-1).ravel()
    measured = np.array([centroid(view.image, p) for p in expected[whole]])
    # Spots become ellipses whose centroid moves by less than this, and bilinear sampling blurs.
    np.testing.assert_allclose(measured, expected[whole], atol=0.2)
    rows = expected.reshape(fit.rows, fit.columns, 2)
    assert np.ptp(rows[..., 1], axis=1).max() < 1e-6, "rows are horizontal"
    assert np.ptp(rows[..., 0], axis=0).max() < 1e-6, "columns are vertical"


def test_homography_maps_undistorted_pixels() -> None:
    truth = scene(3, tilt_deg=20.0)
    fit = fit_panel(truth.centres_px, truth.camera)
    view = rectify_image(np.zeros((480, 640, 3), np.uint8), truth.camera, fit)
    mapped = np.column_stack([fit.grid_px.reshape(-1, 2), np.ones(fit.rows * fit.columns)]) @ view.H_rectified_image.T
    expected = view.camera.project(fit.grid_points.reshape(-1, 3) @ view.R_rectified_camera.T)
    np.testing.assert_allclose(mapped[:, :2] / mapped[:, 2:], expected, atol=1e-6)


def test_best_seen_side_keeps_its_resolution_and_the_size_is_bounded() -> None:
    truth = scene(4, tilt_deg=15.0)
    fit = fit_panel(truth.centres_px, truth.camera)
    image = np.zeros((480, 640), np.uint8)
    view = rectify_image(image, truth.camera, fit)
    along_rows = np.linalg.norm(np.diff(fit.grid_px, axis=1), axis=2).max()
    pitch_px = view.camera.matrix[0, 0] * fit.pitch[0] / float((fit.R_camera_panel.T @ fit.t_camera_panel)[2])
    assert 0.95 * along_rows < pitch_px < 1.6 * along_rows
    small = rectify_image(image, truth.camera, fit, ViewConfig(max_size_px=100))
    assert max(small.image.shape) == 100


@pytest.mark.parametrize("share", [1.0, 0.25])
def test_no_more_pixels_come_out_than_went_in(share: float) -> None:
    truth = scene(6, tilt_deg=55.0)
    fit = fit_panel(truth.centres_px, truth.camera)
    view = rectify_image(np.zeros((480, 640), np.uint8), truth.camera, fit, ViewConfig(max_share=share))
    # Each side is rounded to whole pixels.
    assert view.image.size <= share * 480 * 640 * 1.01
    free = rectify_image(np.zeros((480, 640), np.uint8), truth.camera, fit, ViewConfig(max_share=100.0))
    assert free.image.size > 480 * 640, "the scene asks for more"


def test_unfitted_or_mismatched_input_is_an_exception() -> None:
    truth = scene(5)
    fit = fit_panel(truth.centres_px, truth.camera)
    with pytest.raises(ValueError, match="640 x 480"):
        rectify_image(np.zeros((10, 10), np.uint8), truth.camera, fit)
    with pytest.raises(ValueError, match="too_few"):
        rectify_image(np.zeros((480, 640), np.uint8), truth.camera, fit_panel(np.zeros((0, 2)), truth.camera))


def test_rendered_picture_has_the_buttons_at_the_true_pixels() -> None:
    """White on black: the mean of a button's light pixels is the image of its centre."""
    truth = scene(
        6,
        rows=3,
        columns=2,
        tilt_deg=0.0,
        camera=Camera.from_matrix([[320, 0, 320], [0, 320, 240], [0, 0, 1]], 640, 480),
    )
    picture = photograph(truth, np.random.default_rng(0)).astype(float).mean(axis=2)
    for x, y in truth.pixels:
        u, v = round(x), round(y)
        radius = 0.31 * np.linalg.norm(truth.pixels[1] - truth.pixels[0])
        rim = [picture[round(v + radius * 1.05 * s), u] for s in (-1, 1)]
        face = picture[round(v - radius * 0.75), u]
        assert face > np.mean(rim), "the face is lighter than the rim around it"
