"""Fits the confidence's logistic model on generated scenes and writes core/confidence.json."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass

import numpy as np

from elevator_rectify.benchmark.negatives import KINDS
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.synthetic import RIGHT_CELLS, judged
from elevator_rectify.core.attempts import best_attempt
from elevator_rectify.core.confidence import COEFFICIENTS, FEATURES, expanded, features
from elevator_rectify.core.config import Config
from elevator_rectify.core.detections import usable_detections
from elevator_rectify.core.pipeline import sigma_px
from elevator_rectify.core.types import Array
from elevator_rectify.render.levels import LEVELS, random_scene
from elevator_rectify.render.scene import paper_camera

# Of standardised features, per hundred examples.
_RIDGE = 0.06
# Few pictures in a robot's life are as bad as the worst level.
_WEIGHTS = {"extreme": 0.5}
_CONFIG = Config()


@dataclass(frozen=True)
class Example:
    """Features of a fit, and whether it was right."""

    x: Array
    right: bool
    mahalanobis2: float
    weight: float


def example(task: tuple[str, int, int]) -> Example | None:
    """Return the example of one draw: (level or kind of negative, seed, number)."""
    kind, seed, number = task
    camera, scene = paper_camera(), None
    if kind in KINDS:
        points = KINDS[kind](np.random.default_rng([seed, number, 99]))
    else:
        scene = random_scene(LEVELS[kind], seed, number)
        points = scene.centres_px
    usable = usable_detections(points, camera, _CONFIG.input)
    if len(usable.index) < _CONFIG.input.min_detections:
        return None
    sigma = sigma_px(usable, camera, _CONFIG) / camera.focal_px
    best = best_attempt(usable, camera, sigma, _CONFIG)
    if best.fit is None or not np.isfinite(best.result.covariance).all():
        return None
    x = features(best.fit.best, best.fit.margin, sigma, best.result)
    if scene is None:
        return Example(x, False, float("nan"), _WEIGHTS.get(kind, 1.0))
    trial = judged(scene, best.result, 0.0)
    return Example(x, trial.right and trial.cells >= RIGHT_CELLS, trial.mahalanobis2, _WEIGHTS.get(kind, 1.0))


def logistic_regression(X: Array, y: Array, weights: Array, steps: int = 60) -> Array:
    """Return the ridge-regularised coefficients by Newton's method (iteratively reweighted least squares)."""
    beta = np.zeros(X.shape[1])
    ridge = _RIDGE * len(y) / 100.0
    for _ in range(steps):
        p = 1.0 / (1.0 + np.exp(-np.clip(X @ beta, -30, 30)))
        hessian = (X * (weights * p * (1 - p))[:, None]).T @ X + ridge * np.eye(X.shape[1])
        beta = beta + np.linalg.solve(hessian, X.T @ (weights * (y - p)) - ridge * beta)
    return beta


def main(arguments: list[str] | None = None) -> int:
    """Command line: regenerate the coefficients."""
    parser = argparse.ArgumentParser(prog="calibrate", description=__doc__)
    parser.add_argument("--trials", type=int, default=700, help="scenes a level, and draws a kind of negative")
    parser.add_argument("--seed", type=int, default=11)
    options = parser.parse_args(arguments)
    kinds = ["easy", "medium", "hard", "extreme", "gaps", *4 * ["wild"], *KINDS]
    tasks = [(kind, options.seed + k, n) for k, kind in enumerate(kinds) for n in range(options.trials)]
    found = [e for e in parallel(example, tasks, "calibrating") if e is not None]
    X, y = np.array([e.x for e in found]), np.array([float(e.right) for e in found])
    mean, std = X.mean(axis=0), X.std(axis=0)
    Z = expanded(X, mean, std)
    beta = logistic_regression(Z, y, np.array([e.weight for e in found]))
    d2 = np.array([e.mahalanobis2 for e in found if e.right])
    table = {
        "features": {n: [round(float(m), 5), round(float(d), 5)] for n, m, d in zip(FEATURES, mean, std, strict=True)},
        "coefficients": [round(float(b), 5) for b in beta],
    }
    COEFFICIENTS.write_text(json.dumps(table, indent=2) + "\n")
    p = 1.0 / (1.0 + np.exp(-Z @ beta))
    print(f"{len(y)} fits, {y.mean():.3f} right")
    for limit in (0.5, 0.8, 0.9, 0.95, 0.98):
        right, wrong = np.mean(p[y == 1] > limit), np.mean(p[y == 0] > limit)
        print(f"above {limit}: {right:.3f} of the right, {wrong:.4f} of the wrong")
    print(f"rotation: mean d2 / 3 = {np.mean(np.minimum(d2, 30)) / 3:.3f}, inside 95 %: {np.mean(d2 < 7.815):.3f}")
    print(f"wrote {COEFFICIENTS}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
