"""The inner loops of one layout's fit, for numba: each does what the NumPy function does that it is named after."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elevator_rectify.core.compiled import compiled
from elevator_rectify.core.lattice.pose_kernels import jacobian, projected, solved, stepped
from elevator_rectify.core.types import Array, IntArray

Floats = NDArray[np.float32]

# How softly the priors of tilt and roll end.
STEEP_RAD, TURNED_RAD = 0.2, 0.02
# Points further from a seed, in cells, say nothing of it; those in other cells than two away do not connect.
SUPPORT_REACH, CONNECTED_CELLS = np.float32(3.4), 2.0
# A step of less, in pitches and radians, is far below any noise; Gauss-Newton's next one would be its square.
SETTLED = 3e-4
# Of boxes' sizes, see `sizes`: so few say nothing. Boxes with a margin shrink less than their buttons: on real panels
# the slope is so much less than 1 in the median, and so uncertain.
FEWEST_SIZES, MARGIN_SHARE, SLOPE_STD = 4, 0.1, 0.15
# Of one box, as a share; a size that is further off, in standard deviations, is of a larger or smaller button.
SIZE_STD, FARTHEST_SIZE = 0.06, 3.0


@compiled
def support(around: Floats, which: IntArray, inverse: Floats, length: Floats, brick: Floats) -> Array:
    """As `hypotheses.seed_support`: around (U, K, 2) are the points near each origin, which (S,) is the seeds' own."""
    total = np.zeros(len(which))
    half, one = np.float32(0.5), np.float32(1.0)
    for s in range(len(which)):
        points = around[which[s]]
        for k in range(len(points)):
            u = inverse[s, 0, 0] * points[k, 0] + inverse[s, 0, 1] * points[k, 1]
            v = inverse[s, 1, 0] * points[k, 0] + inverse[s, 1, 1] * points[k, 1]
            distance = max(abs(u), abs(v))
            if not distance < SUPPORT_REACH:
                continue
            row = np.float32(round(v))
            across = u - half * brick[s] * (row % np.float32(2.0))
            error2 = (across - np.float32(round(across))) ** 2 + (v - row) ** 2
            tolerance = min(np.float32(0.07) + np.float32(0.35) * length[s] * distance * distance, np.float32(0.3))
            hit = np.exp(-half * error2 / (tolerance * tolerance))
            total[s] += (np.float32(1.4) * hit - np.float32(0.4)) / (one + np.float32(0.3) * distance)
    return total


@compiled
def connected(cells: Array, inlier: Array) -> Array:
    """As `refinement.connected`."""
    kept = np.zeros(inlier.shape)
    for b in range(len(inlier)):
        for n in range(inlier.shape[1]):
            for m in range(inlier.shape[1]):
                du, dv = abs(cells[b, n, 0] - cells[b, m, 0]), abs(cells[b, n, 1] - cells[b, m, 1])
                if inlier[b, m] > 0.5 and du <= CONNECTED_CELLS and dv <= CONNECTED_CELLS and du + dv > 0.0:
                    kept[b, n] = inlier[b, n]
                    break
    return kept


@compiled
def mixture(error2: Array, number: float, sigma: float, area: float, share: float, inlier: Array) -> float:
    """As `refinement.mixture_likelihood` for one pose: fills inlier (N,), returns the log likelihood."""
    s2, total = sigma * sigma, 0.0
    log_odds = math.log(share / (1.0 - share) * area / (number * 2.0 * math.pi * s2))
    for n in range(len(error2)):
        ratio = log_odds - 0.5 * error2[n] / s2
        log_total = ratio + math.log1p(math.exp(-ratio)) if ratio > 0.0 else math.log1p(math.exp(ratio))
        inlier[n] = math.exp(ratio - log_total)
        total += log_total
    return total


@compiled
def own_sigma(error2: Array, inlier: Array, sigma: float) -> float:
    """As `refinement.estimated_sigma` for one pose."""
    variance = (float((inlier * error2).sum()) + 4.0 * sigma**2) / (max(2.0 * inlier.sum() - 7.0, 0.0) + 4.0)
    return float(min(max(math.sqrt(variance), 0.3 * sigma), 2.7 * sigma))


@compiled
def log_prior(R: Array, log_aspect: float, set_: Array) -> float:
    """As `refinement.log_prior` for one pose."""
    tilt = math.acos(min(max(abs(R[2, 2]), 0.0), 1.0))
    roll = math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])
    steep = max(tilt - set_[3], 0.0) / STEEP_RAD
    turned = max(abs(roll) - set_[4], 0.0) / TURNED_RAD
    ratio = (log_aspect - set_[1]) / set_[2]
    return float(-0.5 * (ratio**2 + steep**2 + turned**2))


