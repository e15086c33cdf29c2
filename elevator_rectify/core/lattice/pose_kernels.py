"""The inner loops of one pose and of many, for numba: each does what the NumPy function does that it is named after.

Without numba they serve the tests only, which compare them with that.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from elevator_rectify.core.compiled import compiled
from elevator_rectify.core.config import JointConfig
from elevator_rectify.core.types import Array


@lru_cache(maxsize=64)
def settings(config: JointConfig) -> Array:
    """Return what the kernels need of the configuration."""
    of_aspect, of_pose = (config.log_aspect, config.log_aspect_std), (config.max_usual_tilt_rad, config.max_roll_rad)
    return np.array([config.inlier_share, *of_aspect, *of_pose, config.empty_nats])


@compiled
def projected(R: Array, t: Array, log_aspect: float, centre: Array, lattice: Array) -> tuple[Array, Array, Array]:
    """As `refinement.projected` for one pose: points (N, 2), arms (N, 3), depths (N,)."""
    x, arm, depth = np.empty((len(lattice), 2)), np.empty((len(lattice), 3)), np.empty(len(lattice))
    aspect = math.exp(log_aspect)
    for n in range(len(lattice)):
        u, v = lattice[n, 0] - centre[0], (lattice[n, 1] - centre[1]) * aspect
        for k in range(3):
            arm[n, k] = R[k, 0] * u + R[k, 1] * v
        depth[n] = max(arm[n, 2] + t[2], 1e-3)
        x[n, 0], x[n, 1] = (arm[n, 0] + t[0]) / depth[n], (arm[n, 1] + t[1]) / depth[n]
    return x, arm, depth


@compiled
def jacobian(
    R: Array, log_aspect: float, centre: Array, point: Array, x: Array, arm: Array, depth: float, J: Array, d_uv: Array
) -> None:
    """As `refinement.jacobians` for one lattice point (2,): fills J (2, 7 ...) and d_uv (2, 2)."""
    inverse, aspect = 1.0 / depth, math.exp(log_aspect)
    J[0, 0], J[0, 1], J[0, 2] = inverse, 0.0, -x[0] * inverse
    J[1, 0], J[1, 1], J[1, 2] = 0.0, inverse, -x[1] * inverse
    J[0, 3] = -x[0] * arm[1] * inverse
    J[0, 4] = (arm[2] + x[0] * arm[0]) * inverse
    J[0, 5] = -arm[1] * inverse
    J[1, 3] = -(arm[2] + x[1] * arm[1]) * inverse
    J[1, 4] = x[1] * arm[0] * inverse
    J[1, 5] = arm[0] * inverse
    for k in range(2):
        d_uv[k, 0] = (R[k, 0] - x[k] * R[2, 0]) * inverse
        d_uv[k, 1] = (R[k, 1] - x[k] * R[2, 1]) * aspect * inverse
        J[k, 6] = d_uv[k, 1] * (point[1] - centre[1])


@compiled
def jacobians(R: Array, t: Array, log_aspect: float, centre: Array, lattice: Array) -> tuple[Array, Array, Array]:
    """As `refinement.jacobians` for one pose: points (N, 2), derivatives (N, 2, 7) and (N, 2, 2)."""
    x, arm, depth = projected(R, t, log_aspect, centre, lattice)
    J, d_uv = np.empty((len(lattice), 2, 7)), np.empty((len(lattice), 2, 2))
    for n in range(len(lattice)):
        jacobian(R, log_aspect, centre, lattice[n], x[n], arm[n], depth[n], J[n], d_uv[n])
    return x, J, d_uv


@compiled
def solved(A: Array, b: Array) -> Array:
    """Return the solution (P,) of a symmetric positive definite system, by Cholesky's factors."""
    P = len(b)
    L, x = np.zeros((P, P)), b.copy()
    for i in range(P):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            L[i, j] = math.sqrt(s) if i == j else s / L[j, j]
    for i in range(P):
        for k in range(i):
            x[i] -= L[i, k] * x[k]
        x[i] /= L[i, i]
    for i in range(P - 1, -1, -1):
        for k in range(i + 1, P):
            x[i] -= L[k, i] * x[k]
        x[i] /= L[i, i]
    return x


@compiled
def stepped(R: Array, t: Array, log_aspect: float, step: Array) -> tuple[Array, Array, float]:
    """As `refinement.stepped` for one pose."""
    bound = 0.3 * t[2]
    moved = np.empty(3)
    for k in range(3):
        moved[k] = t[k] + min(max(step[k], -bound), bound)
    length = math.sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)
    scale = min(1.0, 0.5 / max(length, 1e-12))
    angle = length * scale
    over = scale / angle if angle > 1e-12 else scale
    x, y, z = step[3] * over, step[4] * over, step[5] * over
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, versine = math.sin(angle), 1.0 - math.cos(angle)
    turned = np.empty((3, 3))
    for j in range(3):
        for i in range(3):
            turn = 0.0
            for k in range(3):
                square = 0.0
                for m in range(3):
                    square += K[i, m] * K[m, k]
                turn += ((1.0 if i == k else 0.0) + sine * K[i, k] + versine * square) * R[k, j]
            turned[i, j] = turn
    return turned, moved, min(max(log_aspect + min(max(step[6], -0.3), 0.3), -1.5), 1.5)


@compiled
def steps_towards(
    R: Array,
    t: Array,
    log_aspect: Array,
    centre: Array,
    cells: Array,
    rays: Array,
    inlier: Array,
    sigma: Array,
    huber: float,
    set_: Array,
) -> tuple[Array, Array, Array]:
    """As a step of `refinement.towards`: R (B, 3, 3), t (B, 3) and ln aspect (B,). rays: (B, N, 2)."""
    new_R, new_t, new_aspect = np.empty_like(R), np.empty_like(t), np.empty_like(log_aspect)
    J, d_uv, error = np.zeros((2, 7)), np.empty((2, 2)), np.empty(2)
    for b in range(len(R)):
        x, arm, depth = projected(R[b], t[b], log_aspect[b], centre[b], cells[b])
        normal, gradient = np.zeros((7, 7)), np.zeros(7)
        for n in range(len(x)):
            error[0], error[1] = rays[b, n, 0] - x[n, 0], rays[b, n, 1] - x[n, 1]
            weight = inlier[b, n] / max(1.0, math.hypot(error[0], error[1]) / huber) / sigma[b] ** 2
            if weight == 0.0:
                continue
            jacobian(R[b], log_aspect[b], centre[b], cells[b, n], x[n], arm[n], depth[n], J, d_uv)
            for k in range(2):
                for i in range(7):
                    gradient[i] += weight * J[k, i] * error[k]
                    for j in range(i + 1):
                        normal[i, j] += weight * J[k, i] * J[k, j]
        normal[6, 6] += 1.0 / set_[2] ** 2
        gradient[6] -= (log_aspect[b] - set_[1]) / set_[2] ** 2
        for i in range(7):
            normal[i, i] += 1e-4 * normal[i, i] + 1e-6
        step = solved(normal, gradient)
        new_R[b], new_t[b], new_aspect[b] = stepped(R[b], t[b], log_aspect[b], step)
    return new_R, new_t, new_aspect
