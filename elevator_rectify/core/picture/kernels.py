"""The inner loops of the fit to a picture, for numba: each does what the NumPy function does that it is named after.

Without numba they serve the tests only, which compare them with that.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from elevator_rectify.core.compiled import compiled, reordered
from elevator_rectify.core.lattice.kernels import PosedLayout, advanced, design
from elevator_rectify.core.lattice.pose_kernels import solved
from elevator_rectify.core.types import Array, BoolArray, IntArray

Floats = NDArray[np.float32]

# Errors beyond so many standard deviations count less (Huber).
HUBER = 2.5
# Alignment reweights so often; a patch with less contrast than this share of the template's shows nothing.
REWEIGHTINGS, LEAST_GAIN = 2, 0.05


@compiled
def in_lattice(posed: PosedLayout, node: IntArray, rays: Array) -> tuple[Array, Array, Array]:
    """As `measured._in_lattice`: errors (M, 2), Jacobians (M, 2, P) in pitches, and d(ray) / d(u, v) (M, 2, 2)."""
    error, J, d_uv = design(posed, node, rays)
    for n in range(len(node)):
        a, b, c, d = d_uv[n, 0, 0], d_uv[n, 0, 1], d_uv[n, 1, 0], d_uv[n, 1, 1]
        determinant = a * d - b * c
        u, v = error[n, 0], error[n, 1]
        error[n, 0], error[n, 1] = (d * u - b * v) / determinant, (a * v - c * u) / determinant
        for i in range(J.shape[2]):
            u, v = J[n, 0, i], J[n, 1, i]
            J[n, 0, i], J[n, 1, i] = (d * u - b * v) / determinant, (a * v - c * u) / determinant
    return error, J, d_uv


@compiled
def huber(off: Array, weight: Array) -> Array:
    """As `measured._huber`."""
    robust = np.empty(len(off))
    for n in range(len(off)):
        u, v = off[n, 0], off[n, 1]
        d2 = u * (weight[n, 0, 0] * u + weight[n, 0, 1] * v) + v * (weight[n, 1, 0] * u + weight[n, 1, 1] * v)
        robust[n] = min(1.0, HUBER / math.sqrt(max(d2, 1e-12)))
    return robust


@compiled
def placed(
    posed: PosedLayout, node: IntArray, rays: Array, weight: Array, set_: Array, steps: int
) -> tuple[PosedLayout, Array]:
    """As `measured._moved_to`: pose and nodes, and by how much the breaks moved. weight: (M, 2, 2) of each place."""
    P = 7 + len(posed.row_breaks) + len(posed.column_breaks)
    half, moves = np.empty((P, 2)), np.zeros(P - 7)
    for _ in range(steps):
        off, J, _d = in_lattice(posed, node, rays)
        robust = huber(off, weight)
        normal, gradient = np.zeros((P, P)), np.zeros(P)
        for n in range(len(node)):
            for i in range(P):
                for k in range(2):
                    half[i, k] = robust[n] * (J[n, 0, i] * weight[n, 0, k] + J[n, 1, i] * weight[n, 1, k])
                gradient[i] += half[i, 0] * off[n, 0] + half[i, 1] * off[n, 1]
                for j in range(P):
                    normal[i, j] += half[i, 0] * J[n, 0, j] + half[i, 1] * J[n, 1, j]
        posed, _s, bounded = advanced(posed, normal, gradient, set_)
        moves += bounded
    return posed, moves


@reordered
def aligned(
    A: Floats, look: Floats, weight: Floats, F: Floats, inside: BoolArray
) -> tuple[Array, Array, Array, Array, Array]:
    """As `template.align`: solutions (M, 4), normal matrices (M, 4, 4), variances, total weights and correlations (M,).

    A: (K, 4), columns of the linear model; look, weight: (K,); F, inside: (M, K).
    """
    M, K = F.shape
    x, normals, variances = np.empty((M, 4)), np.empty((M, 4, 4)), np.empty(M)
    totals, correlations = np.empty(M), np.empty(M)
    now, residual2 = np.empty(K, np.float32), np.empty(K, np.float32)
    gu, gv, lo = A[:, 0].copy(), A[:, 1].copy(), A[:, 2].copy()
    for m in range(M):
        f, total = F[m], np.float32(1e-6)
        for k in range(K):
            now[k] = weight[k] if inside[m, k] else np.float32(0.0)
            total += now[k]
        base = now.copy()
        variance = np.float32(0.0)
        for _ in range(REWEIGHTINGS):
            uu = uv = ul = u1 = vv = vl = v1 = ll = l1 = one = uf = vf = lf = sf = np.float32(0.0)
            for k in range(K):
                w = now[k]
                u, v, q, g = w * gu[k], w * gv[k], w * lo[k], f[k]
                uu += u * gu[k]
                uv += u * gv[k]
                ul += u * lo[k]
                u1 += u
                vv += v * gv[k]
                vl += v * lo[k]
                v1 += v
                ll += q * lo[k]
                l1 += q
                one += w
                uf += u * g
                vf += v * g
                lf += q * g
                sf += w * g
            normal = np.array([[uu, uv, ul, u1], [uv, vv, vl, v1], [ul, vl, ll, l1], [u1, v1, l1, one]]).astype(
                np.float64
            )
            for i in range(4):
                normal[i, i] += 1e-6
            solution = solved(normal, np.array([uf, vf, lf, sf]).astype(np.float64))
            a, b, c, d = (
                np.float32(solution[0]),
                np.float32(solution[1]),
                np.float32(solution[2]),
                np.float32(solution[3]),
            )
            variance = np.float32(0.0)
            for k in range(K):
                r = f[k] - (a * gu[k] + b * gv[k] + c * lo[k] + d)
                residual2[k] = r * r
                variance += base[k] * residual2[k]
            variance /= total
            over = np.float32(2.0) * variance + np.float32(1e-9)
            # Cauchy's weights.
            for k in range(K):
                now[k] = base[k] / (np.float32(1.0) + residual2[k] / over)
            normals[m], x[m] = normal, solution
        mean_f = mean_t = both = ff = tt = np.float32(0.0)
        for k in range(K):
            w, g, q = base[k], f[k], look[k]
            mean_f += w * g
            mean_t += w * q
            both += w * g * q
            ff += w * g * g
            tt += w * q * q
        mean_f, mean_t = mean_f / total, mean_t / total
        spread = (ff / total - mean_f**2) * (tt / total - mean_t**2)
        correlations[m] = (both / total - mean_f * mean_t) / math.sqrt(max(spread, np.float32(1e-12)))
        variances[m], totals[m] = variance, total
    return x, normals, variances, totals, correlations