class PosedLayout(NamedTuple):
    """A pose and the layout that it is of, as the kernels take them.

    R (3, 3), t (3,), ln aspect, centre (2,); lattice: (K, 2) where the nodes are, row by row of `columns` each; breaks:
    before which rows and columns.
    """

    R: Array
    t: Array
    log_aspect: float
    centre: Array
    lattice: Array
    columns: int
    row_breaks: IntArray
    column_breaks: IntArray


@compiled
def explained(
    posed: PosedLayout, cells: float, penalty: float, rays: Array, sigma: float, area: float, set_: Array
) -> tuple[IntArray, Array, float, float]:
    """As `layout.evaluate`: nodes (N,), inlier (N,), sigma and log likelihood."""
    at = projected(posed.R, posed.t, posed.log_aspect, posed.centre, posed.lattice)[0]
    node, error2 = np.empty(len(rays), dtype=np.int64), np.empty(len(rays))
    for n in range(len(rays)):
        best = np.inf
        node[n] = 0
        for k in range(len(at)):
            distance = (rays[n, 0] - at[k, 0]) ** 2 + (rays[n, 1] - at[k, 1]) ** 2
            if distance < best:
                best, node[n] = distance, k
        error2[n] = best
    inlier = np.empty(len(rays))
    mixture(error2, cells, sigma, area, set_[0], inlier)
    own = own_sigma(error2, inlier, sigma)
    likelihood = mixture(error2, cells, own, area, set_[0], inlier)
    empty = max(0.0, cells - inlier.sum())
    return node, inlier, own, likelihood + log_prior(posed.R, posed.log_aspect, set_) - penalty - set_[5] * empty


@compiled
def design(posed: PosedLayout, node: IntArray, rays: Array) -> tuple[Array, Array, Array]:
    """As `layout.design`: error (N, 2), Jacobian (N, 2, P) and d/d(u, v) (N, 2, 2)."""
    N, B, P = len(node), len(posed.row_breaks), 7 + len(posed.row_breaks) + len(posed.column_breaks)
    at = posed.lattice[node]
    x, arm, depth = projected(posed.R, posed.t, posed.log_aspect, posed.centre, at)
    J, d_uv = np.zeros((N, 2, P)), np.empty((N, 2, 2))
    for n in range(N):
        jacobian(posed.R, posed.log_aspect, posed.centre, at[n], x[n], arm[n], depth[n], J[n], d_uv[n])
        for b in range(P - 7):
            if behind(posed, node[n], b):
                J[n, :, 7 + b] = d_uv[n, :, 1 if b < B else 0]
    return rays - x, J, d_uv


