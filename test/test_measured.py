"""The buttons in the picture: alignment, the pose fitted to it, and pictures that must not mislead."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elevator_rectify.benchmark.end_to_end import stretched_camera, true_detections
from elevator_rectify.benchmark.pictures import SPOILT, pictured
from elevator_rectify.benchmark.turned_reading import turned
from elevator_rectify.core import Camera, Config, JointConfig, fit_panel
from elevator_rectify.core.geometry.common_errors import covariance_if_right, with_common_errors
from elevator_rectify.core.geometry.pose import covariance_at
from elevator_rectify.core.geometry.rotations import rotation, rotation_angle_rad
from elevator_rectify.core.lattice.layout import Layout, LayoutFit
from elevator_rectify.core.lattice.refinement import Poses
from elevator_rectify.core.picture.patches import Window, picture_of, sample
from elevator_rectify.core.picture.straight_edges import Segments, uprightness
from elevator_rectify.core.picture.template import align, make_template, symmetry_centre
from elevator_rectify.core.picture.widening import _Side, _wider
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.types import Array
from elevator_rectify.recordings.evaluate import cells_right
from elevator_rectify.render.scene import Scene, paper_camera
from elevator_rectify.train.labelled import read_labelled

_N = 33
_LABELLED = Path(__file__).parent.parent.parent / "shared" / "data" / "labelled"


def _ring(shift: Array, gain: float = 1.0, offset: float = 0.0) -> Array:
    """Return a blurred ring of radius 9 samples (n, n), moved by (column, row)."""
    at = np.arange(_N) - (_N - 1) / 2
    u, v = np.meshgrid(at - shift[0], at - shift[1])
    return np.asarray(gain * np.exp(-0.5 * ((np.hypot(u, v) - 9.0) / 1.5) ** 2) + offset, dtype=np.float32)


def _error_rad(scene: Scene, fit: GridFit) -> float:
    return rotation_angle_rad(fit.R_camera_panel.T @ scene.R_camera_panel)


def test_alignment_finds_shifts_whatever_gain_and_offset() -> None:
    shifts = np.random.default_rng(3).uniform(-1.0, 1.0, (12, 2))
    shifts -= np.median(shifts, axis=0)
    patches = np.stack([_ring(s, 0.5 + 0.1 * k, 0.1 * k) for k, s in enumerate(shifts)])
    inside = np.ones(patches.shape, dtype=bool)
    template = make_template(np.stack([_ring(np.zeros(2))] * 5), inside[:5], 0.7, 1.5)
    found = align(template, patches, inside)
    # One linear step: its error is of third order in the shift over the blur; differences widen the gradient.
    np.testing.assert_allclose(found.shift, shifts, atol=0.25)
    near = align(template, np.stack([_ring(s) for s in 0.2 * shifts]), inside)
    np.testing.assert_allclose(near.shift, 0.2 * shifts, atol=0.02)
    assert (found.correlation > 0.7).all()


def test_symmetry_finds_the_centre_that_alignment_alone_cannot() -> None:
    for centre in np.array([[0.0, 0.0], [0.8, -0.5], [-1.5, 1.0]]):
        look = _ring(centre)
        template = make_template(np.stack([look] * 5), np.ones((5, _N, _N), dtype=bool), 0.7, 1.5)
        np.testing.assert_allclose(symmetry_centre(template), centre, atol=0.05)


@pytest.mark.parametrize("distortion", [(), (-0.25, 0.08, 0.001, -0.001, 0.0)])
def test_patches_are_sampled_where_the_camera_sees_them(distortion: tuple[float, ...]) -> None:
    camera = Camera.from_matrix([[400, 0, 320], [0, 400, 240], [0, 0, 1]], 640, 480, distortion)
    ramp = np.tile(np.linspace(0, 255, 640).round().astype(np.uint8), (480, 1))
    tilt = np.deg2rad(50.0)
    G = np.column_stack([[np.cos(tilt), 0.0, np.sin(tilt)], [0.0, 1.0, 0.0], [0.3, 0.1, 6.0]])
    nodes, window = np.array([[0.0, 0.0], [2.0, 1.0], [-1.0, -1.0]]), Window(np.array([0.5, 0.5]), 21)
    patches, inside = sample(picture_of(ramp, camera), G, nodes, window)
    along = np.linspace(-0.5, 0.5, 21)
    lattice = nodes[:, None, None] + np.stack(np.meshgrid(along, along), axis=-1)
    pixels = camera.project(lattice @ G[:, :2].T + G[:, 2])
    assert inside.all()
    # Grey values are rounded twice; 255 of them lie over 640 pixels.
    np.testing.assert_allclose(patches, pixels[..., 0] * 255 / 639, atol=1.1)


def test_the_picture_makes_the_pose_several_times_as_exact() -> None:
    by_boxes, by_picture = [], []
    for number in range(6):
        given = pictured("medium", 501, number, held_out=True)
        boxes = fit_panel(given.scene.detections, given.scene.camera)
        fit = fit_panel(given.scene.detections, given.scene.camera, image=given.image)
        if boxes.ok and fit.ok:
            by_boxes.append(_error_rad(given.scene, boxes))
            by_picture.append(_error_rad(given.scene, fit))
            assert fit.measurement is not None and boxes.measurement is None
    assert len(by_picture) >= 4
    assert np.median(by_picture) < 0.5 * np.median(by_boxes)
    assert max(by_picture) < np.deg2rad(2.0)


def test_order_and_grey_do_not_matter() -> None:
    given = pictured("easy", 502, 1)
    detections = list(given.scene.detections)
    one = fit_panel(detections, given.scene.camera, image=given.image)
    other = fit_panel(detections[::-1], given.scene.camera, image=given.image)
    np.testing.assert_allclose(one.R_camera_panel, other.R_camera_panel, atol=1e-9)
    np.testing.assert_array_equal(one.cells, other.cells[::-1])
    assert one.measurement is not None
    assert one.measurement.centre_px.shape == (one.rows, one.columns, 2)


def test_buttons_that_the_detector_missed_are_shown() -> None:
    given = pictured("easy", 503, 2)
    scene, kept = given.scene, [k for k in range(len(given.scene.detections)) if k % 6]
    fit = fit_panel([scene.detections[k] for k in kept], scene.camera, image=given.image)
    assert fit.ok and fit.measurement is not None
    gone = scene.pixels[scene.button[[k for k in range(len(scene.detections)) if not k % 6]]]
    inside = ((gone > 12) & (gone < [628, 468])).all(axis=1)
    distance = np.linalg.norm(fit.measurement.centre_px.reshape(-1, 1, 2) - gone[inside], axis=-1)
    assert np.nanmin(distance, axis=0).max() < 3.0


@pytest.mark.parametrize("kind", SPOILT)
def test_a_bad_picture_makes_no_right_fit_wrong(kind: str) -> None:
    for number in range(3):
        given = pictured("easy", 504, number)
        image = given.image if kind != "other" else pictured("easy", 504, number + 50).image
        spoilt = SPOILT[kind](image, np.random.default_rng(number))
        fit = fit_panel(given.scene.detections, given.scene.camera, image=spoilt)
        if fit.ok:
            real = given.scene.button >= 0
            button, panel = given.scene.button[real], given.scene.panel
            assert cells_right(fit.cells[real], panel.cells[button], panel.blocks[button]) >= 0.95
            assert _error_rad(given.scene, fit) < np.deg2rad(4.0)


def test_a_black_picture_leaves_the_fit_to_the_boxes() -> None:
    given = pictured("easy", 505, 0)
    boxes = fit_panel(given.scene.detections, given.scene.camera)
    black = fit_panel(given.scene.detections, given.scene.camera, image=np.zeros_like(given.image))
    assert black.measurement is None
    np.testing.assert_array_equal(black.R_camera_panel, boxes.R_camera_panel)


@pytest.mark.parametrize("image", [np.zeros((10, 10), np.uint8), np.zeros((480, 640), float)])
def test_an_image_of_another_kind_is_refused(image: Array) -> None:
    with pytest.raises(ValueError, match="image must be uint8"):
        fit_panel(np.zeros((8, 2)), paper_camera(), Config(), image=image)


def test_a_row_without_any_detection_is_seen_in_the_picture() -> None:
    """All of the lowest row missed: the picture shows it, as one more line of the grid."""
    found = 0
    for number in range(3, 9):
        given = pictured("easy", 611, number)
        scene = given.scene
        last = scene.panel.cells[:, 0].max()
        kept = [d for d, b in zip(scene.detections, scene.button, strict=True) if scene.panel.cells[b, 0] != last]
        if len(kept) < 8 or last < 3:
            continue
        plain, shown = (fit_panel(kept, scene.camera, image=image) for image in (None, given.image))
        assert shown.ok and shown.rows == last + 1 == plain.rows + 1
        row = [b for b in shown.buttons if b.row == last]
        truth = scene.pixels[scene.panel.cells[:, 0] == last]
        inside = ((truth > 15) & (truth < [scene.camera.width - 15, scene.camera.height - 15])).all(axis=1)
        states = [b.state for b in row]
        assert states.count("inferred") >= inside.sum()
        for button in row:
            # Half a pixel in the picture, at twice that for the lattice beyond what was detected.
            assert button.state == "empty" or np.linalg.norm(truth - button.image_px, axis=1).min() < 2.0
        found += 1
    assert found >= 2


def test_plates_beside_the_buttons_are_no_buttons_between() -> None:
    """A panel of two columns with a plate left of each button, in which every third column would be of plates."""
    given = pictured("easy", 5001, 95, held_out=True)
    fit = fit_panel(given.scene.detections, given.scene.camera, image=given.image)
    assert fit.ok and fit.columns == 2 and all(b.state == "observed" for b in fit.buttons)


@pytest.mark.parametrize("before", [True, False])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("stagger", [0.0, 1.0])
def test_a_wider_layout_keeps_its_nodes_where_they_are(axis: int, before: bool, stagger: float) -> None:
    rows, columns = np.array([0.0, 1.0, 2.4]), np.array([0.0, 1.0, 2.0, 3.3])
    layout = Layout(rows, columns, np.array([0.0, 1.0, 0.0]), np.zeros(4), (2,), (3,))
    facing = Poses(np.eye(3)[None], np.array([[0.0, 0.0, 1.0]]), np.zeros(1), np.zeros((1, 2)), np.zeros(1))
    fit = LayoutFit(facing, layout, np.arange(12), np.ones(12), 0.0, 0.0)
    wider, moved, new = _wider(fit, _Side(axis, before, stagger))
    after = wider.layout.nodes.reshape(-1, 2)
    np.testing.assert_array_equal(after[moved], layout.nodes.reshape(-1, 2))
    assert sorted([*moved, *new]) == list(range(len(after)))
    # One pitch beyond the outer line; where the others are staggered against each other, half a pitch more or less.
    beyond = (layout.rows, layout.columns)[axis][0 if before else -1] + (-1.0 if before else 1.0)
    assert (np.abs(after[new, 1 - axis] - beyond) <= (0.5 if axis == 1 else 0.0)).all()
    assert wider.layout.row_breaks == (2 + (axis == 0 and before),)
    assert wider.layout.column_breaks == (3 + (axis == 1 and before),)


def test_a_panel_that_is_turned_is_found_turned_by_as_much() -> None:
    given = pictured("easy", 60, 3, held_out=True)
    camera, detections = given.scene.camera, list(given.scene.detections)
    fit = fit_panel(detections, camera, Config(), image=given.image)
    assert fit.ok
    same = turned(given.image, detections, camera, fit, 0.0)
    np.testing.assert_allclose([d.x_px for d in same.detections], [d.x_px for d in detections], atol=1e-3)
    seen = turned(given.image, detections, camera, fit, 30.0)
    again = fit_panel(seen.detections, camera, Config(), image=seen.image)
    expected = fit.R_camera_panel @ rotation(np.array([0.0, np.deg2rad(30.0), 0.0]))
    # Caps that stand out of the plate do not turn with a plane's map.
    assert again.ok and np.rad2deg(rotation_angle_rad(expected.T @ again.R_camera_panel)) < 1.5


def _edges(R: Array, rng: np.random.Generator, number: int = 30) -> Segments:
    """Return edges along the axes of a panel, seen anywhere."""
    direction = R[:, rng.integers(0, 2, number)].T
    normal = np.cross(direction, rng.normal([0.0, 0.0, 1.0], 0.2, (number, 3)))
    return Segments(normal / np.linalg.norm(normal, axis=1, keepdims=True), np.full(number, np.deg2rad(0.5)))


def test_edges_along_the_panel_speak_for_its_pose_and_against_a_turned_one() -> None:
    rng = np.random.default_rng(4)
    right, covariance = rotation(np.array([0.2, -0.3, 0.05])), np.eye(3) * np.deg2rad(1.0) ** 2
    edges = _edges(right, rng)
    share, turned_by, left = uprightness(edges, right, covariance)
    assert share == 1.0 and turned_by < 1e-6 and left < np.log(np.deg2rad(1.0))
    wrong = rotation(np.array([0.0, 0.0, np.deg2rad(5.0)])) @ right
    assert uprightness(edges, wrong, covariance)[0] < 0.1
    near = rotation(np.array([0.0, 0.0, np.deg2rad(1.0)])) @ right
    # The edges are several times as exact as the pose was: they take nearly all of the error of one deviation away.
    assert 0.8 < uprightness(edges, near, covariance)[1] < 1.05
    turned_round = Segments(edges.normal[::-1], edges.std_rad[::-1])
    np.testing.assert_allclose(uprightness(turned_round, near, covariance), uprightness(edges, near, covariance))


def test_without_edges_nothing_is_said_for_or_against() -> None:
    none = Segments(np.zeros((0, 3)), np.zeros(0))
    np.testing.assert_allclose(uprightness(none, np.eye(3), np.eye(3) * 0.01), [0.0, 0.0, np.log(0.1)])


def test_what_the_edges_said_stays_with_a_tracked_panel() -> None:
    given = pictured("easy", 502, 1)
    first = fit_panel(given.scene.detections, given.scene.camera, image=given.image)
    second = fit_panel(given.scene.detections, given.scene.camera, previous=first, image=given.image)
    assert first.measurement is not None and second.measurement is not None
    assert np.isfinite(first.measurement.uprightness).all()
    np.testing.assert_array_equal(second.measurement.uprightness, first.measurement.uprightness)


@pytest.mark.skipif(not _LABELLED.exists(), reason="the real panels' folder is not beside the checkout")
def test_a_search_that_the_picture_leads_away_from_every_box_does_not_end_the_fit() -> None:
    # In the first search no detection is left on the lattice that this picture shows.
    (picture,) = read_labelled(_LABELLED, names=("1944",))
    camera = stretched_camera(1.0, picture.image.shape[1])
    fit = fit_panel(true_detections(picture), camera, image=picture.image)
    assert fit.inliers > 0 and fit.confidence > 0.0


def test_a_doubtful_fit_to_a_picture_is_known_less_by_what_it_may_be_mistaken() -> None:
    given = pictured("easy", 60, 1, held_out=True)
    fit = fit_panel(given.scene.detections, given.scene.camera, image=given.image)
    bare = replace(fit, covariance=fit.shape_covariance[:6, :6], common_response=np.zeros((0, 5)))
    exact = JointConfig(focal_std_share=0.0, radial_std=0.0)
    sure, doubtful = (with_common_errors(replace(bare, confidence=p), exact) for p in (1.0, 0.75))
    np.testing.assert_allclose(sure.covariance, bare.covariance, atol=1e-15)
    added = doubtful.covariance - bare.covariance
    np.testing.assert_allclose(added[3:, 3:], 0.25 * np.deg2rad(5.0) ** 2 * np.eye(3), atol=1e-12)
    # It turns about the middle of the buttons, which stays where the picture shows it.
    row, column = np.unique(fit.cells, axis=0).T
    middle = fit.grid_panel[row, column].mean(axis=0)[None]
    moved = (covariance_at(doubtful, middle) - covariance_at(sure, middle))[0]
    np.testing.assert_allclose(moved[:3, :3], 0.0, atol=1e-12)
    assert np.trace((covariance_at(doubtful, middle + 1.0) - covariance_at(sure, middle + 1.0))[0, :3, :3]) > 1e-3
    # Whether two frames agree is asked without it.
    place = middle[0] + 1.0
    known = [covariance_at(f, place[None])[0, :3, :3] for f in (doubtful, sure)]
    np.testing.assert_allclose(covariance_if_right(doubtful, known[0], place), known[1], atol=1e-12)
    boxes = fit_panel(given.scene.detections, given.scene.camera)
    assert not boxes.common_response[:, 2:].any()
