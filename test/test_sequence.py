"""Floors in their order: the hidden Markov model, corrections, inferred buttons."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from elevator_rectify.core import Button, Detection, GridFit, find_button, fit_panel
from elevator_rectify.core.config import TargetConfig
from elevator_rectify.core.reading.chain import OTHER, OTHER_BEFORE, Emissions, forward_backward, step_table
from elevator_rectify.core.reading.filled import COEFFICIENTS, FEATURES, features, missed
from elevator_rectify.core.reading.misread import confusion, looks_like
from elevator_rectify.core.reading.orders import Order, likely_orders
from elevator_rectify.core.reading.places import PanelPlaces
from elevator_rectify.core.types import Array
from elevator_rectify.core.view.text_grid import text_grid
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


def line_of(index: list[int], starts: list[int], jump: int = 1) -> Order:
    """Return places in an order; the numbers of those with which lines begin."""
    return Order(np.array(index), np.isin(np.arange(len(index)), starts), jump, 1.0)


def summed(emissions: Emissions, order: Order, low: int, high: int) -> tuple[float, Array, Array]:
    """Return evidence, floors and others by the sum over all paths: the slow reference."""
    K, S = emissions.floor.shape[1:]
    usual, jumping = step_table(low, high), step_table(low, high, order.jump)
    total, floor, other = 0.0, np.zeros((K, S)), np.zeros(K)
    for path in product(range(S + 1), repeat=K):
        weight, last = 1.0, S
        for k, state in enumerate(path):
            away = (OTHER_BEFORE if last == S else OTHER) if emissions.filled[0, k] else None
            if state == S:
                weight *= (1.0 if away is None else away) * emissions.other[0, k]
                continue
            table = jumping if order.jump > 1 and order.starts[k] else usual
            weight *= (1.0 if away is None else 1.0 - away) * table[last, state] * emissions.floor[0, k, state]
            last = state
        total += weight
        for k, state in enumerate(path):
            if state == S:
                other[k] += weight
            else:
                floor[k, state] += weight
    return total, floor / total, other / total


@pytest.mark.parametrize("jump", [1, 2])
def test_forward_backward_is_the_sum_over_all_paths(jump: int) -> None:
    rng = np.random.default_rng(4)
    K = 6
    filled = np.array([[True, False, True, True, False, True]])
    given = Emissions(rng.uniform(0.1, 1.0, (1, K, 3)), rng.uniform(0.1, 1.0, (1, K)), filled)
    order = line_of([0, 1, 2, 3, 4, 5], [0, 2, 4], jump)
    found = forward_backward(given, np.array([1, 2, 3]), [order])
    total, floor, other = summed(given, order, 1, 3)
    # Sums of a few hundred products.
    np.testing.assert_allclose(found.evidence[0], np.log(total), rtol=1e-10)
    np.testing.assert_allclose(found.floor[0], floor, rtol=1e-9)
    np.testing.assert_allclose(found.other[0], other, rtol=1e-9)


def test_steps_to_the_next_floor_are_probabilities() -> None:
    for jump in (1, 3):
        table = step_table(-2, 60, jump)
        # Far from the end of the considered numbers, where nothing is cut off.
        np.testing.assert_allclose(table[:20].sum(axis=1), 1.0, atol=0.02)
        assert (table > 0).all() and table[5].argmax() == 5 + jump
    assert step_table(1, 20)[11].argmax() == 13


def grid_reading(labels: list[list[str]]) -> GridFit:
    """Return the view's fit with other labels on its cells."""
    fit = fitted({})
    texts = [labels[r][c] for r, c in fit.cells]
    return replace(fit, detections=tuple(replace(d, label=t) for d, t in zip(fit.detections, texts, strict=True)))


ORDERS = {
    "rows up": lambda r, c: 1 + 3 * (5 - r) + c,
    "rows up from the right": lambda r, c: 1 + 3 * (5 - r) + 2 - c,
    "columns up": lambda r, c: 1 + 6 * c + 5 - r,
    "rows down": lambda r, c: 1 + 3 * r + c,
    "decades": lambda r, c: 10 * (5 - r) + 1 + c,
    "odd rows": lambda r, c: 5 * (5 - r) + 3 + c,
}


@pytest.mark.parametrize("name", list(ORDERS))
def test_every_usual_order_of_numbering_is_recognised(name: str) -> None:
    """One floor unread and one misread: both follow from the others."""
    labels = [[str(ORDERS[name](r, c)) for c in range(3)] for r in range(6)]
    spoilt = [row.copy() for row in labels]
    spoilt[2][1], spoilt[4][1] = "", labels[4][1][:-1] + ("1" if labels[4][1].endswith("7") else "7")
    buttons = {(b.row, b.column): b for b in grid_reading(spoilt).buttons}
    assert (buttons[2, 1].label, buttons[2, 1].label_source) == (labels[2][1], "inferred")
    assert (buttons[4, 1].label, buttons[4, 1].label_source) == (labels[4][1], "corrected")
    others = [(r, c) for r, c in np.ndindex(6, 3) if (r, c) not in [(2, 1), (4, 1)]]
    assert all(buttons[place].label == labels[place[0]][place[1]] for place in others)


def test_probabilities_of_a_place_add_up() -> None:
    rng = np.random.default_rng(5)
    labels = [[str(rng.integers(-3, 40)) if rng.random() < 0.7 else "" for _ in range(3)] for _ in range(6)]
    fit = grid_reading(labels)
    floors = fit.reading.floors
    assert floors is not None
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
    """Without labels, the layout alone tells."""
    middle, corner = (next(k for k in range(18) if tuple(VIEW.panel.cells[k]) == cell) for cell in ((2, 1), (0, 2)))
    fit = fitted(dict.fromkeys(range(18), ""), without=(middle, corner))
    assert at(fit, middle).probability > 0.7 > at(fit, corner).probability


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


