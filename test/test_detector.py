"""Our own detector: boxes where buttons are, at any size of the picture, nothing where there is nothing."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from elevator_rectify.benchmark.detector import boxes_of, iou, matched, nearness
from elevator_rectify.benchmark.pictures import Pictured, pictured
from elevator_rectify.core import Detection, NetworkConfig, detect_buttons
from elevator_rectify.core.detector import detect
from elevator_rectify.core.detector.detect import score_model
from elevator_rectify.core.detector.follow import Found, find_or_follow, followed
from elevator_rectify.core.detector.network import HeatMap, heat_map
from elevator_rectify.core.detector.peaks import Boxes, probabilities, suppressed
from elevator_rectify.core.types import Array, Image


def scenes(number: int = 6) -> list[Pictured]:
    return [pictured("easy", 31, k, held_out=True) for k in range(number)]


def true_boxes(given: Pictured) -> Array:
    return boxes_of(list(given.scene.detections))


def found_share(given: Pictured, image: Image, scale: float = 1.0) -> float:
    boxes = boxes_of(detect_buttons(image)) / scale
    return float((matched(nearness(boxes, true_boxes(given)), 0.7) >= 0).sum() / len(given.scene.detections))


def test_most_buttons_of_rendered_panels_are_found() -> None:
    """It learnt from photographs only: rendered panels are a picture of another kind."""
    assert np.mean([found_share(given, given.image) for given in scenes()]) > 0.7


def test_a_larger_picture_of_the_same_gives_the_same_boxes() -> None:
    given = scenes(1)[0]
    large = cv2.resize(given.image, None, fx=3.0, fy=3.0, interpolation=cv2.INTER_CUBIC)
    one, other = boxes_of(detect_buttons(given.image)), boxes_of(detect_buttons(large)) / 3.0
    # Resized down again it is nearly, not exactly, the same picture.
    best = iou(one, other).max(axis=1)
    assert len(one) > 4 and np.mean(best > 0.8) > 0.8


@pytest.mark.parametrize("size", [(64, 64), (33, 700), (480, 640)])
def test_nothing_is_found_where_there_is_nothing(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    pictures = [np.zeros((*size, 3), np.uint8), np.full((*size, 3), 255, np.uint8)]
    pictures.append(rng.integers(0, 255, (*size, 3), dtype=np.uint8))
    for picture in pictures:
        assert len(detect_buttons(picture)) <= 2


def test_it_is_deterministic_and_takes_grey() -> None:
    image = scenes(1)[0].image
    first = detect_buttons(image)
    detect._last_found.clear()
    assert detect_buttons(image) == first
    assert len(detect_buttons(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))) > 0


def test_a_picture_is_looked_at_once_and_again_where_a_pixel_or_the_size_changed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looks, image = list[float](), scenes(1)[0].image.copy()

    def counted(picture: Image, scale: float) -> HeatMap:
        looks.append(scale)
        return heat_map(picture, scale)

    monkeypatch.setattr("elevator_rectify.core.detector.detect.heat_map", counted)
    detect._last_found.clear()
    first, once = detect_buttons(image), len(looks)
    assert once >= 1 and detect_buttons(image.copy()) == first and len(looks) == once
    image[0, 0] += 1
    detect_buttons(image)
    again = len(looks)
    assert again > once
    detect_buttons(image, NetworkConfig(detector_side_px=320))
    assert len(looks) > again
    detect_buttons(np.ascontiguousarray(image[:, ::-1]))
    assert len(detect._last_found) == 1


def test_the_part_of_a_picture_shows_the_same_boxes_as_all_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """But for where the network's cells fall, and what it sees around the panel."""
    given = scenes(1)[0]
    wide = cv2.copyMakeBorder(given.image, 200, 200, 300, 300, cv2.BORDER_REPLICATE)
    config = NetworkConfig(detector_side_px=max(wide.shape))
    boxes = true_boxes(given) + np.array([300.0, 200.0, 300.0, 200.0])
    centres, sizes = (boxes[:, :2] + boxes[:, 2:]) / 2.0, boxes[:, 2:] - boxes[:, :2]
    looked = []

    def counted(picture: Image, scale: float) -> HeatMap:
        looked.append(picture.size)
        return heat_map(picture, scale)

    monkeypatch.setattr("elevator_rectify.core.detector.detect.heat_map", counted)
    detect._last_found.clear()
    part = detect.boxes_at(wide, centres, sizes, config)
    assert len(looked) == 1 and looked[0] < 0.6 * wide.size
    whole = detect.find_boxes(wide, config)
    sure = part.boxes_px[part.is_button & (part.heat > 0.5)]
    assert len(sure) > 4 and (iou(sure, whole.boxes_px).max(axis=1) > 0.8).all()
    assert detect.boxes_at(wide, centres, sizes, config) is whole
    # Boxes without a size, or beside the picture, tell no part of it.
    detect._last_found.clear()
    assert len(detect.boxes_at(wide, centres, 0.0 * sizes, config).heat) == len(whole.heat)
    detect._last_found.clear()
    assert len(detect.boxes_at(wide, centres + 1e5, sizes, config).heat) == len(whole.heat)


