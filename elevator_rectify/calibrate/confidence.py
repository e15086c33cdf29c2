"""Fits the confidence's logistic models on generated scenes and writes core/confidence.json, with --pictures
core/picture/confidence.json, with --outlines core/outline/confidence.json."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from elevator_rectify.benchmark.negatives import KINDS, boxed
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.parts_of_panels import as_stated
from elevator_rectify.benchmark.pictures import SPOILT, Pictured, few_pictured, pictured
from elevator_rectify.benchmark.synthetic import CHI2_3, RIGHT_CELLS, judged
from elevator_rectify.calibrate import filled, lamps, lit, networks
from elevator_rectify.calibrate.logistic import logistic_regression
from elevator_rectify.calibrate.real_pictures import names_of, real_examples, searched
from elevator_rectify.core import confidence
from elevator_rectify.core.attempts import best_attempt
from elevator_rectify.core.confidence import expanded, features
from elevator_rectify.core.config import Config
from elevator_rectify.core.detections import Usable
from elevator_rectify.core.outline import pose as outline_pose
from elevator_rectify.core.outline import result as outline_result
from elevator_rectify.core.picture import fit as picture_fit
from elevator_rectify.core.picture.straight_edges import Photo
from elevator_rectify.core.pipeline import admitted
from elevator_rectify.core.types import Array, Detection
from elevator_rectify.render.levels import LEVELS, random_scene
from elevator_rectify.render.scene import Scene, paper_camera

# Of standardised features, an example; real panels are few, and alike among themselves.
_RIDGE, _REAL_RIDGE = 0.0006, 0.005
# Few pictures in a robot's life are as bad as the worst level.
_WEIGHTS = {"extreme": 0.5}
_LEVELS = ("easy", "medium", "hard", "extreme", "gaps", *4 * ["wild"])
_PICTURE_LEVELS = ("easy", "medium", "hard", "hard", "hard", "gaps", *5 * ["wild"], "swapped")
# Pictures spoilt in these ways, of panels of the level hard.
_SPOILT = ("blurred", "noisy", "hand", "overexposed", "shifted")
# With pictures, a rotation further off than this, and than its covariance says, is wrong.
_RIGHT_DEG = 2.0
_RIGHT_OUTLINE_DEG = 4.0
_FEW = tuple(f"{shape} {number}" for shape in ("round", "square") for number in range(1, 6))
_CONFIG = Config()
# What else is refitted on labelled pictures, by argument.
_REFITTED: dict[str, tuple[Callable[[Path], None], str]] = {
    "detector": (networks.calibrate_detector, "the scores of our own detector"),
    "reader": (networks.calibrate_reader, "the scores of our own reader"),
    "lamps": (lamps.calibrate_lamps, "that a lamp went on"),
    "lit-examples": (lit.write_examples, "write lit_examples.npz, which train.lit learns from"),
    "lit": (lit.calibrate_lit, "that a lamp is lit"),
}


@dataclass(frozen=True)
class Example:
    """Features of a fit, and whether it was right; squared length of the rotation's error in its own covariance."""

    x: Array
    right: bool
    mahalanobis2: float
    weight: float


def examples(task: tuple[str, int, int]) -> list[Example]:
    """Return the example of one draw: (level or kind of negative, seed, number)."""
    kind, seed, number = task
    camera, scene = paper_camera(), None
    detections: Array | Sequence[Detection]
    if kind in KINDS:
        rng = np.random.default_rng([seed, number, 99])
        detections = boxed(KINDS[kind](rng), rng)
    else:
        scene = random_scene(LEVELS[kind], seed, number)
        detections = scene.detections
    # Every second one as a detector that says no sizes gives it.
    detections = detections if number % 2 else np.array([[d.x_px, d.y_px] for d in detections])
    usable, sigma, refused = admitted(detections, camera, _CONFIG)
    if refused is not None:
        return []
    best = best_attempt(usable, camera, sigma, _CONFIG)
    if best.fit is None or not np.isfinite(best.result.covariance).all():
        return []
    x = features(best.fit.best, best.fit.margin, sigma, best.result, usable, camera)
    weight = _WEIGHTS.get(kind, 1.0)
    if scene is None:
        return [Example(x, False, float("nan"), weight)]
    trial = judged(scene, best.result, 0.0)
    return [Example(x, trial.right and trial.cells >= RIGHT_CELLS, trial.mahalanobis2, weight)]


def picture_examples(task: tuple[str, int, int]) -> list[Example]:
    """Return the examples of one picture: every search's fit, right or wrong.

    'swapped' shows the detections of one scene in the picture of another; negatives are shown in any picture; others
    are spoilt pictures.
    """
    kind, seed, number = task
    given = pictured(kind if kind in LEVELS else "hard" if kind in _SPOILT else "medium", seed, number)
    if kind in _SPOILT:
        given = replace(given, image=SPOILT[kind](given.image, np.random.default_rng([seed, number])))
    scene: Scene | None = given.scene
    detections: Sequence[Detection] = given.scene.detections
    if kind == "swapped":
        scene = pictured("medium", seed, number + 1_000_000, picture=False).scene
        detections = scene.detections
    elif kind in KINDS:
        points, size = KINDS[kind](np.random.default_rng([seed, number, 99])), given.scene.detections[0].width_px
        scene, detections = None, [Detection(float(x), float(y), size, size) for x, y in points]
    usable, sigma, refused = admitted(detections, given.scene.camera, _CONFIG)
    return [] if refused is not None else _searched(given, scene, usable, sigma, _WEIGHTS.get(kind, 1.0))


