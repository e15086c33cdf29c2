"""Which lamps are lit, by a single picture: a small network that sees each button beside the panel's others."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.same_places import mutually_nearest, stayed
from elevator_rectify.core.lamps.patches import Patches, patches_of
from elevator_rectify.core.types import Array, Button, FitResult, Image

WEIGHTS = Path(__file__).with_name("lit.onnx")
# Written by `calibrate --lit`: slope and offset of the log odds, what is added for caps that are often coloured, and
# from which probabilities on it is told.
CALIBRATION = Path(__file__).with_name("lit.json")
# Beside fewer buttons nothing can be said; so many of them are the nearest.
FEWEST, _NEAREST = 4, 4
# Their caps and signs are often coloured, or brighter than the others.
COLOURED = frozenset({"alarm", "call", "stop", "key", "light", "fan"})
_TIES = np.array([1e-4, 3.7e-5])
# Grey values are given over this one.
_MIDDLE = 128.0
# A button is the one that was looked at before where it is as near to it, in column pitches.
_SAME_PLACE = 0.25


@dataclass(frozen=True)
class Lit:
    """What was seen in an accepted fit: places (K, 2) of its buttons in column pitches, and how probable it is of each
    (K,) that its lamp is lit, NaN where it was not seen well."""

    fit: FitResult
    places: Array
    probability: Array


def beside_others(patches: Patches) -> Image:
    """Return (K, 9, n, n) in grey values: each button, the median of all of them and of the four nearest."""
    colour = patches.colour
    apart = np.linalg.norm(patches.places[:, None] - patches.places[None], axis=-1)
    # Of a lattice's neighbours many are equally near: of those the first by their places.
    near = np.argsort(apart + patches.places @ _TIES, axis=1)[:, 1 : 1 + _NEAREST]
    # Mean of the middle two: the median of four.
    middle = np.sort(colour[near], axis=1)[:, 1:3].mean(axis=1) if near.shape[1] == _NEAREST else colour
    usual = np.broadcast_to(np.median(colour, axis=0), colour.shape)
    return np.ascontiguousarray(np.concatenate([colour, usual, middle], axis=-1).transpose(0, 3, 1, 2))


def as_given(seen: Array | NDArray[np.float32]) -> NDArray[np.float32]:
    """Return grey values as the network takes them."""
    return np.asarray(seen / np.float32(_MIDDLE) - 1.0, dtype=np.float32)


def lit_log_odds(patches: Patches, weights: Path = WEIGHTS) -> Array:
    """Return (K,) what the network says, as it comes: NaN beside too few others, in grey, and of buttons cut off."""
    odds = np.full(len(patches.colour), np.nan)
    if len(odds) < FEWEST or not patches.whole.any() or not np.ptp(patches.colour, axis=-1).any():
        return odds
    network = _network(weights)
    network.setInput(as_given(beside_others(patches)[patches.whole]))
    odds[patches.whole] = np.array(network.forward(), dtype=float).ravel()
    return odds


@cache
def _network(path: Path) -> Any:
    return cv2.dnn.readNetFromONNX(str(path))


@cache
def _calibration() -> dict[str, float]:
    return {name: float(value) for name, value in json.loads(CALIBRATION.read_text()).items()}


def lit_probability(odds: Array, labels: Sequence[str]) -> Array:
    """Return the calibrated probabilities (K,) of what the network says of buttons with these canonical labels."""
    known = _calibration()
    coloured = np.array([label in COLOURED for label in labels], dtype=float)
    return np.asarray(1.0 / (1.0 + np.exp(-(known["slope"] * odds + known["offset"] + known["coloured"] * coloured))))


def lamps_of(image: Image, camera: Camera, fit: FitResult, buttons: Sequence[Button]) -> Lit:
    """Return which lamps of an accepted fit's buttons are lit in its picture (height, width[, 3])."""
    return lit_in(fit, patches_of(image, camera, fit, buttons))


def lit_in(fit: FitResult, patches: Patches) -> Lit:
    """Return which lamps are lit by the patches of an accepted fit's buttons."""
    return Lit(fit, patches.places, lit_probability(lit_log_odds(patches), patches.labels))


def with_lit(buttons: Sequence[Button], fit: FitResult, lit: Lit | None) -> tuple[Button, ...]:
    """Return the buttons of an accepted fit with their lamps as they were seen in it, or in one just before."""
    if lit is None or not len(lit.places) or not stayed(fit, lit.fit):
        return tuple(buttons)
    places = np.array([b.panel for b in buttons]).reshape(-1, 2) / fit.column_pitch
    apart = np.linalg.norm(places[:, None] - lit.places[None], axis=-1)
    told = {int(k): float(lit.probability[n]) for k, n in mutually_nearest(apart, _SAME_PLACE)}
    return tuple(_told(button, told.get(k, float("nan"))) for k, button in enumerate(buttons))


def _told(button: Button, probability: float) -> Button:
    if button.detection < 0:
        return button
    return replace(button, lit=said(probability), lit_probability=probability)


def said(probability: float) -> str:
    """Return 'yes', 'no' or, where that is not sure, 'unseen'."""
    known = _calibration()
    return "yes" if probability >= known["yes"] else "no" if probability <= known["no"] else "unseen"