def test_the_surest_comes_first_and_none_is_below_the_least_score() -> None:
    found = detect_buttons(scenes(1)[0].image, NetworkConfig(min_score=0.6))
    scores = [d.score for d in found]
    assert scores == sorted(scores, reverse=True) and all(0.6 <= s <= 1.0 for s in scores)


@pytest.mark.parametrize("image", [np.zeros((9, 9), np.float32), np.zeros((9, 9, 4), np.uint8), np.zeros(9, np.uint8)])
def test_what_is_no_picture_is_refused(image: Image) -> None:
    with pytest.raises(ValueError, match="image must be uint8"):
        detect_buttons(image)


def test_of_overlapping_boxes_the_best_is_kept() -> None:
    boxes = np.array([[0, 0, 10, 10], [1, 0, 11, 10], [30, 0, 40, 10], [2, 2, 8, 8]], dtype=float)
    kept = suppressed(Boxes(boxes, np.array([0.9, 0.8, 0.7, 0.6]), np.array([True, True, False, True])))
    assert kept.boxes_px.tolist() == [boxes[0].tolist(), boxes[2].tolist()]


def test_probabilities_rise_with_the_heat() -> None:
    heat = np.linspace(0.1, 0.9, 9)
    far = np.array([[100.0 * k, 0.0, 100.0 * k + 10.0, 10.0] for k in range(9)])
    p = probabilities(Boxes(far, heat, np.ones(9, dtype=bool)), score_model())
    assert (np.diff(p) > 0).all() and 0.0 <= p[0] < p[-1] <= 1.0


def test_a_doubtful_box_among_sure_ones_of_its_size_is_likelier_a_button() -> None:
    row = np.array([[15.0 * k, 0.0, 15.0 * k + 10.0, 10.0] for k in range(5)])
    sure, doubtful = np.array([0.9, 0.9, 0.9, 0.9, 0.4]), np.full(5, 0.4)
    among_sure, among_doubtful = (
        probabilities(Boxes(row, heat, np.ones(5, dtype=bool)), score_model())[4] for heat in (sure, doubtful)
    )
    assert among_sure > among_doubtful


def test_each_true_box_is_taken_once() -> None:
    likeness = np.array([[0.9, 0.1], [0.95, 0.2], [0.3, 0.8]])
    assert matched(likeness, 0.5).tolist() == [0, -1, 1]


def shifted(image: Image, dx: float, dy: float, scale: float = 1.0) -> Image:
    M = np.array([[scale, 0.0, dx], [0.0, scale, dy]])
    return np.asarray(cv2.warpAffine(image, M, (image.shape[1], image.shape[0]), borderMode=cv2.BORDER_REPLICATE))


def test_boxes_follow_the_picture() -> None:
    given = scenes(1)[0]
    grey = cv2.cvtColor(given.image, cv2.COLOR_BGR2GRAY)
    last = Found(tuple(given.scene.detections), grey, 0, 0)
    moved = followed(last, shifted(grey, 6.0, -4.0, 1.02))
    assert moved is not None
    before = np.array([[d.x_px, d.y_px] for d in given.scene.detections]) * 1.02 + [6.0, -4.0]
    now = np.array([[d.x_px, d.y_px] for d in moved])
    distance = np.linalg.norm(now[:, None] - before[None], axis=2).min(axis=1)
    # Optical flow is good to a tenth of a pixel where there is texture; a shrunken or grown patch costs a little.
    assert np.median(distance) < 0.3
    assert moved[0].width_px == pytest.approx(1.02 * given.scene.detections[0].width_px, rel=0.01)


def test_another_picture_is_not_followed() -> None:
    one, other = scenes(2)
    grey = [cv2.cvtColor(given.image, cv2.COLOR_BGR2GRAY) for given in (one, other)]
    assert followed(Found(tuple(one.scene.detections), grey[0], 0, 0), grey[1]) is None


def test_the_detector_looks_at_keyframes_only() -> None:
    image = scenes(1)[0].image
    config = NetworkConfig(keyframe_s=0.5)
    first = find_or_follow(image, 10**9, None, config)
    second = find_or_follow(image, 10**9 + 10**8, first, config)
    assert first.looked_ns == second.looked_ns == 10**9 and len(second.detections) >= 0.8 * len(first.detections)
    assert find_or_follow(image, 10**9 + 6 * 10**8, second, config).looked_ns == 10**9 + 6 * 10**8
    assert find_or_follow(image, 10**8, second, config).looked_ns == 10**8, "the clock went back"
    assert Detection(0, 0) not in second.detections
