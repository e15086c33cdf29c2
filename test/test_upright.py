"""A camera that lies on its side: the labels tell it where the panel's shape leaves it open."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from elevator_rectify.benchmark.pictures import Pictured, pictured
from elevator_rectify.core import Camera, Config, Detection, JointConfig, fit_panel
from elevator_rectify.core.reading.attitude import ATTITUDES, put, upright_nats
from elevator_rectify.core.reading.upright import WayUp, way_up
from elevator_rectify.core.types import Array, Image

# Quarter turns of the picture, clockwise: how it is turned, and the matrix on centred pixels.
TURNS = {
    1: (cv2.ROTATE_90_CLOCKWISE, [[0.0, -1.0], [1.0, 0.0]]),
    3: (cv2.ROTATE_90_COUNTERCLOCKWISE, [[0.0, 1.0], [-1.0, 0.0]]),
}


def lying(given: Pictured, quarters: int) -> tuple[Image, Camera, list[Detection], Array]:
    """Return picture, camera and boxes turned clockwise, and the true rotation of the panel in that camera."""
    code, matrix = TURNS[quarters]
    image: Image = np.ascontiguousarray(cv2.rotate(given.image, code))
    old, turn = given.scene.camera, np.array(matrix)
    middle = np.array([old.width - 1, old.height - 1]) / 2
    new_middle = middle[::-1]
    principal = turn @ (old.matrix[:2, 2] - middle) + new_middle
    K = np.column_stack([np.diag([old.focal_px, old.focal_px, 0.0])[:, :2], [*principal, 1.0]])
    camera = Camera.from_matrix(K, image.shape[1], image.shape[0])
    moved = []
    for d in given.scene.detections:
        x, y = turn @ (np.array([d.x_px, d.y_px]) - middle) + new_middle
        moved.append(replace(d, x_px=float(x), y_px=float(y), width_px=d.height_px, height_px=d.width_px))
    whole = np.eye(3)
    whole[:2, :2] = turn
    return image, camera, moved, whole @ given.scene.R_camera_panel


@pytest.fixture(scope="module")
def panels() -> list[Pictured]:
    drawn = (pictured("easy", 60, k, held_out=True) for k in range(12))
    return [g for g in drawn if np.ptp(g.scene.panel.cells, axis=0) @ [1, -1] > 0][:3]


@pytest.mark.parametrize("quarters", TURNS)
def test_a_lying_camera_is_told_by_the_labels_and_the_reason_says_how_to_set_it(
    panels: list[Pictured], quarters: int
) -> None:
    told = 0
    for given in panels:
        image, camera, detections, R = lying(given, quarters)
        fit = fit_panel(detections, camera, image=image)
        if "labels are turned" not in fit.reason:
            continue
        told += 1
        assert fit.status == "ambiguous"
        roll = float(fit.reason.split("camera_roll_rad to ")[1].split(",")[0])
        right = fit_panel(detections, camera, Config(joint=JointConfig(camera_roll_rad=roll)), image=image)
        assert right.ok and np.rad2deg(np.arccos((np.trace(right.R_camera_panel.T @ R) - 1) / 2)) < 2.0
    # Of real panels nine in ten; some drawn ones have too few labels that can be read.
    assert told >= len(panels) - 1


def test_upright_panels_wider_than_high_are_left_alone(panels: list[Pictured]) -> None:
    for given in panels:
        upright = fit_panel(list(given.scene.detections), given.scene.camera, image=given.image)
        assert upright.ok
        assert way_up(given.image, given.scene.camera, upright, given.scene.detections).quarter_turns == 0


@pytest.mark.parametrize("number", [0, 1, 5])
def test_only_labels_that_stand_upright_are_told_to(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    # Of labels that are surely read, too, both turns are asked here.
    monkeypatch.setattr("elevator_rectify.core.reading.upright._SURELY", 1.0)
    given = pictured("easy", 60, number, held_out=True)
    camera, detections = given.scene.camera, list(given.scene.detections)
    blurred = cv2.GaussianBlur(given.image, (0, 0), 1.0)
    upright = fit_panel(detections, camera, image=blurred)
    assert upright.labels_upright
    assert fit_panel(detections, camera, image=blurred, previous=upright).labels_upright
    turned = [replace(d, x_px=camera.width - 1 - d.x_px, y_px=camera.height - 1 - d.y_px) for d in detections]
    on_head = fit_panel(turned, camera, image=np.ascontiguousarray(blurred[::-1, ::-1]))
    assert not on_head.labels_upright


def test_what_cannot_be_read_is_not_turned() -> None:
    given = pictured("easy", 60, 0, held_out=True)
    fit = fit_panel(list(given.scene.detections), given.scene.camera)
    grey = np.full_like(given.image, 120)
    assert way_up(grey, given.scene.camera, fit, given.scene.detections) == WayUp()
    centres = [replace(d, width_px=0.0, height_px=0.0) for d in given.scene.detections]
    assert way_up(given.image, given.scene.camera, fit, centres) == WayUp()


def test_what_is_put_one_way_after_the_other_is_put_one_way() -> None:
    """Eight ways to lay a square: every two of them are one."""
    square = np.arange(6).reshape(2, 3)
    ways = [put(square, way).tolist() for way in range(ATTITUDES)]
    assert len({str(way) for way in ways}) == ATTITUDES
    assert all(put(put(square, a), b).tolist() in ways for a in range(ATTITUDES) for b in range(ATTITUDES))


def test_the_network_sees_every_way_alike() -> None:
    """A turned patch has the likelihoods of the patch, in another order; one that looks the same in all has one."""
    rng = np.random.default_rng(4)
    patch = cv2.resize(rng.integers(0, 255, (12, 12, 3), dtype=np.uint8), (96, 96))
    for way in range(ATTITUDES):
        first, turned = upright_nats([patch, np.ascontiguousarray(put(patch, way))])
        np.testing.assert_allclose(np.sort(first), np.sort(turned), atol=1e-3)
    assert np.ptp(upright_nats([np.full((96, 96), 90, np.uint8)])) < 1e-4


def test_panels_in_a_mirror_are_told() -> None:
    """Upright ones are never taken for them; of drawn ones in a mirror at least half are told, and none is upright."""
    told = 0
    for number in range(8):
        given = pictured("easy", 60, number, held_out=True)
        camera, detections = given.scene.camera, list(given.scene.detections)
        fit = fit_panel(detections, camera)
        if not fit.ok:
            continue
        assert not way_up(given.image, camera, fit, detections).mirrored
        mirrored = [replace(d, x_px=camera.width - 1 - d.x_px) for d in detections]
        image = np.ascontiguousarray(given.image[:, ::-1])
        found = way_up(image, camera, fit_panel(mirrored, camera), mirrored)
        assert not found.upright
        told += found.mirrored
    assert told >= 4
