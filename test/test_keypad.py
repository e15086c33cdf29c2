"""Keypads of destination dispatch are no floors: nothing is renamed, and '10' is no button."""

from __future__ import annotations

import numpy as np
import pytest

from elevator_rectify.core import Camera, Config, Detection, GridFit, ScaleConfig, find_button, fit_panel
from elevator_rectify.core.geometry.rotations import rotation

CAMERA = Camera.centred(640, 480, 500.0)
CONFIG = Config(scale=ScaleConfig(column_pitch_m=0.03))
TELEPHONE = ("1", "2", "3", "4", "5", "6", "7", "8", "9", "*", "0", "#")


def seen(labels: tuple[str, ...]) -> GridFit:
    """Return the fit of a 4 x 3 panel with these labels, row by row, seen from some degrees aside."""
    R = rotation(np.array([0.3, -0.35, 0.03]))
    cells = np.array([[c - 1.0, r - 1.5, 0.0] for r in range(4) for c in range(3)]) * 0.03
    pixels = CAMERA.project(cells @ R.T + np.array([0.0, 0.0, 0.18]))
    return fit_panel(
        [Detection(x, y, 50, 50, t, 0.95) for (x, y), t in zip(pixels.tolist(), labels, strict=True)], CAMERA, CONFIG
    )


@pytest.mark.parametrize("missing", [(), (9, 11), (4, 9)])
def test_a_keypad_is_read_as_it_is_printed(missing: tuple[int, ...]) -> None:
    labels = tuple("" if k in missing else text for k, text in enumerate(TELEPHONE))
    fit = seen(labels)
    assert fit.ok and fit.keypad
    assert {b.label for b in fit.buttons if b.label} == {t for t in labels if t}
    zero = find_button(fit, "0", CONFIG.target)
    assert zero.button is not None and zero.button.read == "0"
    ten = find_button(fit, "10", CONFIG.target)
    assert ten.status == "unknown_label" and "keypad" in ten.reason


@pytest.mark.parametrize(
    "labels",
    [
        ("10", "11", "12", "7", "8", "9", "4", "5", "6", "1", "2", "3"),
        ("9", "10", "11", "6", "7", "8", "3", "4", "5", "0", "1", "2"),
        ("7", "8", "9", "4", "5", "6", "1", "2", "3", "", "0", ""),
        ("1", "2", "3", "4", "5", "6", "7", "8", "9", "10", "11", "12"),
    ],
)
def test_floors_are_no_keypad(labels: tuple[str, ...]) -> None:
    fit = seen(labels)
    assert fit.ok and not fit.keypad


def test_a_sign_is_no_stop_button() -> None:
    assert find_button(seen(TELEPHONE), "stop", CONFIG.target).button is None
