"""Examples of lit and dark lamps to train on, and how probable it is what the network says."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from elevator_rectify.benchmark.detector import boxes_of
from elevator_rectify.benchmark.end_to_end import CONFIG, first_accepted, true_detections
from elevator_rectify.benchmark.lit import Told, marked_names, told, truth_of
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.reader import calibration_error
from elevator_rectify.calibrate.logistic import logistic_regression
from elevator_rectify.core import Camera, GridFit, fit_panel
from elevator_rectify.core.lamps.lit import CALIBRATION, COLOURED, FEWEST, beside_others
from elevator_rectify.core.lamps.patches import patches_of
from elevator_rectify.core.types import Array, BoolArray, Image
from elevator_rectify.render.overpaint import with_lamp
from elevator_rectify.train.labelled import read_labelled
from elevator_rectify.train.lit_marks import Marks, read_marks

EXAMPLES = Path("lit_examples.npz")
# Of every marked picture so many more with painted lamps; in this share of them two are painted.
_PAINTED, _TWO = 4, 0.3
_RIDGE = 0.01
# A lamp is lit from this probability on, and dark up to that one.
_YES, _NO = 0.9, 0.02


@dataclass(frozen=True)
class Examples:
    """Buttons beside others (N, 9, n, n) uint8, whether each is lit (N,); painted: on a picture with painted lamps."""

    seen: Image
    lit: BoolArray
    painted: bool


def examples(task: tuple[str, str]) -> list[Examples]:
    """Return the examples of one picture, as it is and with painted lamps: (folder, name)."""
    (picture,) = read_labelled(Path(task[0]), names=(task[1],))
    truth, marks = true_detections(picture), read_marks()[task[1]]
    accepted = first_accepted(picture, truth)
    if accepted is None:
        return []
    camera, rng, boxes = accepted[1], np.random.default_rng([int(task[1]), 7]), boxes_of(truth)
    found = [_seen(picture.image, *accepted, marks, painted=False)]
    for _ in range(_PAINTED):
        chosen = rng.choice(len(truth), 1 + int(rng.random() < _TWO), replace=False)
        image = picture.image
        for k in chosen:
            image = with_lamp(image, boxes[k], rng)
        fit, lamps = fit_panel(truth, camera, CONFIG, image=image), frozenset(map(int, chosen))
        if fit.ok:
            found.append(_seen(image, fit, camera, Marks(marks.lit | lamps, marks.unsure - lamps), painted=True))
    return found


def _seen(image: Image, fit: GridFit, camera: Camera, marks: Marks, painted: bool) -> Examples:
    patches, truth = patches_of(image, camera, fit, fit.buttons), truth_of(fit, marks)
    known = patches.whole.astype(bool) & (truth >= 0) & (len(truth) >= FEWEST)
    return Examples(beside_others(patches)[known].round().astype(np.uint8), truth[known] > 0, painted)


def write_examples(folder: Path) -> None:
    """Write the examples of the marked pictures of the training part, for `train.lit`."""
    several = parallel(examples, [(str(folder), name) for name in marked_names(False)], "examples")
    found = [e for panel in several for e in panel]
    painted = np.concatenate([np.full(len(e.lit), e.painted) for e in found])
    lit = np.concatenate([e.lit for e in found])
    np.savez_compressed(EXAMPLES, seen=np.concatenate([e.seen for e in found]), lit=lit, painted=painted)
    print(f"{len(lit)} buttons, {lit[~painted].sum()} of {(~painted).sum()} lit as they are: {EXAMPLES}")


def calibrate_lit(folder: Path) -> None:
    """Fit slope and offset of the network's log odds on the pictures that it was not trained on, judged by halves."""
    several = parallel(told, [(str(folder), name) for name in marked_names(True)], "lit")
    found = [(_features(t), t.lit) for t in several if t is not None]
    for fitted, judged in ((found[::2], found[1::2]), (found[1::2], found[::2])):
        X, lit = (np.concatenate(part) for part in zip(*judged, strict=True))
        seen = np.isfinite(X).all(axis=1)
        p = 1.0 / (1.0 + np.exp(-X[seen] @ _fitted(fitted)))
        error, lit = calibration_error(p, lit[seen].astype(float)), lit[seen]
        yes, no = lit[p >= _YES], ~lit[p <= _NO]
        print(
            f"other half: calibration error {error:.3f}, right of {len(yes)} yes {yes.mean():.3f}, of {len(no)} no "
            f"{no.mean():.3f}"
        )
    slope, offset, coloured = (round(float(b), 4) for b in _fitted(found))
    known = {"slope": slope, "offset": offset, "coloured": coloured, "yes": _YES, "no": _NO}
    CALIBRATION.write_text(json.dumps(known) + "\n")
    print(f"{CALIBRATION.name}: {CALIBRATION.read_text().strip()}")


def _features(told: Told) -> Array:
    return np.column_stack([told.odds, np.ones(len(told.odds)), [label in COLOURED for label in told.labels]])


def _fitted(found: list[tuple[Array, BoolArray]]) -> Array:
    X, lit = (np.concatenate(part) for part in zip(*found, strict=True))
    seen = np.isfinite(X).all(axis=1)
    return logistic_regression(X[seen], lit[seen].astype(float), np.ones(int(seen.sum())), _RIDGE)