def _searched(given: Pictured, scene: Scene | None, usable: Usable, sigma: float, weight: float) -> list[Example]:
    """Return an example of every search that finds a fit, and another pose of it."""
    found = []
    for attempt, fit in searched(usable, sigma, Photo(given.image, given.scene.camera)):
        x = picture_fit.picture_features(fit, attempt.result, usable, sigma, given.scene.camera)
        right, d2 = False, float("nan")
        if scene is not None:
            trial = judged(scene, fit.result, 0.0)
            right = trial.cells >= RIGHT_CELLS and as_stated(trial.error_deg, fit.result.covariance, _RIGHT_DEG)
            d2 = trial.mahalanobis2
        found.append(Example(x, right, d2, weight))
        if right and attempt.result.ok:
            break
    return [Example(e.x, e.right, e.mahalanobis2, e.weight / len(found)) for e in found]


def outline_examples(task: tuple[str, int, int]) -> list[Example]:
    """Return the example of a panel of few buttons: ('round 2', seed, number)."""
    kind, seed, number = task
    shape, buttons = kind.split()
    scene, image = few_pictured(shape, int(buttons), seed, number)
    boxes = np.array([[d.x_px, d.y_px, d.width_px, d.height_px] for d in scene.detections])
    found = outline_pose.fit_few(boxes, image, scene.camera, _CONFIG)
    if found is None:
        return []
    error = np.arccos(np.clip(found.best.model.R[:, 2] @ scene.R_camera_panel[:, 2], -1.0, 1.0))
    right = bool(np.rad2deg(error) <= _RIGHT_OUTLINE_DEG)
    return [Example(outline_result.few_features(found), right, float("nan"), 1.0)]


def real_panels(folder: Path, with_picture: bool, weight: float) -> list[Example]:
    """Return the examples of the labelled pictures that nothing is judged by, of this weight together."""
    tasks = [(str(folder), name) for name in names_of(folder)]
    several = [e for panel in parallel(real_examples, tasks, "real panels") for e in panel]
    chosen = [e for e in several if e.with_picture == with_picture]
    return [Example(e.x, e.right, float("nan"), weight / len(chosen)) for e in chosen]


def write_model(found: list[Example], names: tuple[str, ...], path: Path, ridge: float = _RIDGE) -> None:
    """Fit the model, write it, print how well it tells right from wrong."""
    X, y = np.array([e.x for e in found]), np.array([float(e.right) for e in found])
    mean, std = X.mean(axis=0), np.maximum(X.std(axis=0), 1e-6)
    Z = expanded(X, mean, std)
    weight = np.array([e.weight for e in found])
    beta = logistic_regression(Z, y, weight, ridge * float(weight.sum()))
    table = {
        "features": {n: [round(float(m), 5), round(float(d), 6)] for n, m, d in zip(names, mean, std, strict=True)},
        "coefficients": [round(float(b), 5) for b in beta],
    }
    path.write_text(json.dumps(table, indent=2) + "\n")
    p = 1.0 / (1.0 + np.exp(-Z @ beta))
    print(f"{len(y)} fits, {y.mean():.3f} right")
    for limit in (0.5, 0.8, 0.9, 0.95, 0.98):
        right, wrong = np.mean(p[y == 1] > limit), np.mean(p[y == 0] > limit)
        print(f"above {limit}: {right:.3f} of the right, {wrong:.4f} of the wrong")
    d2 = np.array([e.mahalanobis2 for e in found if e.right and np.isfinite(e.mahalanobis2)])
    print(f"rotation: mean d2 / 3 = {np.mean(np.minimum(d2, 30)) / 3:.3f}, inside 95 %: {np.mean(d2 < CHI2_3):.3f}")
    print(f"wrote {path}")


def main(arguments: list[str] | None = None) -> int:
    """Command line: regenerate the coefficients."""
    parser = argparse.ArgumentParser(prog="calibrate", description=__doc__)
    parser.add_argument("--pictures", action="store_true", help="the confidence of fits to pictures")
    parser.add_argument(
        "--trials", type=int, default=0, help="scenes a level; by default 700, with pictures or outlines 200"
    )
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--outlines", action="store_true", help="the confidence of fits to the outlines of few buttons")
    parser.add_argument("--buttons", action="store_true", help="which empty cells hold a missed button (real panels)")
    for name, (_, what) in _REFITTED.items():
        parser.add_argument(f"--{name}", type=Path, metavar="LABELLED", help=what)
    parser.add_argument("--data", type=Path, default=Path("data"), help="folder of real panels, with --buttons")
    parser.add_argument("--labelled", type=Path, help="real pictures: their fits count as much as the rendered ones'")
    options = parser.parse_args(arguments)
    given = {name: getattr(options, name.replace("-", "_")) for name in _REFITTED}
    given = {name: folder for name, folder in given.items() if folder is not None}
    for name, folder in given.items():
        _REFITTED[name][0](folder)
    if given:
        return 0
    if options.buttons:
        return filled.main(options.data, options.seed)
    function, kinds, usual = examples, (*_LEVELS, *KINDS), 700
    names: tuple[str, ...] = confidence.FEATURES
    path = confidence.COEFFICIENTS
    if options.pictures:
        function, kinds, usual = picture_examples, (*_PICTURE_LEVELS, *_SPOILT, *KINDS), 200
        names, path = picture_fit.FEATURES, picture_fit.COEFFICIENTS
    if options.outlines:
        function, kinds, usual = outline_examples, _FEW, 200
        names, path = outline_result.FEATURES, outline_result.COEFFICIENTS
    tasks = [(kind, options.seed + k, n) for k, kind in enumerate(kinds) for n in range(options.trials or usual)]
    found = [e for several in parallel(function, tasks, "calibrating") for e in several]
    if options.labelled is None or options.outlines:
        write_model(found, names, path)
        return 0
    found += real_panels(options.labelled, options.pictures, sum(e.weight for e in found))
    write_model(found, names, path, _REAL_RIDGE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
