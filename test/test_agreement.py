"""One answer from several frames: who agrees, what is refused, and when nothing is said yet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elevator_rectify.core import fit_panel
from elevator_rectify.core.config import Config, ScaleConfig, TargetConfig
from elevator_rectify.core.reading.agreement import Look, Request, timed_out, verdict
from elevator_rectify.core.reading.target import Choice, _decided, find_button
from elevator_rectify.core.types import Button
from test.scenes import scene

SCENE = scene(1, tilt_deg=15.0, sigma_px=0.3)
FIT = fit_panel(list(SCENE.detections), SCENE.camera, Config(scale=ScaleConfig(column_pitch_m=0.045)))
FOUND = find_button(FIT, "7")
BUTTON: Button | None = FOUND.button
STD_M = 0.002


def found(x_m: float, std_m: float = STD_M) -> Look:
    return Look(FOUND, np.array([x_m, 0.0, 0.5]), std_m**2 * np.eye(3))


def refused(status: str, reason: str = "") -> Look:
    return Look(Choice(None, status, reason))


REQUEST = Request("7", 2.0, 3, 5)


def test_the_choice_says_how_sure_it_is_and_what_else_it_may_be() -> None:
    assert BUTTON is not None
    assert 0.9 < FOUND.probability <= 1.0
    assert all(label != "7" and 0.0 < p < 0.5 for label, p in FOUND.others)


def test_enough_frames_that_agree_are_an_answer_and_fewer_are_none() -> None:
    looks = [found(0.0), refused("no_panel"), found(0.001)]
    assert verdict(looks, REQUEST) is None
    answer = verdict([*looks, found(0.0005)], REQUEST)
    assert answer is not None and answer.status == "found" and answer.agreed == 3
    # The one amid the three.
    assert answer.chosen == 3


@settings(deadline=None, max_examples=50)
@given(st.permutations([0.0, 0.001, 0.0005, 0.2, -0.3]))
def test_what_lies_apart_is_not_chosen_in_any_order(places: list[float]) -> None:
    answer = verdict([found(x) for x in places], REQUEST)
    assert answer is not None and answer.agreed == 3
    assert places[answer.chosen] == 0.0005


def test_places_that_differ_are_unsteady() -> None:
    answer = verdict([found(0.1 * k) for k in range(5)], REQUEST)
    assert answer is not None and (answer.status, answer.agreed) == ("unsteady", 1)


def test_places_agree_within_their_covariances_only() -> None:
    apart = 0.01
    for std, status in ((apart, "found"), (apart / 10, "unsteady")):
        answer = verdict([found(apart * k, std) for k in range(3)], Request("7", 2.0, 3, 3))
        assert answer is not None and answer.status == status


def test_a_refusal_needs_all_frames_with_a_panel_and_says_the_commonest_reason() -> None:
    unknown = refused("unknown_label", "no button is labelled 7; known are: 1")
    looks = [unknown, unknown, refused("low_score"), unknown]
    assert verdict(looks, REQUEST) is None
    assert verdict([*looks, refused("no_panel")], REQUEST) is None
    answer = verdict([*looks, found(0.0)], REQUEST)
    assert answer is not None and answer.status == "unknown_label"
    assert "known are" in answer.reason and answer.chosen == -1


def test_without_time_the_last_frames_say_why() -> None:
    assert timed_out([], REQUEST).status == "no_frames"
    late = timed_out([refused("no_panel", "too_few_detections: 2"), found(0.0)], REQUEST)
    assert (late.status, late.agreed) == ("no_panel", 1) and "within 2 s: too_few" in late.reason
    assert timed_out([found(0.0), found(0.0)], REQUEST).status == "no_frames"


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (Request("7", 0.0), "timeout_s must lie in (0, 3600], not 0.0"),
        (Request("7", float("nan")), "timeout_s"),
        (Request("7", 1.0, 8, 7), "not 8 of 7"),
        (Request("7", 1.0, 0, 7), "not 0 of 7"),
        (Request("7", 1.0, 5, 10**9), "<= 1000"),
        (Request("7", 1.0, 5, 7, float("inf")), "max_lateral_std_m"),
    ],
)
def test_what_cannot_be_asked_is_said(request_: Request, words: str) -> None:
    assert words in request_.problem()
    assert not REQUEST.problem()


def test_no_numbers_of_frames_are_the_usual_ones() -> None:
    assert Request("7", 1.0, 0, 0).usual() == Request("7", 1.0)


def test_a_box_beside_the_grid_is_not_pressed_for_a_label_that_nobody_read() -> None:
    assert BUTTON is not None
    beside = replace(BUTTON, row=-1, column=-1, read="", label_source="inferred")
    assert _decided(FIT, beside, "7", 0.99, TargetConfig()).status == "inferred_only"
    assert _decided(FIT, beside, "7", 0.99, TargetConfig(allow_inferred=True, min_score=0.0)).status == "found"
    assert _decided(FIT, replace(beside, read="7", label_source="read"), "7", 0.99, TargetConfig()).status == "found"
