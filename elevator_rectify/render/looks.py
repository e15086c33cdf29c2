"""Random looks of panels and random ways of taking a picture: some to develop with, others held out to judge by."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from elevator_rectify.render.panel import Look, Panel
from elevator_rectify.render.photograph import Taking

# Plate, face, rim, ink (BGR), brushed.
_MATERIALS = (
    ((176, 178, 180), (196, 200, 204), (92, 94, 96), (30, 30, 34), True),
    ((34, 34, 36), (58, 58, 60), (150, 150, 150), (235, 235, 235), False),
    ((96, 150, 178), (120, 178, 205), (50, 84, 104), (30, 30, 34), True),
    ((150, 150, 148), (232, 234, 236), (110, 110, 110), (40, 40, 160), False),
    ((130, 128, 126), (60, 58, 56), (200, 200, 200), (240, 240, 240), True),
    ((200, 204, 206), (214, 216, 218), (150, 152, 154), (20, 20, 20), True),
)
_HELD_OUT_MATERIALS = (
    ((60, 84, 120), (90, 150, 190), (40, 40, 44), (20, 24, 30), True),
    ((190, 188, 186), (40, 38, 36), (220, 222, 224), (250, 250, 250), True),
    ((28, 26, 24), (180, 182, 184), (70, 70, 70), (20, 20, 20), False),
    ((206, 210, 212), (198, 202, 206), (120, 122, 126), (50, 50, 52), True),
    ((110, 120, 96), (170, 176, 160), (60, 64, 56), (20, 20, 60), False),
)
_FONTS = (cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX)
_HELD_OUT_FONTS = (cv2.FONT_HERSHEY_COMPLEX, cv2.FONT_HERSHEY_TRIPLEX, cv2.FONT_HERSHEY_SCRIPT_SIMPLEX)
_SHAPES = (("round", 1.0, 1.0), ("round", 1.0, 1.0), ("square", 1.0, 0.25), ("square", 1.0, 0.1))
_HELD_OUT_SHAPES = (
    ("round", 1.0, 1.0),
    ("round", 1.0, 1.0),
    ("square", 1.0, 0.5),
    ("rectangle", 1.25, 0.2),
    ("octagon", 1.0, 1.0),
    ("pill", 1.3, 1.0),
)
_LIT_SHARE = 0.1
SCATTER_SHARE = 0.003
_HIGHEST_SHARE = 0.09


def random_look(rng: np.random.Generator, held_out: bool = False) -> Look:
    """Draw a look; the held-out ones have materials, fonts and shapes of their own."""
    materials = _HELD_OUT_MATERIALS if held_out else _MATERIALS
    plate, face, rim, ink, brushed = materials[rng.integers(len(materials))]
    shapes = _HELD_OUT_SHAPES if held_out else _SHAPES
    shape, aspect, corner = shapes[rng.integers(len(shapes))]
    fonts = _HELD_OUT_FONTS if held_out else _FONTS
    return Look(
        shape=shape,
        button_share=float(rng.uniform(0.5, 0.72)),
        aspect=aspect,
        corner_share=corner,
        ring_share=float(rng.choice([0.0, rng.uniform(0.05, 0.2)])),
        height_share=float(rng.choice([0.0, rng.uniform(0.0, _HIGHEST_SHARE)])),
        bevel=float(rng.uniform(0.0, 0.15)),
        engraved=bool(rng.random() < 0.3),
        label_beside=bool(rng.random() < 0.2),
        braille=bool(rng.random() < 0.3),
        font=int(fonts[rng.integers(len(fonts))]),
        gloss=float(rng.choice([0.0, rng.uniform(0.05, 0.25)])),
        plate=plate,
        face=face,
        rim=rim,
        ink=ink,
        brushed=brushed,
    )


def dressed(panel: Panel, rng: np.random.Generator, held_out: bool = False, scatter: float = SCATTER_SHARE) -> Panel:
    """Return the panel with a random look, some lamps lit, and its buttons placed as they are manufactured.

    scatter: standard deviation of the places, in column pitches.
    """
    look = random_look(rng, held_out)
    lit = frozenset(int(k) for k in np.flatnonzero(rng.random(len(panel.buttons)) < _LIT_SHARE))
    offsets = rng.normal(0.0, scatter * panel.pitch_m[0], (len(panel.buttons), 2))
    return replace(panel, look=look, lit=lit, offsets_m=tuple((float(x), float(y)) for x, y in offsets))


def random_taking(rng: np.random.Generator) -> Taking:
    """Draw how the picture is taken: from good to bad, as a robot's camera does."""
    return Taking(
        focus_px=float(rng.uniform(0.4, 1.1)),
        motion_px=float(rng.choice([0.0, rng.uniform(0.0, 3.0)])),
        noise=float(rng.uniform(0.8, 4.0)),
        jpeg=int(rng.choice([0, int(rng.integers(60, 95))])),
        reflection=float(rng.uniform(0.0, 60.0)),
        shadow=float(rng.choice([0.0, rng.uniform(0.1, 0.5)])),
        gain=float(rng.uniform(0.6, 1.1)),
    )
