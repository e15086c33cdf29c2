"""Whether a button's lamp went on: rendered panels before and after, with all that may be mistaken for it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from elevator_rectify.core import fit_panel
from elevator_rectify.core.geometry.same_places import same_places
from elevator_rectify.core.lamps.change import exposure, features, lit_share
from elevator_rectify.core.lamps.patches import Patches, patches_of
from elevator_rectify.core.lamps.watch import (
    JUDGED,
    REFERENCES,
    Sight,
    Watch,
    confirmed,
    ended,
    reference_of,
    watched,
)
from elevator_rectify.core.types import Image
from elevator_rectify.render.overpaint import with_finger
from elevator_rectify.render.photograph import Taking, photograph
from elevator_rectify.render.scene import box_sizes_px
from test.scenes import scene

SCENE = scene(4, tilt_deg=20.0, sigma_px=0.2)
NUMBER = next(k for k, button in enumerate(SCENE.panel.buttons) if button.label == "7")
ALL, USUAL = frozenset(range(len(SCENE.panel.buttons))), Taking()


@cache
def picture(lit: frozenset[int] = frozenset(), taking: Taking = USUAL) -> Image:
    return photograph(replace(SCENE, panel=replace(SCENE.panel, lit=lit)), np.random.default_rng(1), taking)


def seen(image: Image, hidden: str = "") -> Patches:
    fit = fit_panel([d for d in SCENE.detections if d.label != hidden], SCENE.camera, image=image)
    assert fit.ok
    return patches_of(image, SCENE.camera, fit, fit.buttons)


def watch(*after: Patches | None) -> Watch:
    """Three frames before the press, then those."""
    state = Watch("7")
    for now in (*[seen(picture())] * REFERENCES, *after):
        state = watched(state, now, "no panel")
    return state


@pytest.mark.parametrize("taking", [USUAL, Taking(gain=1.3), Taking(gain=0.75, reflection=60.0)])
def test_a_lamp_that_goes_on_is_confirmed_and_its_absence_told(taking: Taking) -> None:
    lit, dark = (seen(picture(lamps, taking)) for lamps in (frozenset({NUMBER}), frozenset()))
    assert confirmed(watch(lit, lit)) is None
    answer = confirmed(watch(lit, lit, lit))
    assert answer is not None and answer.succeeds and answer.probability > 0.9
    state = watch(dark, dark, dark)
    assert confirmed(state) is None and ended(state).status == "not_lit" and 0.85 < ended(state).probability < 0.93


@pytest.mark.parametrize("lamps", [frozenset({NUMBER + 1}), frozenset({NUMBER - 1, NUMBER + 3})])
def test_other_lamps_confirm_nothing(lamps: frozenset[int]) -> None:
    state = watch(*3 * [seen(picture(lamps))])
    assert confirmed(state) is None and ended(state).status in {"not_lit", "unseen"}


def test_a_test_of_all_lamps_is_told_and_is_over_when_they_are_dark_again() -> None:
    test = seen(picture(ALL))
    state = watch(*3 * [test])
    assert confirmed(state) is None and ended(state).status == "all_lit"
    assert ended(watch(*3 * [test], *3 * [seen(picture())])).status == "not_lit"
    answer = confirmed(watch(*3 * [test], *3 * [seen(picture(frozenset({NUMBER})))]))
    assert answer is not None and answer.succeeds


@pytest.mark.parametrize("gain", [0.6, 1.5])
def test_another_exposure_is_no_test_of_the_lamps(gain: float) -> None:
    before, after = seen(picture()), seen(picture(taking=Taking(gain=gain)))
    assert lit_share(before, after) < 0.2


def test_a_lamp_that_was_lit_before_is_not_confirmed() -> None:
    lit = seen(picture(frozenset({NUMBER})))
    state = Watch("7", reference_of([lit]))
    for _ in range(3):
        state = watched(state, lit)
    assert confirmed(state) is None and ended(state).status == "not_lit"


def test_a_lamp_that_blinks_is_called_so() -> None:
    lit, dark = (seen(picture(lamps)) for lamps in (frozenset({NUMBER}), frozenset()))
    for after in ([lit, dark, lit, dark], [lit, dark, dark, lit, dark]):
        state = watch(*after)
        assert confirmed(state) is None and ended(state).status == "blinks" and "2 of" in ended(state).reason


def test_a_label_that_two_buttons_have_is_not_called_hidden() -> None:
    twice = replace(seen(picture()), labels=tuple("7" if k == "8" else k for k in seen(picture()).labels))
    state = watched(Watch("7", reference_of([twice])), twice)
    assert state.sights[-1].problem == "7 is read on 2 buttons"


@pytest.mark.parametrize("seed", range(6))
def test_a_finger_on_the_button_is_no_lamp(seed: int) -> None:
    size = box_sizes_px(SCENE.panel, SCENE.camera, SCENE.R_camera_panel, SCENE.t_camera_panel)[NUMBER]
    box = np.concatenate([SCENE.pixels[NUMBER] - size / 2, SCENE.pixels[NUMBER] + size / 2])
    covered = with_finger(picture(), box, np.random.default_rng(seed))
    assert confirmed(watch(*3 * [seen(covered)])) is None
    state = watch(*3 * [seen(covered, hidden="7")])
    assert confirmed(state) is None
    assert (ended(state).status, "hidden" in ended(state).reason) == ("unseen", True)


@pytest.mark.parametrize(
    ("sight", "is_confirmed"),
    [
        (Sight(5.0, 4.0), True),
        (Sight(5.0, 2.0), False),
        (Sight(7.0, 2.0), True),
        (Sight(7.0, 1.0), False),
        (Sight(2.5, 7.0), False),
        (Sight(7.0), True),
        (Sight(5.0), False),
    ],
)
def test_a_change_is_confirmed_that_looks_like_a_lamp(sight: Sight, is_confirmed: bool) -> None:
    state = Watch("7", sights=(sight,) * JUDGED, frames=JUDGED)
    assert (confirmed(state) is not None) == is_confirmed
    if not is_confirmed:
        assert ended(replace(state, references=3 * (seen(picture()),))).status == "unseen"


def test_frames_alone_are_asked_only_where_something_changed() -> None:
    dark, lit = seen(picture()), seen(picture(frozenset({NUMBER})))
    state = watch(dark, lit)
    assert np.isnan(state.sights[0].lit) and np.isfinite(state.sights[1].lit)


def test_a_panel_that_is_left_is_told_in_the_end_and_what_hides_it_is_waited_for() -> None:
    state = watch(*5 * [None])
    assert confirmed(state) is None and ended(state).status == "panel_left"
    assert ended(watch(*4 * [None])).status == "unseen"
    assert ended(watch(*5 * [seen(picture(), hidden="7")])).status == "unseen"
    lit = seen(picture(frozenset({NUMBER})))
    answer = confirmed(watch(*9 * [None], lit, lit, lit))
    assert answer is not None and answer.succeeds


def test_without_frames_or_without_the_button_before_the_reason_says_so() -> None:
    assert ended(Watch("7")).status == "no_frames"
    state = Watch("99")
    for _ in range(5):
        state = watched(state, seen(picture()))
    assert ended(state).status == "unseen" and "before the press" in ended(state).reason


def chosen(patches: Patches, order: list[int]) -> Patches:
    labels = tuple(patches.labels[k] for k in order)
    return Patches(patches.colour[order], patches.places[order], labels, patches.side_px[order], patches.whole[order])


def test_the_order_of_the_buttons_does_not_matter() -> None:
    before, after = seen(picture()), seen(picture(frozenset({NUMBER})))
    k, order = before.labels.index("7"), list(reversed(range(len(before.labels))))
    one = features(before, after, k)
    other = features(chosen(before, order), chosen(after, order), order.index(k))
    assert one is not None and other is not None
    np.testing.assert_allclose(one, other, atol=1e-4)


def test_beside_two_other_buttons_nothing_is_said() -> None:
    before = chosen(seen(picture()), [0, 1, 2])
    assert features(before, before, 0) is None


def test_the_exposure_is_found_exactly_though_one_lamp_went_on() -> None:
    before = seen(picture(taking=Taking(gain=0.5)))
    k = before.labels.index("7")
    slope = np.exp(0.1 + 0.05 * (before.places - before.places.mean(axis=0)) @ [1.0, -0.5])
    brighter = before.colour * slope[:, None, None, None]
    brighter[k] = 240.0
    found = exposure(before, replace(before, colour=brighter))
    # The median of ratios of equal pixels is exact; only the clipping of the weights is iterated.
    np.testing.assert_allclose(found / slope, 1.0, atol=0.005)


def test_buttons_are_the_same_though_the_lattice_begins_elsewhere() -> None:
    before = seen(picture())
    fewer = chosen(before, [k for k in range(len(before.labels)) if before.places[k, 1] > 0.5])
    moved = replace(fewer, places=fewer.places - np.array([0.0, fewer.places[:, 1].min()]))
    pairs = same_places(before, moved)
    assert len(pairs) == len(fewer.labels)
    assert all(before.labels[i] == moved.labels[j] for i, j in pairs)


def test_another_panel_is_not_taken_for_the_same() -> None:
    before = seen(picture())
    other = replace(before, labels=tuple(str(100 + k) for k in range(len(before.labels))))
    assert not len(same_places(before, other))
