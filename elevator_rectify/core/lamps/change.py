"""What changed of a button between two moments, beside what changed of the others.

A lamp makes ring, print or cap brighter or more colourful, and leaves the plate around as it was. An exposure that
changes, light that falls otherwise and a reflection that moves change the buttons beside it too; a finger or a gripper
covers the plate around as well. What a shift by one sample explains is no change: patches are never quite aligned.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from elevator_rectify.core.lamps.patches import MARGIN, SIDE, Patches
from elevator_rectify.core.types import Array, BoolArray

# Written by `calibrate --lamps`: how probable it is that what changed is a lamp.
COEFFICIENTS = Path(__file__).with_name("lamps.json")
# Grey values: darker pixels tell no ratio, brighter ones are overexposed.
_DARK, _OVEREXPOSED, _LEAST_KNOWN = 12.0, 250.0, 0.1
# A plane over the panel is fitted to the ratios where so many buttons have one.
_FEWEST_FOR_PLANE, _ROUNDS, _RATIO_NOISE = 6, 6, 0.01
# A lit character covers this share of a patch; grey values that the others' changes do not tell.
_LIT_SHARE, _NOISE = 0.06, 3.0
# A button that is so much brighter, and around it less than this share of that, looks as if its lamp went on.
_BRIGHTER, _SHARE_AROUND = 25.0, 0.3
# Beside fewer buttons nothing can be said; so many of them are the nearest.
FEWEST_OTHERS, _NEAREST = 3, 4
_BUTTON_HALF = 0.5 * SIDE / MARGIN


def _zone() -> BoolArray:
    """Return (n, n) which samples are beyond the button's edge."""
    off = np.abs(np.arange(SIDE) + 0.5 - 0.5 * SIDE)
    return np.asarray(np.maximum(off[:, None], off[None]) > 1.15 * _BUTTON_HALF)


_AROUND = _zone()


def features(before: Patches, after: Patches, k: int) -> Array | None:
    """Return what changed of button k of K between two lists of the same buttons, None where nothing can be said."""
    others = np.delete(np.arange(len(before.colour)), k)
    if len(others) < FEWEST_OTHERS or not (before.whole[k] and after.whole[k]):
        return None
    was, now = before.colour, _as_exposed_before(before, after)
    raw = _changes(was, now)
    middle = np.median(raw[others], axis=0)
    spread = 1.4826 * np.median(np.abs(raw[others] - middle), axis=0) + _NOISE
    near = others[np.argsort(np.linalg.norm(before.places[others] - before.places[k], axis=1))[:_NEAREST]]
    alike = [_correlation(was[k].mean(axis=-1)[zone], now[k].mean(axis=-1)[zone]) for zone in (_AROUND, ~_AROUND)]
    found = np.concatenate(
        [
            np.log1p(np.maximum(raw[k], 0.0)),
            np.arcsinh((raw[k] - middle) / spread),
            np.log1p(np.maximum(raw[near][:, :2].mean(axis=0), 0.0)),
            alike,
            [np.log(max(1.0, min(before.side_px[k], after.side_px[k])))],
        ]
    )
    return np.asarray(found)


def lit_share(before: Patches, after: Patches) -> float:
    """Return the share of the buttons that are brighter now, and not around them: most in a test of the lamps."""
    raw = _changes(before.colour, _as_exposed_before(before, after))
    return float(((raw[:, 0] > _BRIGHTER) & (raw[:, 3] < _SHARE_AROUND * raw[:, 0])).mean())


def _as_exposed_before(before: Patches, after: Patches) -> Array:
    """Return the patches (K, n, n, 3) after, with the exposure of those before."""
    return np.asarray(after.colour / exposure(before, after)[:, None, None, None])


def _changes(was: Array, now: Array) -> Array:
    """Return by how much each button (K, 6) is brighter, more colourful and darker, and around it brighter, darker and
    more colourful, in grey values."""
    return np.column_stack(
        [
            _top(_beyond(now.max(axis=-1), was.max(axis=-1)), ~_AROUND),
            _top(_beyond(np.ptp(now, axis=-1), np.ptp(was, axis=-1)), ~_AROUND),
            _top(_beyond(-now.max(axis=-1), -was.max(axis=-1)), ~_AROUND),
            _mean(_beyond(now.max(axis=-1), was.max(axis=-1)), _AROUND),
            _mean(_beyond(-now.max(axis=-1), -was.max(axis=-1)), _AROUND),
            _mean(_beyond(np.ptp(now, axis=-1), np.ptp(was, axis=-1)), _AROUND),
        ]
    )


def _beyond(now: Array, was: Array) -> Array:
    """Return by how much each sample of (K, n, n) is above all that lie beside it before."""
    spread = np.ones((3, 3), np.uint8)
    return np.asarray(now - np.array([cv2.dilate(patch, spread) for patch in was]))


def _top(change: Array, zone: BoolArray) -> Array:
    """Return of each patch (K, n, n) the mean of the largest changes in a zone, as many as a lit character covers."""
    inside = np.sort(change[:, zone], axis=1)
    return np.asarray(inside[:, -max(1, int(_LIT_SHARE * SIDE * SIDE)) :].mean(axis=1))


def _mean(change: Array, zone: BoolArray) -> Array:
    return np.asarray(np.maximum(change[:, zone], 0.0).mean(axis=1))


def _correlation(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    return float((a * b).sum() / (np.sqrt((a * a).sum() * (b * b).sum()) + len(a)))


def exposure(before: Patches, after: Patches) -> Array:
    """Return (K,) by how much all around each button is brighter: a plane in ln over the panel, robustly fitted."""
    was, now = (p.colour.max(axis=-1).reshape(len(p.colour), -1) for p in (before, after))
    known = (was > _DARK) & (now > _DARK) & (was < _OVEREXPOSED) & (now < _OVEREXPOSED)
    enough = known.mean(axis=1) > _LEAST_KNOWN
    if not enough.any():
        return np.ones(len(was))
    ratio = np.log(np.maximum(now, 1.0)) - np.log(np.maximum(was, 1.0))
    value = np.zeros(len(was))
    value[enough] = [np.median(r[k]) for r, k in zip(ratio[enough], known[enough], strict=True)]
    A = np.column_stack([np.ones(len(was)), before.places - before.places.mean(axis=0)])
    A = A if enough.sum() >= _FEWEST_FOR_PLANE else A[:, :1]
    weight, x = enough.astype(float), np.zeros(A.shape[1])
    for _ in range(_ROUNDS):
        x = np.linalg.lstsq(A * weight[:, None], value * weight, rcond=None)[0]
        off = np.abs(value - A @ x)
        scale = 1.4826 * float(np.median(off[enough])) + _RATIO_NOISE
        weight = enough / np.maximum(1.0, off / (1.5 * scale))
    return np.asarray(np.exp(A @ x))


@cache
def _coefficients() -> Array:
    return np.array(json.loads(COEFFICIENTS.read_text())["coefficients"], dtype=float)


def lamp_log_odds(found: Array) -> float:
    """Return the log odds that the lamp went on, by the features of what changed."""
    return float(expanded(found) @ _coefficients())


def expanded(found: Array) -> Array:
    """Return the features with their squares and a constant, as the coefficients take them."""
    return np.concatenate([[1.0], found, found**2])
