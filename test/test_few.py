"""Panels of few buttons: outlines, straight edges, ambiguity."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elevator_rectify.benchmark.pictures import few_pictured
from elevator_rectify.core import Camera, Config, Detection, fit_panel, rectify_image
from elevator_rectify.core.config import with_values
from elevator_rectify.core.find import of_own_boxes
from elevator_rectify.core.geometry.rotations import rotation, rotation_angle_rad
from elevator_rectify.core.outline.refinement import moved, system
from elevator_rectify.core.outline.result import turn_of
from elevator_rectify.core.outline.shapes import OutlineModel, drawn, normals, shape_points
from elevator_rectify.core.picture.straight_edges import segments_of, sharpened, support
from elevator_rectify.core.types import Array, FitResult, Image
from elevator_rectify.render.panel import Look, regular_panel
from elevator_rectify.render.photograph import photograph
from elevator_rectify.render.scene import DetectorModel, Scene, detected, paper_camera

NO_EDGES = with_values(Config(), {"outline.edges": False})


def normal_error_deg(fit: FitResult, R: Array) -> float:
    return float(np.rad2deg(np.arccos(np.clip(fit.R_camera_panel[:, 2] @ R[:, 2], -1.0, 1.0))))


def plate(R: Array) -> Image:
    """Return a picture of a bright plate of known rotation, half a metre away."""
    corners = np.array([[-0.1, -0.15, 0], [0.1, -0.15, 0], [0.1, 0.15, 0], [-0.1, 0.15, 0]]) @ R.T + [0, 0, 0.5]
    fine = paper_camera().project(corners) * 64
    image = np.full((480, 640), 60, np.uint8)
    cv2.fillPoly(image, [fine.round().astype(np.int32)], 200, cv2.LINE_AA, 6)
    return cv2.GaussianBlur(image, (0, 0), 0.8)


def test_rounded_rectangles_are_circles_and_rectangles_at_their_ends() -> None:
    np.testing.assert_allclose(np.linalg.norm(shape_points(np.ones(2), np.array(1.0)), axis=1), 1.0, atol=1e-9)
    box = shape_points(np.array([2.0, 1.0]), np.array(0.02))
    inside = np.abs(box) - [2.0, 1.0]
    np.testing.assert_allclose(inside.max(axis=1), 0.0, atol=0.01)


@settings(deadline=None, derandomize=True)
@given(st.floats(0.2, 5.0), st.floats(0.2, 5.0), st.floats(0.02, 1.0))
def test_points_of_a_rounded_rectangle_are_at_no_distance_from_it(width: float, height: float, corner: float) -> None:
    half = np.array([width, height])
    radius = corner * half.min()
    q = np.abs(shape_points(half, np.array(corner))) - half + radius
    distance = np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0) - radius
    np.testing.assert_allclose(distance, 0.0, atol=1e-9)


@pytest.mark.parametrize("distortion", [(), (-0.2, 0.05, 0.001, -0.002, 0.0)])
@pytest.mark.parametrize("round_shape", [True, False])
def test_the_outlines_derivatives_are_those_of_finite_differences(
    round_shape: bool, distortion: tuple[float, ...]
) -> None:
    K = [[500.0, 0, 320], [0, 510.0, 240], [0, 0, 1]]
    camera = Camera.from_matrix(K, 640, 480, distortion, "plumb_bob")
    centres = np.array([[0.0, 0.0], [0.1, 0.02], [-0.1, 0.12]])
    R = rotation(np.array([0.4, -0.3, 0.05]))
    model = OutlineModel(R, np.array([0.05, -0.02, 1.0]), centres, np.array([0.04, 0.03]), 0.4, round_shape)
    outlines = drawn(model, camera)
    error, J = system(model, camera, outlines, normals(outlines))
    np.testing.assert_allclose(error, 0.0, atol=1e-9)
    step = 1e-5
    for k, d in enumerate(step * np.eye(model.parameters)):
        further, back = (system(moved(model, s * d), camera, outlines, normals(outlines))[0] for s in (1.0, -1.0))
        # Second differences of pixels: 1e3 px times the step squared; the corner's join jumps by as much.
        np.testing.assert_allclose(J[..., k], (back - further) / (2.0 * step), atol=2e-2, rtol=1e-3)


def test_straight_edges_find_the_rotation_of_a_plate() -> None:
    truth = rotation(np.array([0.35, -0.3, 0.05]))
    segments = segments_of(plate(truth), paper_camera(), 60.0)
    assert len(segments.normal) >= 4
    start = rotation(np.array([0.03, 0.02, -0.02])) @ truth
    found, covariance = sharpened(start, 0.05**2 * np.eye(3), segments)
    assert rotation_angle_rad(found.T @ truth) < np.deg2rad(0.5)
    assert np.linalg.eigvalsh(covariance)[-1] < 0.5**2 * 0.05**2
    assert support(segments, truth) > support(segments, rotation(np.array([-0.35, 0.3, 0.05]))) + 3.0


@pytest.mark.parametrize(("shape", "buttons"), [("round", 2), ("round", 3), ("square", 2), ("square", 3)])
def test_outlines_give_the_normal_of_few_buttons(shape: str, buttons: int) -> None:
    errors = []
    for number in range(5):
        scene, image = few_pictured(shape, buttons, 601, number)
        fit = fit_panel(scene.detections, scene.camera, image=image)
        assert fit.method == "outlines" or fit.status == "too_few_detections"
        if fit.ok:
            errors.append(normal_error_deg(fit, scene.R_camera_panel))
            assert len(fit.buttons) == buttons and fit.rows * fit.columns == buttons
            assert np.linalg.eigvalsh(fit.covariance)[0] > 0
            rectify_image(image, scene.camera, fit)
    assert len(errors) >= 3 and np.median(errors) < 1.5 and max(errors) < 5.0


@pytest.mark.parametrize(("shape", "buttons"), [("round", 4), ("round", 5), ("square", 4)])
def test_few_buttons_in_two_columns_have_their_rows_and_columns(shape: str, buttons: int) -> None:
    """The longest direction of so few is no row: the lines that several share are."""
    accepted = 0
    for number in range(5):
        scene, image = few_pictured(shape, buttons, 607, number)
        fit = fit_panel(scene.detections, scene.camera, image=image)
        if fit.ok:
            accepted += 1
            # Tilt and turn together; the confidence leaves some beyond it, none of these.
            assert np.rad2deg(rotation_angle_rad(fit.R_camera_panel.T @ scene.R_camera_panel)) < 4.0
            true = scene.panel.cells[scene.button]
            assert (fit.cells == true).all() and (fit.rows, fit.columns) == tuple(true.max(axis=0) + 1)
            places = fit.reading.places
            assert (places.shown == (places.detection >= 0)).all()
    assert accepted >= 3


def test_a_missed_button_of_a_single_row_or_column_leaves_its_place_in_the_numbering() -> None:
    numbered, refused = 0, 0
    for number in range(8):
        scene, image = single_line(number)
        missed = 1 + number % 3
        kept = [d for d, button in zip(scene.detections, scene.button, strict=True) if button != missed]
        fit = fit_panel(kept, scene.camera, image=image)
        if not fit.ok:
            refused += 1
            continue
        true = scene.panel.cells[scene.button[scene.button != missed]]
        assert (fit.cells == true).all() and fit.rows * fit.columns == 5
        numbered += 1
    assert numbered >= 5, refused


def single_line(number: int) -> tuple[Scene, Image]:
    """Return a scene and picture of five buttons in one row or column."""
    rng = np.random.default_rng([608, number])
    look = replace(Look(), shape=("round", "square")[number % 2], corner_share=(1.0, 0.3)[number % 2], aspect=1.0)
    panel = regular_panel(*((5, 1) if number // 2 % 2 else (1, 5)), look=look)
    R = rotation(np.deg2rad([rng.uniform(-25, 25), rng.uniform(-25, 25), rng.uniform(-3, 3)]))
    t = np.array([0.0, 0.0, 0.25]) - R @ panel.points_m.mean(axis=0)
    scene = detected(panel, paper_camera(), R, t, DetectorModel(0.5), rng)
    return scene, photograph(scene, rng)


def test_rows_run_along_the_lines_that_buttons_share() -> None:
    corner = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 3.0]])
    for degrees in (-6.0, 0.0, 4.0):
        turn = turn_of(corner @ plane_turn(degrees).T, 1.0, 0.1, 0.002)
        assert turn.angle_rad == pytest.approx(np.deg2rad(degrees), abs=1e-9) and turn.margin > 6.0


def test_rows_that_may_run_two_ways_are_ambiguous() -> None:
    """A triangle of equal sides: any of its sides may be a row or a column."""
    corners = 3.0 * np.array([[0.0, 0.0], [1.0, 0.0], [0.5, np.sqrt(0.75)]])
    turned = turn_of(corners @ plane_turn(15.0).T, 1.0, 0.1, 0.002)
    assert turned.margin < 1e-9


def plane_turn(degrees: float) -> Array:
    return rotation(np.array([0.0, 0.0, np.deg2rad(degrees)]))[:2, :2]


def test_one_circle_alone_is_ambiguous_and_both_poses_are_there() -> None:
    better = []
    for number in range(6):
        scene, image = few_pictured("round", 1, 602, number)
        fit = fit_panel(scene.detections, scene.camera, NO_EDGES, image=image)
        assert not fit.ok
        if fit.status == "ambiguous":
            poses = [fit, *fit.alternatives]
            better.append(min(normal_error_deg(p, scene.R_camera_panel) for p in poses))
    assert len(better) >= 4 and np.median(better) < 2.0


def test_gravity_settles_a_circle_seen_from_above() -> None:
    settled = 0
    for number in range(30):
        scene, image = few_pictured("round", 1, 603, number)
        up = -scene.R_camera_panel[:, 1]
        if abs(scene.R_camera_panel[2, 1]) < 0.25:
            continue
        values = {f"outline.up_{axis}": float(u) for axis, u in zip("xyz", up, strict=True)}
        fit = fit_panel(scene.detections, scene.camera, with_values(NO_EDGES, values), image=image)
        if fit.ok:
            settled += 1
            assert normal_error_deg(fit, scene.R_camera_panel) < 4.0
    assert settled >= 2


def test_the_buttons_size_gives_the_distance() -> None:
    scene, image = few_pictured("square", 2, 604, 1)
    size = scene.panel.look.button_share * min(scene.panel.pitch_m)
    config = with_values(Config(), {"outline.button_size_m": size})
    fit = fit_panel(scene.detections, scene.camera, config, image=image)
    assert fit.ok and fit.metric
    middle = scene.panel.points_m.mean(axis=0) @ scene.R_camera_panel.T + scene.t_camera_panel
    # Rings and caps are taken for one another: their sizes differ by up to a fifth.
    assert np.linalg.norm(fit.grid_points.mean(axis=(0, 1))) == pytest.approx(float(np.linalg.norm(middle)), rel=0.25)


def test_without_picture_or_sizes_few_buttons_stay_refused() -> None:
    scene, image = few_pictured("round", 2, 605, 0)
    assert fit_panel(scene.detections, scene.camera).status == "too_few_detections"
    fit = fit_panel(scene.centres_px, scene.camera, image=image)
    assert fit.status == "too_few_detections" and "without sizes" in fit.reason
    black = fit_panel(scene.detections, scene.camera, image=np.zeros_like(image))
    assert black.status == "too_few_detections" and "no outlines" in black.reason


def test_the_order_of_the_boxes_does_not_matter() -> None:
    scene, image = few_pictured("round", 3, 606, 2)
    given = list(scene.detections)
    one, other = (fit_panel(d, scene.camera, image=image) for d in (given, given[::-1]))
    np.testing.assert_allclose(one.R_camera_panel, other.R_camera_panel, atol=1e-6)
    assert replace(one, cells=other.cells).status == other.status


def test_boxes_without_extent_show_no_outlines() -> None:
    """Sizes next to nothing once met an empty picture, and a ratio of zeros."""
    tiny = [Detection(0.0, 0.0, 8.5e-280, 8.5e-280), Detection(300.0, 1.0, 1.0, 8.5e-280)]
    fit = fit_panel(tiny, paper_camera(), image=NOISE)
    assert fit.status == "too_few_detections" and "less than 2 px" in fit.reason


NOISE = np.random.default_rng(1).integers(0, 255, (480, 640, 3), dtype=np.uint8)
PLATE = cv2.cvtColor(plate(rotation(np.array([0.3, 0.1, 0.0]))), cv2.COLOR_GRAY2BGR)
numbers = st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.floats(-50.0, 700.0))
boxes = st.builds(Detection, numbers, numbers, numbers, numbers, st.sampled_from(["", "7", "up"]), numbers)


@settings(max_examples=120, deadline=None)
@given(detections=st.lists(boxes, max_size=9), picture=st.sampled_from([NOISE, PLATE, np.zeros_like(NOISE)]))
def test_any_boxes_in_any_picture_give_a_result(detections: list[Detection], picture: Image) -> None:
    fit = fit_panel(detections, paper_camera(), image=picture)
    assert fit.status and (fit.ok or fit.reason)
    assert len(fit.cells) == len(detections)
    if fit.ok:
        assert np.isfinite(fit.covariance).all() and np.isfinite(fit.grid_px).all()


def test_a_single_box_is_as_sure_as_its_score() -> None:
    """What our own detector takes for a lone button may be a screw; other detectors' scores are not probabilities."""
    for number in range(10):
        scene, image = few_pictured("round", 1, 7, number)
        (box,) = scene.detections
        sure, unsure = (
            fit_panel([replace(box, label="", score=score)], scene.camera, image=image) for score in (0.999, 0.6)
        )
        assert unsure.status == sure.status
        if sure.ok:
            assert of_own_boxes(sure, Config()).ok
            found = of_own_boxes(unsure, Config())
            assert found.status == "low_confidence" and found.confidence < 0.61
            return
    raise AssertionError("no scene is accepted")
