"""Presses on pictures of real panels: frames before, and frames after of a lamp that went on, or of something else.

Nobody pressed these buttons: lamps and fingers are painted into the pictures (`render.overpaint`), and every frame is
taken anew, with another pose, exposure, light and noise.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from elevator_rectify.benchmark.detector import boxes_of
from elevator_rectify.benchmark.end_to_end import CONFIG, first_accepted, true_detections
from elevator_rectify.core import Camera, Detection, fit_panel
from elevator_rectify.core.lamps.patches import Patches, patches_of
from elevator_rectify.core.lamps.watch import REFERENCES
from elevator_rectify.core.reading.labels import canonical
from elevator_rectify.core.types import Array, Image
from elevator_rectify.render.overpaint import taken_again, with_finger, with_lamp
from elevator_rectify.train.labelled import read_labelled

# What happens: the lamp goes on; it does while a finger is near; nothing; another lamp goes on; a finger lies on it.
LIT, DARK = ("lit", "lit, finger near"), ("nothing", "another lit", "finger on it")
KINDS = LIT + DARK
# Boxes are so much off, over their size; a button under a finger is detected by this share.
_BOX_NOISE, _DETECTED_COVERED = 0.05, 0.6


@dataclass(frozen=True)
class Press:
    """What happened, the label of the button, how its panel looked before, and after it (None: no panel)."""

    kind: str
    label: str
    before: tuple[Patches, ...]
    after: tuple[Patches | None, ...]

    @property
    def lit(self) -> bool:
        """Tell whether the lamp of the button went on."""
        return self.kind in LIT


@dataclass(frozen=True)
class _Panel:
    image: Image
    camera: Camera
    truth: list[Detection]


def presses(folder: str, name: str, number: int, frames: int, seed: int = 0, dark: int = 0) -> Iterator[Press]:
    """Yield `number` presses of every kind on one picture, without a lamp `dark` if that is more.

    frames: after each. None where the picture is refused.
    """
    (picture,) = read_labelled(Path(folder), names=(name,))
    truth = true_detections(picture)
    accepted = first_accepted(picture, truth)
    counts = Counter(canonical(d.label) for d in truth if d.label)
    single = [k for k, d in enumerate(truth) if d.label and counts[canonical(d.label)] == 1]
    if accepted is None or not single:
        return
    rng, panel = np.random.default_rng([int(name), seed]), _Panel(picture.image, accepted[1], truth)
    for k in range(max(number, dark)):
        chosen = int(rng.choice(single))
        before = [_frame(panel, panel.image, rng) for _ in range(REFERENCES)]
        label = canonical(truth[chosen].label)
        known = tuple(p for p in before if p is not None and label in p.labels)
        kinds = KINDS if k < number else DARK
        for kind in kinds if len(known) == REFERENCES else ():
            scene = _happened(panel, kind, chosen, rng)
            hidden = kind == "finger on it" and rng.random() > _DETECTED_COVERED
            after = [_frame(panel, scene, rng, chosen if hidden else -1) for _ in range(frames)]
            yield Press(kind, label, known, tuple(after))


def _happened(panel: _Panel, kind: str, chosen: int, rng: np.random.Generator) -> Image:
    """Return the picture of the panel after it."""
    boxes = boxes_of(panel.truth)
    box, others = boxes[chosen], np.delete(boxes, chosen, axis=0)
    if kind == "another lit":
        return with_lamp(panel.image, others[rng.integers(len(others))], rng)
    if kind == "finger on it":
        return with_finger(panel.image, box, rng)
    if kind == "nothing":
        return panel.image
    lit = with_lamp(panel.image, box, rng)
    return with_finger(lit, box, rng, float(rng.uniform(1.2, 2.5))) if kind == "lit, finger near" else lit


def _frame(panel: _Panel, scene: Image, rng: np.random.Generator, hidden: int = -1) -> Patches | None:
    """Take the scene once more and fit the panel; hidden: button that the detector does not find."""
    image, H = taken_again(scene, rng)
    found = [d for k, d in enumerate(_moved(panel.truth, H, rng)) if k != hidden]
    fit = fit_panel(found, panel.camera, CONFIG, image=image)
    return patches_of(image, panel.camera, fit, fit.buttons) if fit.ok else None


def _moved(truth: list[Detection], H: Array, rng: np.random.Generator) -> list[Detection]:
    """Return the detections where the frame shows them, a little off."""
    centres = np.array([[[d.x_px + 0.5, d.y_px + 0.5]] for d in truth])
    now = cv2.perspectiveTransform(centres, H)[:, 0] - 0.5
    now += rng.normal(0, _BOX_NOISE, now.shape) * np.array([[d.width_px, d.height_px] for d in truth])
    return [replace(d, x_px=float(x), y_px=float(y)) for d, (x, y) in zip(truth, now, strict=True)]