@compiled
def behind(posed: PosedLayout, node: int, b: int) -> bool:
    """Tell whether a node moves with break b, of those of the rows and then of the columns."""
    B = len(posed.row_breaks)
    if b < B:
        return bool(node // posed.columns >= posed.row_breaks[b])
    return bool(node % posed.columns >= posed.column_breaks[b - B])


@compiled
def depths(posed: PosedLayout, node: IntArray) -> tuple[Array, Array]:
    """As `layout.depths`: depth (N,) of each detection's node and its derivative (N, P)."""
    B, P = len(posed.row_breaks), 7 + len(posed.row_breaks) + len(posed.column_breaks)
    at = posed.lattice[node]
    _, arm, depth = projected(posed.R, posed.t, posed.log_aspect, posed.centre, at)
    down, along, d_depth = posed.R[2, 1] * math.exp(posed.log_aspect), posed.R[2, 0], np.zeros((len(node), P))
    for n in range(len(node)):
        d_depth[n, 2], d_depth[n, 3], d_depth[n, 4] = 1.0, arm[n, 1], -arm[n, 0]
        d_depth[n, 6] = down * (at[n, 1] - posed.centre[1])
        for b in range(P - 7):
            if behind(posed, node[n], b):
                d_depth[n, 7 + b] = down if b < B else along
    return depth, d_depth


@compiled
def advanced(posed: PosedLayout, normal: Array, gradient: Array, set_: Array) -> tuple[PosedLayout, Array, Array]:
    """Return pose and nodes after the step that the information (P, P) and gradient (P,) of the data and the aspect's
    prior ask for; the step (P,), and by how much it moved the breaks, bounded as by `layout.moved`."""
    normal[6, 6] += 1.0 / set_[2] ** 2
    gradient[6] -= (posed.log_aspect - set_[1]) / set_[2] ** 2
    for i in range(len(gradient)):
        normal[i, i] += 1e-6 + 1e-5 * normal[i, i]
    step = solved(normal, gradient)
    R, t, log_aspect = stepped(posed.R, posed.t, posed.log_aspect, step)
    lattice, B = posed.lattice.copy(), len(posed.row_breaks)
    bounded = np.minimum(np.maximum(step[7:], -0.3), 0.3)
    for b in range(len(bounded)):
        for k in range(len(lattice)):
            if behind(posed, k, b):
                lattice[k, 1 if b < B else 0] += bounded[b]
    columns, row_breaks, column_breaks = posed.columns, posed.row_breaks, posed.column_breaks
    new = PosedLayout(R, t, log_aspect, posed.centre, lattice, columns, row_breaks, column_breaks)
    return new, step, bounded


@compiled
def add_sizes(depth: Array, d_depth: Array, log_sizes: Array, inlier: Array, normal: Array, gradient: Array) -> None:
    """As `sizes.size_information`: adds information (P, P) and gradient (P,)."""
    on = np.flatnonzero((inlier > 0.5) & np.isfinite(log_sizes))
    M, P = len(on), len(gradient)
    if M < FEWEST_SIZES:
        return
    slope = 1.0 - MARGIN_SHARE
    expected = -1.5 * np.log(depth[on])
    expected -= expected.mean()
    off = log_sizes[on] - slope * expected
    off -= np.median(off)
    weight = inlier[on] / (1.0 + (off / (FARTHEST_SIZE * SIZE_STD)) ** 2) ** 2 / SIZE_STD**2
    own, pull, cross = np.zeros((2, 2)), np.zeros(2), np.zeros((2, P))
    for m in range(M):
        for i in range(P):
            J = -1.5 * slope * d_depth[on[m], i] / depth[on[m]]
            cross[0, i] += weight[m] * J
            cross[1, i] += weight[m] * J * expected[m]
            gradient[i] += weight[m] * J * off[m]
            for j in range(P):
                normal[i, j] += weight[m] * J * -1.5 * slope * d_depth[on[m], j] / depth[on[m]]
        own[0, 0] += weight[m]
        own[0, 1] += weight[m] * expected[m]
        own[1, 1] += weight[m] * expected[m] ** 2
        pull[0] += weight[m] * off[m]
        pull[1] += weight[m] * expected[m] * off[m]
    own[1, 1] += SLOPE_STD**-2
    determinant = own[0, 0] * own[1, 1] - own[0, 1] ** 2
    for i in range(P):
        first = (own[1, 1] * cross[0, i] - own[0, 1] * cross[1, i]) / determinant
        second = (own[0, 0] * cross[1, i] - own[0, 1] * cross[0, i]) / determinant
        gradient[i] -= first * pull[0] + second * pull[1]
        for j in range(P):
            normal[i, j] -= first * cross[0, j] + second * cross[1, j]


@compiled
def refined(
    posed: PosedLayout,
    cells: float,
    penalty: float,
    rays: Array,
    sigma: float,
    area: float,
    set_: Array,
    node: IntArray,
    inlier: Array,
    own: float,
    steps: int,
    log_sizes: Array,
) -> tuple[PosedLayout, Array, IntArray, Array, float, float, Array]:
    """As `layout.refine_layout`: pose and nodes, by how much the breaks moved, nodes of the detections, inlier, sigma,
    log likelihood, and the nodes' depths.

    log_sizes: (N,), or of length 0 where the boxes' sizes are left out.
    """
    P = 7 + len(posed.row_breaks) + len(posed.column_breaks)
    likelihood, moves = 0.0, np.zeros(P - 7)
    for _ in range(steps):
        error, J, _d = design(posed, node, rays)
        normal, gradient = np.zeros((P, P)), np.zeros(P)
        for n in range(len(rays)):
            weight = inlier[n] / own**2
            for k in range(2):
                for i in range(P):
                    gradient[i] += weight * J[n, k, i] * error[n, k]
                    for j in range(P):
                        normal[i, j] += weight * J[n, k, i] * J[n, k, j]
        if len(log_sizes):
            depth, d_depth = depths(posed, node)
            add_sizes(depth, d_depth, log_sizes, inlier, normal, gradient)
        posed, step, bounded = advanced(posed, normal, gradient, set_)
        moves += bounded
        node, inlier, own, likelihood = explained(posed, cells, penalty, rays, sigma, area, set_)
        if np.abs(step).max() < SETTLED:
            break
    return posed, moves, node, inlier, own, likelihood, depths(posed, node)[0]
