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
from elevator_rectify.core.confidence import COEFFICIENTS, FEATURES, features
from elevator_rectify.core.config import Config, with_values
from elevator_rectify.core.joint import fit_joint
from elevator_rectify.core.pipeline import fit_panel
from elevator_rectify.core.types import Array
from elevator_rectify.render.levels import LEVELS, random_scene
from elevator_rectify.render.scene import paper_camera

_RIDGE = 0.02
_ANYTHING = with_values(Config(), {"accept.min_confidence": 0.0})


@dataclass(frozen=True)
class Example:
    """Features of a fit, and whether it was right."""

    x: Array
    right: bool
    mahalanobis2: float


def example(task: tuple[str, int, int]) -> Example | None:
    """Return the example of one draw: (level or kind of negative, seed, number)."""
    kind, seed, number = task
    camera = paper_camera()
    if kind in KINDS:
        points = KINDS[kind](np.random.default_rng([seed, number, 99]))
        right, d2 = False, float("nan")
        fit = fit_panel(points, camera, _ANYTHING)
    else:
        scene = random_scene(LEVELS[kind], seed, number)
        points, fit = scene.centres_px, fit_panel(scene.centres_px, camera, _ANYTHING)
        trial = judged(scene, fit, LEVELS[kind].sigma_px, 0.0)
        right, d2 = trial.right and trial.cells >= RIGHT_CELLS, trial.mahalanobis2
    if not np.isfinite(fit.R_camera_panel).all():
        return None
    sigma, area = _ANYTHING.noise.sigma_px / camera.focal_px, camera.width * camera.height / camera.focal_px**2
    order = np.lexsort((points[:, 1], points[:, 0]))
    joint = fit_joint(camera.rays(points[order]), sigma, area, _ANYTHING)
    return Example(features(joint.best, joint.margin, sigma, fit), right, d2) if joint else None


def logistic_regression(X: Array, y: Array, steps: int = 60) -> Array:
    """Return the ridge-regularised coefficients by Newton's method (iteratively reweighted least squares)."""
    beta = np.zeros(X.shape[1])
    for _ in range(steps):
        p = 1.0 / (1.0 + np.exp(-np.clip(X @ beta, -30, 30)))
        hessian = (X * (p * (1 - p))[:, None]).T @ X + _RIDGE * len(y) / 100.0 * np.eye(X.shape[1])
        beta = beta + np.linalg.solve(hessian, X.T @ (y - p) - _RIDGE * len(y) / 100.0 * beta)
    return beta


def main(arguments: list[str] | None = None) -> int:
    """Command line: regenerate the coefficients."""
    parser = argparse.ArgumentParser(prog="calibrate", description=__doc__)
    parser.add_argument("--trials", type=int, default=700, help="scenes a level, and draws a kind of negative")
    parser.add_argument("--seed", type=int, default=11)
    options = parser.parse_args(arguments)
    kinds = ["easy", "medium", "hard", "extreme", "gaps", *KINDS]
    tasks = [(kind, options.seed, n) for kind in kinds for n in range(options.trials)]
    examples = [e for e in parallel(example, tasks, "calibrating") if e is not None]
    X, y = np.array([e.x for e in examples]), np.array([float(e.right) for e in examples])
    beta = logistic_regression(X, y)
    d2 = np.array([e.mahalanobis2 for e in examples if e.right])
    table = {"coefficients": {name: round(float(b), 5) for name, b in zip(FEATURES, beta, strict=True)}}
    COEFFICIENTS.write_text(json.dumps(table, indent=2) + "\n")
    p = 1.0 / (1.0 + np.exp(-X @ beta))
    print(f"{len(y)} fits, {y.mean():.3f} right")
    for limit in (0.5, 0.8, 0.9, 0.95, 0.98):
        right, wrong = np.mean(p[y == 1] > limit), np.mean(p[y == 0] > limit)
        print(f"above {limit}: {right:.3f} of the right, {wrong:.4f} of the wrong")
    print(f"rotation: mean d2 / 3 = {np.mean(np.minimum(d2, 30)) / 3:.3f}, inside 95 %: {np.mean(d2 < 7.815):.3f}")
    print(f"wrote {COEFFICIENTS}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
