"""A button that was read a little before and is not seen now: it is hidden, not unknown."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from elevator_rectify.benchmark.pictures import Pictured, pictured
from elevator_rectify.core import Config, GridFit, ScaleConfig, TargetConfig, find_button, fit_panel
from elevator_rectify.core.reading.hidden import SeenLabels, hidden_labels, respaced, seen_labels, unless_hidden
from elevator_rectify.core.track import Track
from elevator_rectify.ros.answer import Answer, answer_frame
from elevator_rectify.ros.pairing import Frame
from test.messages import camera_info, image
from test.scenes import scene

VIEW = scene(4, rows=5, columns=3, tilt_deg=20.0)
LABELS = [b.label for b in VIEW.panel.buttons]
METRIC = Config(scale=ScaleConfig(column_pitch_m=0.05), target=TargetConfig(max_lateral_std_m=1.0))


def fit_of(*missing: str) -> GridFit:
    shown = [replace(d, score=0.99) for d in VIEW.detections if d.label not in missing]
    return fit_panel(shown, VIEW.camera, METRIC)


def test_only_a_button_that_was_seen_before_is_hidden() -> None:
    before, now = seen_labels(fit_of(LABELS[9])), fit_of(LABELS[7], LABELS[9])
    assert hidden_labels(seen_labels(now, before), now, VIEW.camera) == {LABELS[7]}
    whole = fit_of(LABELS[9])
    assert hidden_labels(seen_labels(whole, before), whole, VIEW.camera) == frozenset()
    choice = unless_hidden(find_button(now, LABELS[7], METRIC.target), LABELS[7], frozenset({LABELS[7]}))
    assert choice.status == "occluded" and choice.button is None and LABELS[7] in choice.reason


def test_a_hidden_button_is_not_given_though_inferred_ones_may_be() -> None:
    lenient = replace(METRIC.target, allow_inferred=True, min_probability=0.5, min_inferred_probability=0.5)
    now = fit_of(LABELS[7])
    assert find_button(now, LABELS[7], lenient).button is not None
    hidden = hidden_labels(seen_labels(now, seen_labels(fit_of())), now, VIEW.camera)
    assert unless_hidden(find_button(now, LABELS[7], lenient), LABELS[7], hidden).status == "occluded"
    assert unless_hidden(find_button(now, LABELS[6], lenient), LABELS[6], hidden).button is not None


def test_another_button_is_not_taken_for_the_hidden_one_by_the_order_alone() -> None:
    now, hidden = fit_of(LABELS[7]), frozenset({LABELS[7]})
    found = find_button(now, LABELS[10], METRIC.target)
    assert found.button is not None
    for source, status in (("read", "found"), ("corrected", "occluded")):
        taken = replace(found, button=replace(found.button, label=LABELS[7], label_source=source))
        assert unless_hidden(taken, LABELS[7], hidden).status == status


def test_a_label_at_another_place_leaves_its_button_hidden() -> None:
    now = fit_of(LABELS[7])
    seen = seen_labels(now, seen_labels(fit_of()))
    elsewhere = replace(seen, labels=tuple(LABELS[7] if name == LABELS[10] else name for name in seen.labels))
    assert LABELS[7] in hidden_labels(elsewhere, now, VIEW.camera)


def test_what_was_seen_is_kept_while_it_is_hidden_and_though_the_lattice_begins_elsewhere() -> None:
    first_row = LABELS[:3]
    seen = seen_labels(fit_of())
    for _ in range(3):
        now = fit_of(*first_row)
        seen = seen_labels(now, seen)
        assert hidden_labels(seen, now, VIEW.camera) == set(first_row)
    assert sorted(seen_labels(fit_of(), seen).labels) == sorted(LABELS)


def test_of_another_panel_nothing_is_hidden() -> None:
    other = SeenLabels(seen_labels(fit_of()).places, tuple(str(70 + k) for k in range(len(LABELS))))
    now = fit_of(LABELS[7])
    assert hidden_labels(seen_labels(now, other), now, VIEW.camera) == frozenset()
    assert set(seen_labels(fit_of(), other).labels) == set(LABELS)


def test_a_lattice_without_its_middle_column_is_told_by_the_labels_distances() -> None:
    """Its columns are two pitches apart: with a known pitch the panel would be at half its distance."""
    whole, sides = fit_of(), fit_of(*LABELS[1::3])
    assert sides.ok and sides.columns == 2 and sides.t_camera_panel[2] < 0.6 * whole.t_camera_panel[2]
    assert "0.50 times as many pitches apart" in respaced(seen_labels(whole), sides)
    for right in (fit_of(*LABELS[0::3]), fit_of(*LABELS[:3]), fit_of(LABELS[7]), whole):
        assert right.ok and not respaced(seen_labels(whole), right)
    # What shows more of the panel than before is believed.
    assert not respaced(seen_labels(sides), whole)


def test_what_left_the_picture_is_not_hidden() -> None:
    now = fit_of(LABELS[0])
    seen = seen_labels(now, seen_labels(fit_of()))
    x, y = VIEW.pixels[0]
    K = VIEW.camera.matrix - [[0.0, 0.0, x + 5.0], [0.0, 0.0, y + 5.0], [0.0, 0.0, 0.0]]
    cut = type(VIEW.camera).from_matrix(K, VIEW.camera.width, VIEW.camera.height)
    assert hidden_labels(seen, now, VIEW.camera) == {LABELS[0]}
    assert hidden_labels(seen, now, cut) == frozenset()


def answered(given: Pictured, tenths: int, target: str, at: int, track: Track | None) -> tuple[Answer, Track | None]:
    """Answer a frame in which a hand is before the button `at`, -1: before none."""
    stamp, picture = 100_000_000 * tenths, given.image.copy()
    if at >= 0:
        x, y = given.scene.pixels[at]
        cv2.ellipse(picture, (int(x), int(y) + 40), (28, 70), 10, 0, 360, (120, 150, 200), -1)
    frame = Frame(image(stamp, picture), camera_info(stamp, given.scene.camera), None)
    return answer_frame(frame, METRIC, (), target=target, track=track)


@pytest.mark.parametrize("number", [3, 7])
def test_a_hand_before_the_button_makes_it_occluded_until_it_goes(number: int) -> None:
    given = pictured("easy", 60, 0, held_out=True)
    label, statuses, track = given.scene.panel.buttons[number].label, [], None
    for tenths, at in ((1, -1), (7, number), (13, number), (19, -1)):
        answer, track = answered(given, tenths, label, at, track)
        assert answer.choice is not None
        statuses.append(answer.choice.status)
    assert statuses == ["found", "occluded", "occluded", "found"]
    # A track that is old remembers nothing.
    late, _ = answered(given, 1000, label, number, track)
    assert late.choice is not None and late.choice.status != "occluded" and late.choice.button is None


def test_an_arm_before_the_middle_column_leaves_the_panel_at_its_distance() -> None:
    """The frame before is too old to start from; the labels are remembered."""
    given, track, answers = pictured("easy", 60, 9, held_out=True), None, []
    middle = [given.scene.pixels[k] for k, b in enumerate(given.scene.panel.buttons) if b.column == 1]
    width = int(0.8 * np.linalg.norm(given.scene.pixels[1] - given.scene.pixels[0]))
    way = (middle[-1] - middle[0]) / np.linalg.norm(middle[-1] - middle[0])
    ends = [tuple(int(v) for v in at) for at in (middle[0] - 60.0 * way, middle[-1] + 400.0 * way)]
    for tenths, hidden in ((1, False), (60, True), (120, False)):
        stamp, shown = 100_000_000 * tenths, given.image.copy()
        if hidden:
            cv2.line(shown, *ends, (120, 150, 200), width)
        frame = Frame(image(stamp, shown), camera_info(stamp, given.scene.camera), None)
        answer, track = answer_frame(frame, METRIC, ("labels",), track=track)
        answers.append(answer)
    assert [a.fit.status for a in answers] == ["ok", "ambiguous", "ok"]
    assert "hidden, or doubled" in answers[1].fit.reason and answers[1].panel_frame is None
    assert track is not None and track.seen is not None
    assert len(track.seen.labels) == len(given.scene.panel.buttons)
