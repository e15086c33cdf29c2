"""Which lamps are lit, told by a single picture; real panels that it was not trained on are in the benchmark."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elevator_rectify.core import Config, TargetConfig, fit_panel, lamps_of, with_lit
from elevator_rectify.core.lamps.lit import FEWEST, beside_others, lit_log_odds, said
from elevator_rectify.core.lamps.patches import Patches, patches_of
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.reading.target import find_button
from elevator_rectify.core.types import Image
from elevator_rectify.render.photograph import Taking, photograph
from elevator_rectify.ros.answer import chosen
from elevator_rectify.ros.buttons import buttons_message
from elevator_rectify.ros.config import DEFAULT_NODE
from test.messages import header
from test.scenes import scene

SCENE = scene(4, tilt_deg=20.0, sigma_px=0.2)
NUMBER = next(k for k, button in enumerate(SCENE.panel.buttons) if button.label == "7")


@cache
def picture(*lit: int) -> Image:
    panel = replace(SCENE.panel, lit=frozenset(lit))
    return photograph(replace(SCENE, panel=panel), np.random.default_rng(1), Taking())


@cache
def fit_to(*lit: int) -> GridFit:
    fit = fit_panel(list(SCENE.detections), SCENE.camera, image=picture(*lit))
    assert fit.ok
    return fit


def patches(*lit: int) -> Patches:
    fit = fit_to(*lit)
    return patches_of(picture(*lit), SCENE.camera, fit, fit.buttons)


def test_a_lit_lamp_is_told_from_the_dark_ones() -> None:
    seen = patches(NUMBER)
    odds = lit_log_odds(seen)
    assert seen.labels[int(np.argmax(odds))] == "7"
    others = np.delete(odds, int(np.argmax(odds)))
    assert odds.max() > others.max() + 2.0
    assert max(lit_log_odds(patches())) < odds.max()


def test_the_order_of_the_buttons_does_not_matter() -> None:
    seen = patches(NUMBER)
    order = np.random.default_rng(5).permutation(len(seen.colour))
    labels = tuple(seen.labels[k] for k in order)
    other = Patches(seen.colour[order], seen.places[order], labels, seen.side_px[order], seen.whole[order])
    assert np.array_equal(beside_others(other), beside_others(seen)[order])
    # OpenCV adds up a batch in its own order.
    assert np.abs(lit_log_odds(other) - lit_log_odds(seen)[order]).max() < 1e-4


def test_beside_too_few_buttons_and_where_one_is_cut_off_nothing_is_said() -> None:
    seen = patches(NUMBER)
    few = Patches(seen.colour[:3], seen.places[:3], seen.labels[:3], seen.side_px[:3], seen.whole[:3])
    assert FEWEST == 4 and np.isnan(lit_log_odds(few)).all()
    whole = seen.whole.copy()
    whole[2] = False
    odds = lit_log_odds(replace(seen, whole=whole))
    assert np.isnan(odds[2]) and np.isfinite(np.delete(odds, 2)).all()
    assert said(float("nan")) == "unseen"


def test_a_grey_picture_says_nothing_of_lamps() -> None:
    fit = fit_to()
    grey = picture()[..., 1].copy()
    assert np.isnan(lamps_of(grey, SCENE.camera, fit, fit.buttons).probability).all()


def test_lamps_are_carried_to_the_same_buttons_of_the_next_frame_only() -> None:
    fit = fit_to(NUMBER)
    lit = lamps_of(picture(NUMBER), SCENE.camera, fit, fit.buttons)
    now = with_lit(fit.buttons, fit, lit)
    assert {b.label for b in now if b.lit_probability > 0.5} <= {"7"}
    assert all(b.lit == "unseen" for b in with_lit(fit.buttons, fit, None))
    gone = replace(fit, t_camera_panel=fit.t_camera_panel + np.array([1.0, 0.0, 0.0]))
    assert all(b.lit == "unseen" for b in with_lit(gone.buttons, gone, lit))


@pytest.mark.parametrize("refuse", [False, True])
def test_a_lit_button_is_given_unless_that_is_refused(refuse: bool) -> None:
    fit = fit_to(NUMBER)
    told = lamps_of(picture(NUMBER), SCENE.camera, fit, fit.buttons)
    lit = replace(told, probability=np.where(told.probability == np.nanmax(told.probability), 0.99, 0.001))
    scaled = replace(fit, metric=True)
    config = Config(target=TargetConfig(max_lateral_std_m=1.0, refuse_lit=refuse))
    assert find_button(scaled, "7", config.target).button is not None
    lit = replace(lit, fit=scaled)
    choice = chosen(scaled, "7", config, DEFAULT_NODE, None, lit=lit)
    assert choice.status == ("lit" if refuse else "found")
    if not refuse:
        assert choice.button is not None and choice.button.lit == "yes"
    dark = chosen(scaled, "8", config, DEFAULT_NODE, None, lit=lit)
    assert dark.button is not None and dark.button.lit == "no" and dark.status == "found"


def stand_in(name: str, /, **fields: Any) -> Any:
    """Stand in for a message of a package that may not be installed."""
    return SimpleNamespace(**fields)


def test_the_message_has_lamps_that_can_be_told() -> None:
    fit = fit_to(NUMBER)
    buttons = [replace(b, lit="yes", lit_probability=0.97) if b.label == "7" else b for b in fit.buttons]
    message = buttons_message(fit, buttons, header(0), stand_in)
    for found in message.detections:
        names = [result.hypothesis.class_id for result in found.results]
        assert names == (["7", "lit"] if names[0] == "7" else names[:1])
        if names[0] == "7":
            assert found.results[1].hypothesis.score == pytest.approx(0.97)
