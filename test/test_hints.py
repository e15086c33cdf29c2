"""What the node tells a user who sees nothing: streams that do not come, stamps that do not meet, missing settings."""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import pytest

from elevator_rectify.core import GridFit
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
