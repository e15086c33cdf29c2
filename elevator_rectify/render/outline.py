"""Outlines of buttons, in the panel's plane: for drawing, for the boxes of the detector model, and as truth."""

from __future__ import annotations

import numpy as np

from elevator_rectify.core.types import Array
from elevator_rectify.render.panel import Look

_POINTS_A_CORNER = 16


def half_size_m(look: Look, pitch_m: tuple[float, float]) -> Array:
    """Return half the width and height (2,) of a button's cap in metres."""
    half = 0.5 * look.button_share * min(pitch_m)
    return np.array([half * look.aspect, half])


def outline_m(look: Look, pitch_m: tuple[float, float], grown: float = 0.0) -> Array:
    """Return the cap's outline (M, 2) in metres around its centre, `grown` by a share of its half height.

    All shapes are rectangles with rounded corners: a circle's radius is its half size, an octagon's corners are cut.
    """
    half = half_size_m(look, pitch_m)
    half = half + grown * half[1]
    radius = float(half.min()) * (1.0 if look.shape == "round" else look.corner_share)
    steps = 2 if look.shape == "octagon" else _POINTS_A_CORNER
    if look.shape == "octagon":
        radius = float(half.min()) * 2.0 * (1.0 - np.sqrt(0.5))
    turns = np.linspace(0.0, np.pi / 2, steps)
    corners = []
    for quarter, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        angle = turns + quarter * np.pi / 2
        centre = np.array([sx, sy]) * (half - radius)
        corners.append(centre + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    return np.concatenate(corners)
