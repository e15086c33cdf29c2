"""Pictures that no robot should see: nothing is raised, and nothing wrong is pressed."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from elevator_rectify.benchmark.pictures import Pictured, pictured
from elevator_rectify.core import (
    Camera,
    Config,
    ScaleConfig,
    TargetConfig,
    find_button,
    find_panel,
    fit_panel,
)
from elevator_rectify.core.reading.target import upside_down
from elevator_rectify.core.types import Image
from test.scenes import rotation_error_deg, scene

CONFIG = Config(
    scale=ScaleConfig(column_pitch_m=1.0, column_pitch_std_m=0.0), target=TargetConfig(max_lateral_std_m=0.2)
)
ASKED = [*(str(n) for n in range(-2, 20)), "open", "close", "alarm", "call", "stop", "up", "down"]
BOARD = np.kron((np.indices((8, 10)).sum(axis=0) % 2 * 200).astype(np.uint8), np.ones((60, 64), np.uint8))
NOTHING: dict[str, Image] = {
    "black": np.zeros((480, 640, 3), np.uint8),
    "white": np.full((480, 640, 3), 255, np.uint8),
    "noise": np.random.default_rng(1).integers(0, 256, (480, 640, 3)).astype(np.uint8),
    "chessboard": BOARD,
    "next to nothing": np.zeros((2, 3, 3), np.uint8),
}


def camera_of(image: Image) -> Camera:
    height, width = image.shape[:2]
    return Camera.centred(width, height, 0.8 * max(width, height))


@pytest.fixture(scope="module")
def given() -> Pictured:
    return pictured("easy", 60, 2, held_out=True)


@pytest.mark.parametrize("name", NOTHING)
def test_where_there_is_no_panel_there_is_none(name: str) -> None:
    fit = find_panel(NOTHING[name], camera_of(NOTHING[name]))
    assert not fit.ok and fit.reason


@pytest.mark.parametrize("change", ["grey", "64 x 48", "8K"])
def test_a_picture_of_another_kind_is_answered_with_the_truth_or_refused(given: Pictured, change: str) -> None:
    image, camera = given.image, given.scene.camera
    if change == "grey":
        image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    else:
        factor = 0.1 if change == "64 x 48" else 12.0
        image = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA if factor < 1 else 1)
        K = np.diag([factor, factor, 1.0]) @ camera.matrix
        # The middle of the corner pixel is (0, 0).
        K[:2, 2] += 0.5 * (factor - 1.0)
        camera = Camera.from_matrix(K, image.shape[1], image.shape[0])
    fit = find_panel(image, camera)
    if fit.ok:
        assert rotation_error_deg(fit.R_camera_panel, given.scene.R_camera_panel) < 4.0
    assert fit.ok or change == "64 x 48"


@pytest.mark.parametrize("label", ["6", "9", "16", "19", "up", "down"])
def test_a_hanging_camera_has_no_nine_pressed_for_a_six(label: str) -> None:
    """Upside down a 6 is a 9, and 3, 4 and 7 are nothing: without two of them read it is not said which."""
    view = scene(4, rows=4, columns=3)
    texts = ["8", "1", label, "2", "5", "0", "", "", "", "", "", ""]
    read = [replace(d, label=t, score=0.99) for d, t in zip(view.detections, texts, strict=True)]
    lenient = replace(CONFIG.target, min_probability=0.5, min_inferred_probability=0.5)
    refused = find_button(fit_panel(read, view.camera, CONFIG), label, lenient)
    assert refused.status == "unsure_label" and f"{upside_down(label)} upside down" in refused.reason
    said = find_button(fit_panel(read, view.camera, CONFIG), label, replace(lenient, camera_is_upright=True))
    assert said.button is not None and said.button.read == label
    seen_upright = replace(fit_panel(read, view.camera, CONFIG), labels_upright=True)
    assert find_button(seen_upright, label, lenient).reason.count("upside down") == 0
    upright = [replace(d, label=("40", "43")[k]) if k < 2 else d for k, d in enumerate(read)]
    assert find_button(fit_panel(upright, view.camera, CONFIG), label, lenient).reason.count("upside down") == 0


@pytest.mark.parametrize(
    ("label", "other"), [("8", "8"), ("69", "69"), ("619", "619"), ("7", ""), ("B1", ""), ("", "")]
)
def test_what_reads_the_same_upside_down_or_not_at_all(label: str, other: str) -> None:
    assert upside_down(label) == other


@pytest.mark.parametrize("turn", ["upside down", "mirrored"])
def test_a_turned_picture_has_no_wrong_floor_pressed(turn: str) -> None:
    wrong, turned = [], 0
    for number in range(6):
        view = pictured("easy", 60, number, held_out=True)
        image = view.image[:, ::-1] if turn == "mirrored" else view.image[::-1, ::-1]
        fit = find_panel(np.ascontiguousarray(image), view.scene.camera, CONFIG)
        turned += "turned by 180 degrees" in fit.reason
        for label in ASKED if fit.ok else []:
            found = find_button(fit, label, CONFIG.target).button
            if found is None:
                continue
            at = np.array([639.0, 479.0 if turn == "upside down" else 2.0 * found.image_px[1]]) - found.image_px
            nearest = int(np.linalg.norm(view.scene.pixels - at, axis=1).argmin())
            wrong += [label] if view.scene.panel.buttons[nearest].label != label else []
    # The reader sees pictures that stand on their head: a 7 may be read as 4 then. A mirror image may be either.
    assert not wrong and (turn == "mirrored" or turned >= 4)


def test_a_button_that_the_border_cuts_off_is_not_pressed_where_its_rest_is() -> None:
    view = scene(4, rows=4, columns=3)
    # The same camera, of which less is seen at the left: the first column's buttons are next to the border.
    less = float(view.centres_px[:, 0].min()) - 40.0
    K = view.camera.matrix - [[0.0, 0.0, less], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    camera = Camera.from_matrix(K, 640 - int(less), 480)
    shown = [replace(d, x_px=d.x_px - less) for d in view.detections]
    lowest = max(shown, key=lambda d: d.y_px)
    below = replace(lowest, y_px=lowest.y_px + 0.7 * (lowest.y_px - sorted({d.y_px for d in shown})[-4]), width_px=20.0)
    numbers = [
        sum(b.row < 0 for b in fit_panel([*shown, replace(below, x_px=x)], camera).buttons) for x in (10.0, 30.0)
    ]
    assert numbers == [0, 1]
