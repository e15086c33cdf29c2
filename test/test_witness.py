"""Boxes that are not the picture's: our own detector sees buttons elsewhere, and the fit is refused."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from elevator_rectify.benchmark.adversarial import PICTURED
from elevator_rectify.benchmark.pictures import Pictured, pictured
from elevator_rectify.core import Config, Detection, NetworkConfig, fit_panel
from elevator_rectify.core.detector.peaks import Boxes
from elevator_rectify.core.left_out import undoubted
from elevator_rectify.core.picture.witness import CONFIRMED, CONTRADICTED, UNSEEN, _seen, second_opinion
from elevator_rectify.core.pipeline import admitted
from elevator_rectify.core.types import Image

NETWORK = NetworkConfig()


@pytest.fixture(scope="module")
def scenes() -> list[Pictured]:
    return [pictured("easy", 4003, k, held_out=True) for k in range(6)]


def said(image: Image, detections: tuple[Detection, ...]) -> str:
    centres = np.array([[d.x_px, d.y_px] for d in detections])
    sizes = np.array([[d.width_px, d.height_px] for d in detections])
    return second_opinion(image, centres, sizes, NETWORK).verdict


def letterboxed(d: Detection) -> Detection:
    return replace(d, y_px=0.75 * d.y_px + 60.0, height_px=0.75 * d.height_px)


def half_a_size_off(d: Detection) -> Detection:
    return replace(d, x_px=d.x_px + 0.6 * d.width_px, y_px=d.y_px + 0.5 * d.height_px)


def corner_for_centre(d: Detection) -> Detection:
    return replace(d, x_px=d.x_px - 0.5 * d.width_px, y_px=d.y_px - 0.5 * d.height_px)


def test_a_panels_own_boxes_are_confirmed(scenes: list[Pictured]) -> None:
    assert [said(s.image, s.scene.detections) for s in scenes] == [CONFIRMED] * len(scenes)


@pytest.mark.parametrize("wrong", [letterboxed, half_a_size_off, corner_for_centre])
def test_boxes_of_another_frame_are_contradicted(
    scenes: list[Pictured], wrong: Callable[[Detection], Detection]
) -> None:
    verdicts = [said(s.image, tuple(wrong(d) for d in s.scene.detections)) for s in scenes]
    assert CONFIRMED not in verdicts and verdicts.count(CONTRADICTED) >= len(scenes) - 1


def test_the_boxes_of_another_picture_are_refused(scenes: list[Pictured]) -> None:
    statuses = [
        fit_panel(one.scene.detections, one.scene.camera, Config(), image=other.image).status
        for one, other in itertools.pairwise(scenes)
    ]
    assert statuses.count("contradicted") >= len(statuses) - 1 and "ok" not in statuses


def test_a_black_or_covered_picture_contradicts_nothing(scenes: list[Pictured]) -> None:
    for s in scenes[:3]:
        assert said(np.zeros_like(s.image), s.scene.detections) == UNSEEN
        assert said(cv2.GaussianBlur(s.image, (0, 0), 12.0), s.scene.detections) != CONTRADICTED
    fit = fit_panel(scenes[0].scene.detections, scenes[0].scene.camera, Config(), image=np.zeros_like(scenes[0].image))
    assert fit.ok and fit.measurement is None


def test_false_negatives_and_some_false_positives_contradict_nothing(scenes: list[Pictured]) -> None:
    rng = np.random.default_rng(2)
    for s in scenes:
        kept = [d for k, d in enumerate(s.scene.detections) if k % 3]
        false = [
            replace(kept[0], x_px=float(rng.uniform(0, 640)), y_px=float(rng.uniform(0, 480)))
            for _ in range(len(kept) // 8)
        ]
        assert said(s.image, tuple(kept + false)) == CONFIRMED


def test_boxes_around_cap_and_plate_are_confirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The detector sees two things in each; both are off the box's centre to one side."""
    centres = np.array([[60.0 + 80.0 * k, 100.0] for k in range(6)])
    left = np.column_stack([centres - np.array([30.0, 15.0]), centres + np.array([0.0, 15.0])]) + 0.5
    halves = np.concatenate([left, left + np.array([30.0, 0.0, 30.0, 0.0])])
    found = Boxes(halves, np.full(12, 0.9), np.ones(12, dtype=bool))
    for looked in ("find_boxes", "boxes_at"):
        monkeypatch.setattr(f"elevator_rectify.core.picture.witness.{looked}", lambda *given: found)
    sizes = np.tile([60.0, 30.0], (6, 1))
    picture = np.zeros((200, 600, 3), np.uint8)
    assert second_opinion(picture, centres, sizes, NETWORK).verdict == CONFIRMED
    assert second_opinion(picture, centres + np.array([30.0, 0.0]), sizes, NETWORK).verdict == CONTRADICTED


