"""Floors in their order: the hidden Markov model, corrections, inferred buttons."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from elevator_rectify.core import Button, Detection, GridFit, find_button, fit_panel
from elevator_rectify.core.config import TargetConfig
from elevator_rectify.core.filled import present
from elevator_rectify.core.misread import confusion, looks_like
from elevator_rectify.core.sequence import _OTHER, Reads, _forward_backward, _Steps, floors_of
from elevator_rectify.core.text_grid import text_grid
from test.test_buttons import METRIC, VIEW, labelled


def at(fit: GridFit, button: int) -> Button:
    """Return the place of a button of the view's panel."""
    row, column = VIEW.panel.cells[button]
    return next(b for b in fit.buttons if (b.row, b.column) == (row, column))


def label_of(button: int) -> str:
    return VIEW.panel.buttons[button].label


def fitted(labels: dict[int, str], without: tuple[int, ...] = ()) -> GridFit:
    given = [d for d, b in zip(labelled(labels), VIEW.button, strict=True) if b not in without]
    return fit_panel(given, VIEW.camera, METRIC)


def test_forward_backward_is_the_sum_over_all_paths() -> None:
    rng = np.random.default_rng(4)
    numbers, K = np.array([1, 2, 3, 4]), 4
    emit, emit_other = rng.uniform(0.1, 1.0, (1, K, 4)), rng.uniform(0.1, 1.0, (1, K))
    filled = np.array([[True, False, True, True]])
    steps = _Steps(numbers, np.array([2]), np.array([[False, False, True, False]]))
    floor, other, evidence = _forward_backward(emit, emit_other, filled, steps)
    total, marginal = 0.0, np.zeros((K, 5))
    for path in product(range(5), repeat=K):
        weight, last, kind = 1.0, -1, 2
        for k, state in enumerate(path):
            stay = _OTHER[kind] if filled[0, k] else 1.0
            go = 1.0 - _OTHER[kind] if filled[0, k] else 1.0
            if state == 4:
                weight *= stay * emit_other[0, k]
                kind = 1 if last >= 0 else 2
                continue
            table = steps.jump[0] if steps.changes[0, k] else steps.step
            weight *= go * (steps.first[state] if last < 0 else table[last, state]) * emit[0, k, state]
            last, kind = state, 0
        total += weight
        for k, state in enumerate(path):
            marginal[k, state] += weight
    np.testing.assert_allclose(evidence[0], np.log(total), rtol=1e-10)
    np.testing.assert_allclose(floor[0], marginal[:, :4] / total, rtol=1e-9)
    np.testing.assert_allclose(other[0], marginal[:, 4] / total, rtol=1e-9)


def test_probabilities_of_a_cell_add_up() -> None:
    rng = np.random.default_rng(5)
    labels = tuple(str(rng.integers(-3, 40)) if rng.random() < 0.7 else "" for _ in range(24))
    filled = rng.random(24) < 0.8
    reads = Reads(labels, rng.random(24), filled, present(filled.reshape(8, 3)).ravel())
    floors = floors_of(reads, 8, 3)
    np.testing.assert_allclose(floors.floor.sum(axis=1) + floors.other, 1.0, atol=1e-9)


def test_misreadings_are_probabilities_and_look_alikes_are_digits() -> None:
    np.testing.assert_allclose(confusion().sum(axis=1), 1.0, atol=1e-12)
    assert (np.diag(confusion()) == 0).all()
    assert looks_like("I2") == "12" and looks_like("ALARM") == "" and looks_like("B") == ""


def test_what_contradicts_the_order_is_corrected_and_said_to_be() -> None:
    twelve = next(k for k in range(18) if label_of(k) == "12")
    for misread in ("11", "72", "I2"):
        button = at(fitted({twelve: misread}), twelve)
        assert (button.label, button.label_source) == ("12", "corrected") and button.label_probability > 0.9
        assert button.read == misread


def test_an_unread_label_is_inferred_between_its_neighbours() -> None:
    eight = next(k for k in range(18) if label_of(k) == "8")
    button = at(fitted({eight: ""}), eight)
    assert (button.state, button.label, button.label_source) == ("observed", "8", "inferred")


def test_what_is_read_right_stays() -> None:
    fit = fitted({})
    assert all(b.label == b.read and b.label_source == "read" for b in fit.buttons)


def test_a_panel_without_order_is_left_alone() -> None:
    numbers = np.random.default_rng(8).permutation(np.arange(1, 60))[:18]
    fit = fitted({k: str(n) for k, n in enumerate(numbers)})
    assert all(b.label == b.read for b in fit.buttons)


def test_the_same_label_everywhere_is_no_choice() -> None:
    fit = fitted(dict.fromkeys(range(18), "7"))
    assert find_button(fit, "7").button is None


def test_a_missed_button_is_inferred_but_not_pressed_unless_allowed() -> None:
    eight = next(k for k in range(18) if label_of(k) == "8")
    fit = fitted({}, without=(eight,))
    button = at(fit, eight)
    assert (button.state, button.label, button.detection) == ("inferred", "8", -1) and button.probability > 0.9
    place = VIEW.R_camera_panel @ VIEW.panel.points_m[eight] + VIEW.t_camera_panel
    assert np.linalg.norm(button.point - place) < 0.03 * np.linalg.norm(place)
    assert find_button(fit, "8").status == "inferred_only"
    assert find_button(fit, "8", TargetConfig(allow_inferred=True)).status == "found"


def test_a_cell_that_the_order_skips_stays_empty() -> None:
    """5, nothing, 6: there is no floor between them."""
    labels, count = {}, 0
    for k in sorted(range(18), key=lambda b: (-VIEW.panel.cells[b][0], VIEW.panel.cells[b][1])):
        if k != 7:
            count += 1
            labels[k] = str(count)
    assert at(fitted(labels, without=(7,)), 7).state == "empty"


def test_cells_inside_are_likelier_filled_than_corners() -> None:
    filled = np.ones((5, 3), dtype=bool)
    filled[2, 1] = filled[0, 0] = False
    prior = present(filled)
    assert prior[2, 1] > 0.9 > 0.5 > prior[0, 0] and prior[filled].min() == 1.0


@pytest.mark.parametrize("text", ["", "\x00", "x" * 500, "7\n", "\u202e7", "-", "--3", "٣"])
def test_any_text_is_a_label(text: str) -> None:
    fit = fitted(dict.fromkeys(range(0, 18, 2), text))
    assert len(fit.buttons) == 18
    find_button(fit, text)


def test_the_text_grid_shows_the_wall() -> None:
    eight, twelve = (next(k for k in range(18) if label_of(k) == name) for name in ("8", "12"))
    lines = text_grid(fitted({twelve: "72", 0: ""}, without=(eight,)).buttons).split("\n")
    assert [line.split() for line in lines][:4] == [
        ["16?", "17", "18"],
        ["13", "14", "15"],
        ["10", "11", "12!"],
        ["7", "(8)", "9"],
    ]


def test_detections_without_labels_have_no_order() -> None:
    fit = fit_panel([replace(d, label="") for d in VIEW.detections if isinstance(d, Detection)], VIEW.camera, METRIC)
    assert {b.label for b in fit.buttons} == {""}
