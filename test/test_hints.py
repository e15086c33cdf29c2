"""What the node tells a user who sees nothing: streams that do not come, stamps that do not meet, missing settings."""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest

from elevator_rectify.benchmark.adversarial import PICTURED
from elevator_rectify.benchmark.pictures import pictured
from elevator_rectify.core import Config, GridFit
from elevator_rectify.core.picture.placement import Placement, placement
from elevator_rectify.ros.answer import Answer
from elevator_rectify.ros.config import DetectionsConfig, NodeConfig, PairingConfig
from elevator_rectify.ros.hints import Hints, Silence
from elevator_rectify.ros.pairing import Pairing

NAMES = {"image": "/cam/image", "camera_info": "/cam/info", "detections": "/boxes"}


def message(seconds: int) -> Any:
    return Made(header=Made(stamp=Made(sec=seconds, nanosec=0), frame_id="cam"), data=b"")


def silent(*received: tuple[str, int]) -> str:
    """Return what is said 6 s after the start, when these messages came in between: (stream, stamp)."""
    pairing, silence = Pairing(PairingConfig()), Silence(NAMES)
    assert silence.look(pairing, 0, 100.0) == ""
    for stream, seconds in received:
        getattr(pairing, f"add_{stream}")(message(seconds))
    assert silence.look(pairing, 0, 104.0) == ""
    return silence.look(pairing, 0, 106.0)


@pytest.mark.parametrize("missing", ["image", "camera_info", "detections"])
def test_a_stream_that_does_not_come_is_named(missing: str) -> None:
    said = silent(*((stream, 5) for stream in NAMES if stream != missing))
    assert f"nothing comes on {NAMES[missing]}" in said
    assert all(name not in said for stream, name in NAMES.items() if stream != missing)


def test_stamps_that_do_not_meet_are_shown() -> None:
    said = silent(("camera_info", 5), ("image", 5), ("detections", 7))
    assert "5.000000000 and 7.000000000" in said and "2.000 s apart" in said and "pairing.tolerance_s" in said


def test_stamps_of_zero_are_told_from_late_ones() -> None:
    assert "a stamp of zero" in silent(("camera_info", 5), ("image", 5), ("detections", 0))


def test_it_is_said_again_after_half_a_minute_and_not_while_frames_come() -> None:
    pairing, silence = Pairing(PairingConfig()), Silence(NAMES)
    said = [bool(silence.look(pairing, 0, float(second))) for second in range(80)]
    assert [k for k, word in enumerate(said) if word] == [5, 35, 65]
    assert not any(silence.look(pairing, frames, 80.0 + frames) for frames in range(1, 60))


def detections(class_id: str) -> Any:
    hypothesis = Made(hypothesis=Made(class_id=class_id, score=0.9))
    return Made(detections=[Made(results=[hypothesis])])


def test_missing_settings_are_said_once() -> None:
    hints = Hints(NodeConfig(use_depth=True))
    answer = Answer(None, GridFit(status="ok", metric=False))
    first = hints.of(answer, detections("7"), depths=0)
    assert [
        any(word in hint for hint in first) for word in ("scale.column_pitch_m", "depth", "numbers_are_labels")
    ] == [True] * 3
    assert hints.of(answer, detections("7"), depths=0) == []
    assert "camera_info" in hints.of(answer, detections("7"), depths=0, lost_infos=1)[0]


def test_labels_that_are_none_give_no_hint() -> None:
    answer = Answer(None, GridFit(status="ok", metric=True))
    assert Hints(NodeConfig()).of(answer, detections("open"), 0) == []
    settled = NodeConfig(detections=DetectionsConfig(numbers_are_labels=True))
    assert Hints(settled).of(answer, detections("7"), 0) == []


def contradicted(scale: tuple[float, float], offset: tuple[float, float]) -> Answer:
    found = Placement(np.array(scale), np.array(offset), np.array([640.0, 480.0]), np.array([30.0, 40.0]))
    return Answer(None, GridFit(status="contradicted"), placement=found)


SETTINGS = [
    ((1.0, 1.01), (2.0, -80.0), ["detections.offset_y_px: 80"]),
    ((1.33, 0.99), (1.0, 2.0), ["detections.image_width_px: 481"]),
    ((1.54, 1.54), (0.0, -80.0), ["image_width_px: 416", "image_height_px: 312", "offset_y_px: 52"]),
    ((1.0, 1.0), (70.0, 100.0), ["offset_x_px: -70", "offset_y_px: -100"]),
    ((-1.0, 1.0), (639.0, 0.0), ["mirrored"]),
    ((0.98, 1.02), (16.0, 19.0), ["upper left corners"]),
]


@pytest.mark.parametrize(("scale", "offset", "words"), SETTINGS)
def test_what_all_contradicted_frames_have_in_common_is_a_setting(
    scale: tuple[float, float], offset: tuple[float, float], words: list[str]
) -> None:
    hints, said = Hints(NodeConfig()), []
    for k in range(8):
        wobble = 0.01 * (k % 3 - 1)
        said += hints.of(contradicted((scale[0] + wobble, scale[1]), (offset[0], offset[1] + 200 * wobble)), None, 0)
    assert len(said) == 1 and all(word in said[0] for word in words) and hints.advice in said[0]


def test_frames_that_ask_for_different_settings_are_no_setting() -> None:
    hints = Hints(NodeConfig())
    assert [hints.of(contradicted((1.0, 1.0), (20.0 * k, 0.0)), None, 0) for k in range(40)] == [[]] * 40
    assert not hints.advice and not hints.placements.wanted


@pytest.mark.parametrize("kind", ["letterboxed", "squeezed", "mirrored", "cropped"])
def test_the_map_that_puts_the_boxes_onto_the_buttons_is_found(kind: str) -> None:
    given = pictured("easy", 5005, 0, held_out=True)
    true = given.scene.centres_px
    wrong = PICTURED[kind](given, np.random.default_rng(1))
    found = placement(given.image, wrong, Config().network)
    assert found is not None
    placed = found.scale * [[d.x_px, d.y_px] for d in wrong] + found.offset_px
    # Half of what makes a box miss its button.
    assert np.linalg.norm(placed - true, axis=1).max() < 0.25 * float(np.median(found.box_px))
    assert placement(np.zeros_like(given.image), wrong, Config().network) is None