def test_the_model_of_missed_buttons_has_a_coefficient_for_every_feature() -> None:
    assert list(json.loads(COEFFICIENTS.read_text())["coefficients"]) == list(FEATURES)
    fit = fitted({}, without=(4, 9))
    places = fit.reading.places
    empty = np.flatnonzero(~places.filled)
    table = features(fit, places, fit.reading.floor_nats, empty)
    assert table.shape == (2, len(FEATURES)) and np.isfinite(table).all()
    # One of the kinds of neighbours, in one of the zones.
    assert (table[:, :24].sum(axis=1) == 1.0).all()


def test_the_floors_order_makes_a_missed_button_more_probable() -> None:
    fit = fitted({}, without=(9,))
    none, some = (missed(fit, fit.reading.places, np.full(18, nats)) for nats in (0.0, 3.0))
    empty = ~fit.reading.places.filled
    assert (some[empty] > none[empty]).all() and (none[~empty] == 1.0).all()


def test_floors_along_the_diagonals_of_a_brick_layout_are_read() -> None:
    """1 to 4 run down to the right, 5 to 8 beside them."""
    row, column = (i.ravel() for i in np.indices((4, 4)))
    along = column + 0.5 * (row % 2)
    line = np.round(along - 0.5 * row - (along - 0.5 * row).min()).astype(int)
    number = 1.0 + 4 * line + row
    places = bare_places(np.column_stack([row, column]).astype(float), np.column_stack([row, along]))
    best = likely_orders(places, number)[0]
    assert (np.diff(number[best.index]) > 0).all()


@pytest.mark.parametrize("turned", [0, 1])
def test_floors_that_run_there_and_back_are_read(turned: int) -> None:
    """7 8 9 above 6 5 4 above 1 2 3, or the other way about."""
    row, column = (i.ravel().astype(float) for i in np.indices((3, 3)))
    number = 1.0 + 3 * (2 - row) + np.where(row % 2 == turned, 2 - column, column)
    places = bare_places(np.column_stack([row, column]), np.column_stack([row, column]))
    best = likely_orders(places, number)[0]
    assert (np.diff(number[best.index]) == 1).all()


Readings = tuple[tuple[str, float], ...]


def panel_of(changed: dict[str, Readings]) -> GridFit:
    """Return the view's fit where each button is read as its label, but for these."""
    detections = []
    for d, b in zip(labelled({}), VIEW.button, strict=True):
        read = changed.get(label_of(b), ((label_of(b), 0.97),))
        detections.append(replace(d, label=_top(read), score=read[0][1] if read else 1.0, readings=read))
    return fit_panel(detections, VIEW.camera, METRIC)


def _top(read: Readings) -> str:
    return read[0][0] if read and read[0][1] > 1.0 - sum(p for _, p in read) else ""


def test_the_second_reading_counts_where_the_order_asks_for_it() -> None:
    """A 6 that may be an 8 between 7 and 9 is the 8."""
    fit = panel_of({"8": (("6", 0.5), ("8", 0.4))})
    eight = next(b for b in fit.buttons if b.read == "6" and b.label != "6")
    assert eight.label == "8" and eight.label_source == "corrected" and eight.label_probability > 0.9
    assert sorted(b.label for b in fit.buttons) == sorted(label_of(b) for b in VIEW.button)


def test_what_cannot_be_read_says_nothing_and_the_order_fills_it() -> None:
    button = next(b for b in panel_of({"6": (("3", 0.02), ("8", 0.02))}).buttons if not b.read)
    assert button.label == "6" and button.label_source == "inferred"


def test_the_order_does_not_say_what_the_reader_ruled_out() -> None:
    """A panel may have an order of its own: a clear 2 in the place of the 6 is not taken for the 6."""
    fit = panel_of({"6": (("2", 0.9), ("3", 0.05))})
    assert find_button(fit, "6").button is None
    assert [b.label for b in fit.buttons if b.read == "2"] == ["2", "2"]


def test_one_button_that_may_be_open_is_it_and_two_are_asked_about() -> None:
    maybe = (("open", 0.7), ("up", 0.1))
    one = panel_of({"1": maybe, "2": (("close", 0.95),)})
    assert find_button(one, "open").button is not None
    two = panel_of({"1": maybe, "2": (("open", 0.55), ("close", 0.3))})
    assert find_button(two, "open").status == "two_candidates"
    none = panel_of({"1": (("alarm", 0.9), ("open", 0.01)), "2": (("close", 0.95),)})
    assert find_button(none, "open").button is None


@pytest.mark.parametrize("readings", [(("", 0.5),), (("7", float("nan")),), (("7", 2.0), ("8", -1.0)), (("7", 0.0),)])
def test_readings_that_are_none_are_left_out(readings: Readings) -> None:
    places = panel_of({"1": readings}).reading.places
    assert all(0.0 < p <= 1.0 for read in places.readings for _, p in read)
    assert all(sum(p for _, p in read) <= 1.0 + 1e-9 for read in places.readings)


def bare_places(line: Array, at: Array) -> PanelPlaces:
    """Return places with a button at each and no more."""
    count, no = len(line), np.zeros(len(line), dtype=bool)
    texts = ("",) * count
    return PanelPlaces(count, line, at, at, np.arange(count), texts, texts, np.ones(count), no, no, no)