def test_without_the_witness_the_boxes_are_believed(scenes: list[Pictured]) -> None:
    """The parameter switches it off: what is then accepted is the measurement's affair."""
    config = Config(measurement=replace(Config().measurement, witness=False))
    s, other = scenes[:2]
    assert fit_panel(s.scene.detections, s.scene.camera, config, image=other.image).status != "contradicted"


def test_a_cap_in_the_box_of_cap_and_plate_is_no_shift() -> None:
    centres, sizes = np.array([[30.0, 30.0], [30.0, 70.0], [80.0, 30.0]]), np.full((3, 2), 20.0)
    cap = np.column_stack([centres - sizes / 2.0, centres + sizes / 2.0]) + 0.5
    with_plate = cap + np.array([-14.0, 0.0, 0.0, 0.0])
    for things, expected in ((cap, 0.0), (with_plate, 0.0), (cap + np.array([6.0, 0.0, 6.0, 0.0]), 0.3)):
        seen, shift = _seen(things, centres, sizes)
        assert seen.all()
        np.testing.assert_allclose(np.linalg.norm(shift, axis=1), expected, atol=1e-9)


def test_boxes_of_another_panel_are_contradicted_by_the_buttons_that_the_picture_shows() -> None:
    """On draws where the boxes outnumber the pictured buttons by far, which were accepted with confidence .99."""
    for number in (22, 40, 48):
        given = pictured(("easy", "medium", "hard")[number % 3], 1001, number, held_out=True)
        lying = PICTURED["another panel"](given, np.random.default_rng([1001, number, len("another panel")]))
        fit = fit_panel(lying, given.scene.camera, Config(), image=given.image)
        assert not fit.ok


def test_boxes_that_are_off_each_another_way_are_no_boxes_of_the_picture(scenes: list[Pictured]) -> None:
    """Those of the mirrored picture come to lie on the buttons, more or less, where the panel hangs in its middle."""
    s = scenes[0]
    centres = s.scene.centres_px
    sizes = np.array([[d.width_px, d.height_px] for d in s.scene.detections])
    aside = 0.25 * sizes * np.where(np.arange(len(centres))[:, None] % 2, 1.0, -1.0) * [1.0, 0.0]
    assert second_opinion(s.image, centres, sizes, NETWORK).verdict == CONFIRMED
    said = second_opinion(s.image, centres + aside, sizes, NETWORK)
    assert said.verdict == CONTRADICTED and "each another way" in said.reason


@pytest.mark.parametrize(
    ("kind", "seed", "numbers"),
    [
        ("mirrored", 6006, (66, 73, 312)),
        ("a third left", 6006, (9, 529)),
        ("mirrored", 7007, (152, 183)),
        ("another panel", 7007, (72,)),
    ],
)
def test_boxes_that_lie_so_that_they_nearly_fit_are_refused(kind: str, seed: int, numbers: tuple[int, ...]) -> None:
    """Mirrored ones on about every second button; a third of the boxes that a diagonal lattice explains as well; those
    of dim pictures that show the panel elsewhere."""
    for number in numbers:
        given = pictured(("easy", "medium", "hard")[number % 3], seed, number, held_out=True)
        lying = PICTURED[kind](given, np.random.default_rng([seed, number, len(kind)]))
        fit = fit_panel(lying, given.scene.camera, image=given.image)
        assert fit.status in ("contradicted", "ambiguous"), (number, fit.status)


def test_buttons_left_out_that_lie_on_the_grid_leave_it_undoubted(scenes: list[Pictured]) -> None:
    for s in scenes[:3]:
        kept = [d for k, d in enumerate(s.scene.detections) if k % 3]
        usable, sigma, _ = admitted(kept, s.scene.camera, Config())
        fit = fit_panel(kept, s.scene.camera, image=s.image)
        # As if its cells were mostly empty: the others are looked for, and say the same.
        wide = replace(fit, rows=3 * fit.rows)
        assert fit.ok and undoubted(wide, usable, s.scene.camera, sigma, Config(), s.image) is wide
