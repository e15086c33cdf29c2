"""The rigid motion that carries the fitted grid's plane onto the detections, by Levenberg-Marquardt.

Minimises 1/2 sum w_n |x_n - pi(R u_n + t)|^2 over R, t, for reference points u_n = (u, v, 1) in the normalised plane.

Zhu et al., arXiv 1912.11774, section III-C; numbers of errata in the comments.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elevator_rectify.core.config import MotionConfig
from elevator_rectify.core.geometry.rotations import rotation
from elevator_rectify.core.types import Array


@dataclass(frozen=True)
class Motion:
    """Rotation R (3, 3), translation t (3,), the cost 1/2 sum w |e|^2 reached, and how."""

    R: Array
    t: Array
    cost: float = 0.0
    iterations: int = 0
    converged: bool = True

    @property
    def plane_map(self) -> Array:
        """Return H = R + t e3' (3, 3), which maps the plane z = 1."""
        H = self.R.copy()
        H[:, 2] += self.t
        return H


# Erratum 7: the printed start (theta = -1, -1, -1; t = .1, .1, .1) is far from any camera's view; zero motion is not.
def printed_start() -> Motion:
    """Return the paper's initial motion as published."""
    return Motion(rotation(np.array([-1.0, -1.0, -1.0])), np.full(3, 0.1))


def no_motion() -> Motion:
    """Return the identity."""
    return Motion(np.eye(3), np.zeros(3))


def transform(H: Array, points: Array) -> Array:
    """Apply the homography H (3, 3) to points (N, 2)."""
    mapped = points @ H[:, :2].T + H[:, 2]
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def jacobian(points: Array, depth: Array, printed: bool = False) -> Array:
    """Return d(x, y)/d(theta, t) (N, 2, 6) at projected points (N, 2) of the given depths (N,).

    Erratum 2: it belongs to a left perturbation of the whole point, R <- exp(theta) R, t <- exp(theta) t + dt.
    Erratum 1: the second row begins with -(1 + y^2), published as 1 + y (kept by `printed`).
    """
    x, y = points.T
    zero, inverse = np.zeros_like(x), 1.0 / depth
    lead = 1.0 + y if printed else 1.0 + y * y
    first = np.stack([-x * y, 1.0 + x * x, -y, inverse, zero, -x * inverse], axis=-1)
    second = np.stack([-lead, x * y, x, zero, inverse, -y * inverse], axis=-1)
    return np.stack([first, second], axis=1)


def _residuals(references: Array, observed: Array, R: Array, t: Array) -> tuple[Array, Array, Array]:
    points = references @ R[:, :2].T + R[:, 2] + t
    depth = np.where(np.abs(points[:, 2]) > 1e-9, points[:, 2], 1e-9)
    projected = points[:, :2] / depth[:, None]
    return observed - projected, projected, depth


def estimate_motion(
    references: Array, observed: Array, weights: Array, start: Motion, config: MotionConfig, printed: bool = False
) -> Motion:
    """Return the motion of the plane z = 1 that best maps references (N, 2) onto observed (N, 2), normalised."""
    R, t, damping, converged, steps = start.R, start.t, 1e-3, False, 0
    error, projected, depth = _residuals(references, observed, R, t)
    cost = 0.5 * float(weights @ (error**2).sum(axis=1))
    for steps in range(1, config.max_iterations + 1):  # noqa: B007 - reported
        J = jacobian(projected, depth, printed)
        normal = np.einsum("n,nij,nik->jk", weights, J, J)
        gradient = np.einsum("n,nij,ni->j", weights, J, error)
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), gradient)
        turn = rotation(step[:3])
        trial_R, trial_t = turn @ R, turn @ t + step[3:]
        trial = _residuals(references, observed, trial_R, trial_t)
        trial_cost = 0.5 * float(weights @ (trial[0] ** 2).sum(axis=1))
        if trial[2].min() <= 0.0 < depth.min():
            # Behind the camera lies a mirror solution of the same cost.
            trial_cost = np.inf
        converged = bool(step @ step < config.tolerance)
        if trial_cost <= cost:
            R, t, cost, damping = trial_R, trial_t, trial_cost, max(damping * 0.1, 1e-12)
            error, projected, depth = trial
        else:
            damping *= 10.0
        if converged or damping > 1e12:
            break
    return Motion(R, t, cost, steps, converged)
