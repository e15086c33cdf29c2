"""A hand or a finger before the camera: no button is given where it is not, and the aim stays."""

from __future__ import annotations

import numpy as np

from elevator_rectify.benchmark.approach import run_approach
from elevator_rectify.benchmark.hands import run_hand, with_hand
from elevator_rectify.benchmark.pictures import pictured


def test_a_hand_covers_a_third_of_the_buttons_and_changes_nothing_else() -> None:
    given = pictured("easy", 7007, 0, held_out=True)
    covered, under = with_hand(given.image, given.scene, np.random.default_rng(1))
    assert 0.3 <= under.mean() < 1.0
    changed = np.abs(covered.astype(int) - given.image).max(axis=-1) > 0
    at = given.scene.pixels.round().astype(int).clip(0, [639, 479])
    assert changed[at[under, 1], at[under, 0]].all() and not changed.all()


def test_a_covered_button_is_refused_and_one_beside_the_hand_found_where_it_is() -> None:
    found = [asked for number in range(6) for asked in run_hand((7007, number))]
    assert len(found) == 24
    assert not [a for a in found if a.covered and a.status == "found"]
    given = [a for a in found if a.status == "found"]
    assert len(given) >= 6 and all(a.right for a in given)
    assert "occluded" in {a.status for a in found if a.covered and a.seen_before}


def test_the_aim_stays_on_the_button_while_a_column_is_hidden() -> None:
    """The finger hides the first column: a lattice without it has its origin at the second one."""
    steps = run_approach((7007, 5, True))
    assert any(step.hidden for step in steps)
    assert max(step.drift_mm for step in steps if step.accepted) < 3.0
