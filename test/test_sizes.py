"""What the boxes' sizes say of a pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elevator_rectify.benchmark.adversarial import UNPICTURED
from elevator_rectify.benchmark.negatives import boxed
from elevator_rectify.core import Config, Detection, fit_panel
from elevator_rectify.core.confidence import rotation_std_rad
from elevator_rectify.core.config import InputConfig
from elevator_rectify.core.detections import usable_detections
from elevator_rectify.core.geometry.rotations import rotation
from elevator_rectify.core.lattice.joint import fit_joint
from elevator_rectify.core.lattice.layout import Layout, LayoutFit, depths, moved, pose_at
from elevator_rectify.core.lattice.refinement import Poses, stepped
from elevator_rectify.core.lattice.sizes import contradiction, size_features, size_information, size_nats
from elevator_rectify.core.types import Array, FitResult
from elevator_rectify.render.scene import paper_camera
from test.scenes import rotation_error_deg, scene

# Boxes have a margin: they shrink by this share of what their buttons do (`sizes`).
SLOPE = 0.9


def tilted() -> LayoutFit:
    """Return a fit of five rows and three columns with a gap in both directions, a detection on every node."""
    layout = Layout(np.array([0.0, 1, 2, 3.4, 4.4]), np.array([0.0, 1, 2.6]), np.zeros(5), np.zeros(3), (3,), (2,))
    pose = Poses(
        rotation(np.array([0.4, -0.5, 0.05]))[None], np.array([[0.3, -0.2, 8.0]]), np.array([0.1]),
        np.array([[1.0, 2.0]]), np.zeros(1),
    )  # fmt: skip
    return LayoutFit(pose, layout, np.arange(15), np.ones(15), 0.01, 0.0)


def seen(fit: LayoutFit) -> Array:
    """Return the sizes (N,) without noise."""
    return np.asarray(4.0 - 1.5 * SLOPE * np.log(depths(fit)[0]))


def turned(fit: LayoutFit, step: Array) -> LayoutFit:
    """Return the fit after a step of its pose and gaps."""
    pose, layout = stepped(fit.pose, step[None, :7]), moved(fit.layout, step[7:])
    return LayoutFit(pose, layout, fit.node, fit.inlier, fit.sigma, fit.log_likelihood)


def test_the_depths_derivative_is_that_of_finite_differences() -> None:
    fit, h = tilted(), 1e-5
    _, derivative = depths(fit)
    for k, e in enumerate(np.eye(9)):
        numeric = (depths(turned(fit, h * e))[0] - depths(turned(fit, -h * e))[0]) / (2 * h)
        # Central differences of smooth functions of order 1: h^2 and rounding / h.
        np.testing.assert_allclose(derivative[:, k], numeric, atol=1e-8)


def test_sizes_pull_a_wrong_pose_back_as_far_as_it_is_off() -> None:
    """At the truth they pull nowhere; near it, to first order, by what they know of the way to it."""
    fit = tilted()
    assert np.abs(size_information(*depths(fit), seen(fit), fit.inlier)[1]).max() < 1e-9
    step = 1e-4 * np.array([1.0, -2, 3, 4, -5, 2, 1, 2, -1])
    information, pull = size_information(*depths(turned(fit, step)), seen(fit), fit.inlier)
    assert np.linalg.norm(pull) > 1e-3
    np.testing.assert_allclose(pull, -information @ step, rtol=0.02, atol=0.02 * float(np.abs(pull).max()))


def test_neither_the_order_nor_a_common_factor_of_the_sizes_matters() -> None:
    fit, rng = tilted(), np.random.default_rng(3)
    depth, derivative = depths(fit)
    sizes, order = seen(fit) + rng.normal(0, 0.05, 15), rng.permutation(15)
    usual = size_information(depth, derivative, sizes, fit.inlier)
    other = size_information(depth[order], derivative[order], sizes[order] + 1.7, fit.inlier)
    for one, two in zip(usual, other, strict=True):
        np.testing.assert_allclose(one, two, atol=1e-8 * float(np.abs(one).max()))
    assert size_nats(depth, sizes, fit.inlier) == pytest.approx(size_nats(depth[order], sizes[order] + 1.7, fit.inlier))


def test_without_sizes_nothing_is_said() -> None:
    fit = tilted()
    depth, derivative = depths(fit)
    unknown = np.full(15, np.nan)
    information, pull = size_information(depth, derivative, unknown, fit.inlier)
    assert not information.any() and not pull.any() and size_nats(depth, unknown, fit.inlier) == 0.0
    few = np.where(np.arange(15) < 3, seen(fit), np.nan)
    assert not size_information(depth, derivative, few, fit.inlier)[0].any()


def test_one_larger_button_hardly_turns_the_panel() -> None:
    fit = tilted()
    sizes = seen(fit)
    larger = sizes + np.where(np.arange(15) == 2, 0.7, 0.0)
    _, pull = size_information(*depths(fit), larger, fit.inlier)
    all_of_it = size_information(*depths(fit), sizes + np.where(np.arange(15) == 2, 0.06, 0.0), fit.inlier)[1]
    assert np.abs(pull).max() < np.abs(all_of_it).max()


def test_a_pose_that_is_known_badly_is_known_better_by_sizes() -> None:
    """Two rows of three with the noise of boxes: over the same scenes the error falls, and the covariance says so."""
    camera, config = paper_camera(), Config()
    sigma, area = 4.0 / camera.focal_px, camera.width * camera.height / camera.focal_px**2
    errors, stds = [], []
    for number in range(30):
        given = scene(number, rows=2, columns=3, tilt_deg=35.0, sigma_px=4.0)
        usable = usable_detections(given.detections, camera, InputConfig())
        for log_sizes in (usable.log_sizes, np.full(6, np.nan)):
            found = fit_joint(usable.rays, log_sizes, sigma, area, config)
            assert found is not None
            fit = found.best
            pose, covariance = pose_at(fit, usable.rays, fit.layout.nodes[0, 0], config.joint, log_sizes=log_sizes)
            errors.append(rotation_error_deg(pose.R, given.R_camera_panel))
            stds.append(rotation_std_rad(covariance[:6, :6]))
    for values in (errors, stds):
        assert np.median(values[::2]) < np.median(values[1::2])


def features(fit: FitResult, detections: list[Detection]) -> Array:
    camera = paper_camera()
    usable = usable_detections(detections, camera, InputConfig())
    return size_features(fit, usable.index, usable.sizes_px, camera)


def test_the_slope_tells_a_right_pose_from_a_panel_that_faces_the_camera() -> None:
    given = scene(4, tilt_deg=35.0)
    fit = fit_panel(given.detections, given.camera)
    assert fit.ok
    off, known, _ = features(fit, list(given.detections))
    # The boxes are those of the rendered buttons with 6 % of noise.
    assert abs(off) < 1.5 and known > 4.0
    alike = boxed(np.array([[d.x_px, d.y_px] for d in given.detections]), np.random.default_rng(0))
    assert features(fit, alike)[0] < -4.0
    bare = [Detection(d.x_px, d.y_px) for d in given.detections]
    assert list(features(fit, bare)[:2]) == [0.0, 0.0]


def test_a_trapezoid_that_faces_the_camera_is_no_tilted_panel() -> None:
    """Its centres alone are those of a tilted panel with gaps; boxes of one size are not."""
    for number in range(6):
        rng = np.random.default_rng([number, 7])
        points = UNPICTURED["trapezoid"](rng)
        fit = fit_panel(boxed(points, rng), paper_camera())
        assert not fit.ok or fit.R_camera_panel[2, 2] > np.cos(np.deg2rad(10.0))
    tilted_fit = fit_panel(scene(4, tilt_deg=35.0).detections, paper_camera())
    alike = boxed(scene(4, tilt_deg=35.0).centres_px, np.random.default_rng(0))
    usable = usable_detections(alike, paper_camera(), InputConfig())
    assert "tilt" in contradiction(tilted_fit, usable.index, usable.sizes_px, paper_camera())
    true = usable_detections(scene(4, tilt_deg=35.0).detections, paper_camera(), InputConfig())
    assert not contradiction(tilted_fit, true.index, true.sizes_px, paper_camera())


def test_boxes_of_one_and_the_same_size_say_nothing() -> None:
    """A detector of points may give all of them a box of its own."""
    given = scene(4, tilt_deg=35.0)
    fixed = [Detection(d.x_px, d.y_px, 24.0, 24.0) for d in given.detections]
    usable = usable_detections(fixed, given.camera, InputConfig())
    assert not usable.telling_sizes_px.any() and np.isnan(usable.log_sizes).all() and (usable.sizes_px == 24.0).all()
    fit = fit_panel(fixed, given.camera)
    assert fit.ok and rotation_error_deg(fit.R_camera_panel, given.R_camera_panel) < 0.1
    true = usable_detections(given.detections, given.camera, InputConfig())
    assert (true.telling_sizes_px == true.sizes_px).all()


def test_a_lattice_over_a_corner_of_two_walls_is_no_tilted_panel() -> None:
    """Behind the corner the boxes are narrower, not lower."""
    for number in range(8):
        walls = UNPICTURED["corner of two walls"](np.random.default_rng([number, 7]))
        fit = fit_panel([Detection(x, y, w, h) for x, y, w, h in walls.tolist()], paper_camera())
        assert not fit.ok or fit.R_camera_panel[2, 2] > np.cos(np.deg2rad(10.0))
    given = scene(4, tilt_deg=35.0)
    fit = fit_panel(given.detections, given.camera)
    column = fit.cells[:, 1]
    narrower = [
        replace(d, width_px=d.width_px * (0.4 if c else 1.0)) for d, c in zip(given.detections, column, strict=True)
    ]
    usable = usable_detections(narrower, given.camera, InputConfig())
    assert "two walls" in contradiction(fit, usable.index, usable.sizes_px, given.camera)
