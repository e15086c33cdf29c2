"""Fits what says that a lamp went on, on pictures of real panels that nothing is judged by."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from elevator_rectify.benchmark.end_to_end import judgeable
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.presses import presses
from elevator_rectify.calibrate.logistic import logistic_regression
from elevator_rectify.core.lamps.change import COEFFICIENTS, expanded
from elevator_rectify.core.lamps.watch import changed
from elevator_rectify.core.types import Array
from elevator_rectify.train.labelled import read_labelled

# Of every second panel one press of each kind: there are more frames than the coefficients need.
_EVERY, _PRESSES, _RIDGE = 2, 1, 1.0


def examples(task: tuple[str, str]) -> list[tuple[Array, bool]]:
    """Return features and truth of single frames of one picture: (folder, name)."""
    found = []
    for press in presses(*task, number=_PRESSES, frames=1, seed=1):
        changes = [changed(before, now, press.label) for before in press.before for now in press.after if now]
        found += [(x, press.lit) for x in changes if not isinstance(x, str)]
    return found


def calibrate_lamps(folder: Path) -> None:
    """Fit the logistic and write it beside the features."""
    names = [p.name for p in read_labelled(folder, validation=False) if judgeable(p)][::_EVERY]
    found = [e for several in parallel(examples, [(str(folder), n) for n in names], "lamps") for e in several]
    X, lit = np.array([expanded(x) for x, _ in found]), np.array([float(y) for _, y in found])
    middle, spread = X.mean(axis=0), X.std(axis=0)
    middle[0], spread[0] = 0.0, 1.0
    beta = logistic_regression((X - middle) / spread, lit, np.ones(len(lit)), _RIDGE) / spread
    beta[0] -= middle @ beta
    COEFFICIENTS.write_text(json.dumps({"coefficients": [round(float(b), 5) for b in beta]}) + "\n")
    print(f"{len(lit)} frames, {lit.mean():.2f} lit: written to {COEFFICIENTS.name}")
