"""Lattice hypotheses: affine seeds from triples of neighbours, the best supported ones grown into homographies.

All hypotheses are rows of one array; G (S, 3, 3) maps (column, row, 1) to the normalised plane.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from elevator_rectify.core.compiled import COMPILED
from elevator_rectify.core.config import HypothesesConfig
from elevator_rectify.core.lattice.kernels import SUPPORT_REACH, support
from elevator_rectify.core.types import Array, IntArray

# Growth: Chebyshev radius in cells around the seed within which points take part, then all.
_RADII = (1.4, 2.4, 3.6, 6.0, 100.0)
_TOLERANCES_CELLS = (0.42, 0.3, 0.28, 0.28, 0.28)
# Standard deviation of the perspective terms per cell, over the cell's size in focal lengths (its pitch over its
# depth): the sine of the tilt along that axis.
TILT_SINE = 0.5
_BEYOND = 1e6
# Adjugate entry (j, i) is G[i+1, j+1] G[i+2, j+2] - G[i+1, j+2] G[i+2, j+1], indices modulo 3: places in a flat G.
_I, _J = np.meshgrid(np.arange(3), np.arange(3))
_NEXT_NEXT, _LAST_LAST, _NEXT_LAST, _LAST_NEXT = (
    (3 * ((_I + i) % 3) + (_J + j) % 3).ravel() for i, j in ((1, 1), (2, 2), (1, 2), (2, 1))
)
# Cells that a triple spans to the right and down (where a button between is missing), the shear of its lower point in
# units of its right one (the point below is missing, or its row is shifted), that of its right point in units of its
# lower one (its column is shifted: a lattice of half the row pitch holds both), brick layout or not, its cost.
_Variant = tuple[tuple[float, float], float, float, float, float]
_VARIANTS: tuple[_Variant, ...] = (
    ((1.0, 1.0), 0.0, 0.0, 0.0, 0.0),
    ((2.0, 1.0), 0.0, 0.0, 0.0, 0.5),
    ((1.0, 2.0), 0.0, 0.0, 0.0, 0.5),
    ((1.0, 1.0), 0.5, 0.0, 1.0, 0.5),
    ((1.0, 1.0), -0.5, 0.0, 1.0, 0.5),
    ((1.0, 2.0), 0.0, 0.5, 0.0, 0.5),
    ((1.0, 2.0), 0.0, -0.5, 0.0, 0.5),
)
# With few points, few triples are complete: more of them are worth a try.
_FEW_POINTS = 16
_MANY_POINTS = 24
_SEED_POINTS = 1500
# Only so many of the points nearest to a seed are asked: a lattice has no more within the reach that counts.
_NEAREST_POINTS = 64
_FEW_VARIANTS: tuple[_Variant, ...] = (
    ((1.0, 1.0), 1.0, 0.0, 0.0, 0.5),
    ((1.0, 1.0), -1.0, 0.0, 0.0, 0.5),
    ((2.0, 1.0), 0.5, 0.0, 0.0, 1.0),
    ((2.0, 1.0), -0.5, 0.0, 0.0, 1.0),
    ((2.0, 1.0), 0.25, 0.0, 1.0, 1.0),
    ((2.0, 1.0), -0.25, 0.0, 1.0, 1.0),
    ((3.0, 1.0), 0.0, 0.0, 0.0, 1.0),
)


def grown_hypotheses(rays: Array, sigma: float, config: HypothesesConfig) -> tuple[Array, Array]:
    """Return homographies (S, 3, 3) of the best supported seeds, grown over all points (N, 2), and brick (S,).

    brick is 1 for layouts whose odd rows are shifted by half a pitch, else 0. May be empty.
    """
    origins, bases = affine_seeds(rays, config)
    if not len(origins):
        return np.zeros((0, 3, 3)), np.zeros(0)
    variants, costs, bricks = [], [], []
    known = _VARIANTS + (_FEW_VARIANTS if len(rays) <= _FEW_POINTS else ())
    for spans, shear, column_shear, brick_flag, cost_of_variant in known:
        variants.append(bases @ np.array([[1.0, -shear], [-column_shear, 1.0]]) / spans)
        costs.append(np.full(len(bases), cost_of_variant))
        bricks.append(np.full(len(bases), brick_flag))
    origins, bases = np.tile(origins, (len(variants), 1)), np.concatenate(variants)
    brick, cost = np.concatenate(bricks), np.concatenate(costs)
    # Of many points, many seeds are right: fewer are needed, and each costs more.
    number = min(config.seeds, max(config.seeds // 4, _SEED_POINTS // len(rays)))
    best = _diverse(seed_support(rays, origins, bases, brick) - cost, origins, number)
    return grow(rays, origins[best], bases[best], brick[best], sigma), brick[best]


def nearest_nodes(q: Array, brick: Array) -> Array:
    """Return the lattice node (S, N, 2) nearest to each lattice coordinate (S, N, 2)."""
    row = np.round(q[..., 1])
    shift = 0.5 * brick[:, None] * (row % 2.0)
    return np.stack([np.round(q[..., 0] - shift) + shift, row], axis=-1)


def affine_seeds(rays: Array, config: HypothesesConfig) -> tuple[Array, Array]:
    """Return origins (S, 2) and bases (S, 2, 2), columns a (to the right) and b (down), of all neighbour triples."""
    offset = rays[None] - rays[:, None]
    lengths = np.linalg.norm(offset, axis=2)
    limit = np.tan(config.max_axis_angle_rad)
    right = (offset[..., 0] > 0) & (np.abs(offset[..., 1]) < limit * offset[..., 0])
    down = (offset[..., 1] > 0) & (np.abs(offset[..., 0]) < limit * offset[..., 1])
    # Among many points each has many true neighbours.
    number = config.neighbours if len(rays) <= _MANY_POINTS else min(config.neighbours, 3)
    q, r = (_nearest(np.where(side, lengths, np.inf), number) for side in (right, down))
    p, q, r = (
        index.ravel()
        for index in np.broadcast_arrays(np.arange(len(rays))[:, None, None], q[:, :, None], r[:, None, :])
    )
    known = (q >= 0) & (r >= 0)
    p, q, r = p[known], q[known], r[known]
    a, b = rays[q] - rays[p], rays[r] - rays[p]
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    la, lb = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
    # A cell seen under 60 degrees and a pitch ratio of two leave this much area and this aspect.
    sound = (area > 0.3 * la * lb) & (la < config.max_aspect * lb) & (lb < config.max_aspect * la)
    return rays[p[sound]], np.stack([a[sound], b[sound]], axis=-1)


def _nearest(distance: Array, number: int) -> IntArray:
    """Return the columns (N, number) of each row's smallest finite entries, -1 where there are fewer."""
    order = np.argsort(distance, axis=1, kind="stable")[:, :number]
    return np.where(np.isfinite(np.take_along_axis(distance, order, axis=1)), order, -1)


def seed_support(rays: Array, origins: Array, bases: Array, brick: Array) -> Array:
    """Return (S,) how many points near each seed lie on its lattice, less half of those that do not."""
    # The longest loop of all: single precision, and no temporary arrays of vectors.
    inverse = np.linalg.inv(bases).astype(np.float32)
    # Perspective bends the affine lattice by its change per cell times the square of the distance.
    length = np.sqrt(np.abs(np.linalg.det(bases))).astype(np.float32)
    around, which = _around(rays, origins)
    if COMPILED:
        return support(around, which, inverse, length, np.ascontiguousarray(brick, dtype=np.float32))
    dx, dy = around[which, :, 0], around[which, :, 1]
    u = inverse[:, 0, :1] * dx + inverse[:, 0, 1:] * dy
    v = inverse[:, 1, :1] * dx + inverse[:, 1, 1:] * dy
    row = np.round(v)
    across: NDArray[np.float32] = u - np.float32(0.5) * brick[:, None].astype(np.float32) * (row % 2)
    error2 = (across - np.round(across)) ** 2 + (v - row) ** 2
    distance = np.maximum(np.abs(u), np.abs(v))
    bent = np.float32(0.35) * length[:, None] * distance * distance
    tolerance = np.minimum(np.float32(0.07) + bent, np.float32(0.3))
    near = distance < SUPPORT_REACH
    hit = np.exp(np.float32(-0.5) * error2 / (tolerance * tolerance))
    each = (np.float32(1.4) * hit - np.float32(0.4)) * near / (np.float32(1.0) + np.float32(0.3) * distance)
    return np.asarray(each.sum(axis=1), dtype=np.float64)


def _around(rays: Array, origins: Array) -> tuple[NDArray[np.float32], IntArray]:
    """Return the nearest points (U, K, 2) about each of U origins, from it, and which (S,) of them each seed's is."""
    places, which = np.unique(origins, axis=0, return_inverse=True)
    offset = rays[None] - places[:, None]
    if len(rays) > _NEAREST_POINTS:
        distance2 = (offset**2).sum(axis=2)
        nearest = np.argpartition(distance2, _NEAREST_POINTS, axis=1)[:, :_NEAREST_POINTS]
        offset = np.take_along_axis(offset, nearest[..., None], axis=1)
    return np.ascontiguousarray(offset, dtype=np.float32), np.asarray(which, dtype=np.int64).ravel()


def _diverse(support: Array, origins: Array, number: int) -> IntArray:
    """Return the best seeds, not too many of one origin."""
    order = np.argsort(-support, kind="stable")[: 6 * number]
    most = max(4, 2 * number // len({tuple(origin) for origin in origins[order]}))
    seen: dict[bytes, int] = {}
    chosen = []
    for index in order:
        key = origins[index].tobytes()
        if seen.setdefault(key, 0) < most:
            seen[key] += 1
            chosen.append(index)
    return np.array(chosen[:number], dtype=np.int64)


def grow(rays: Array, origins: Array, bases: Array, brick: Array, sigma: float) -> Array:
    """Re-estimate each seed's homography over a growing neighbourhood."""
    length = np.sqrt(np.abs(np.linalg.det(bases)))
    z = (rays[None] - origins[:, None]) / length[:, None, None]
    G = np.tile(np.eye(3), (len(origins), 1, 1))
    G[:, :2, :2] = bases / length[:, None, None]
    for radius, tolerance in zip(_RADII, _TOLERANCES_CELLS, strict=True):
        cells, weights = _assigned(G, z, brick, radius, tolerance)
        G = fit_homographies(cells, z, weights, (sigma / length) / (TILT_SINE * length))
    to_rays = np.tile(np.eye(3), (len(origins), 1, 1))
    to_rays[:, 0, 0] = to_rays[:, 1, 1] = length
    to_rays[:, :2, 2] = origins
    return np.asarray(to_rays @ G)


def _assigned(G: Array, z: Array, brick: Array, radius: float, tolerance: float) -> tuple[Array, Array]:
    """Return the nearest nodes (S, N, 2) of points z (S, N, 2), and weights (S, N): 0 outside radius and tolerance."""
    q = lattice_coordinates(G, z)
    cells = nearest_nodes(q, brick)
    error = np.hypot(q[..., 0] - cells[..., 0], q[..., 1] - cells[..., 1])
    inside = (np.abs(q).max(axis=2) < radius) & (error < tolerance)
    return np.where(inside[..., None], cells, 0.0), inside * (1.0 - (error / tolerance) ** 2)


def lattice_coordinates(G: Array, points: Array) -> Array:
    """Return G^-1 points (S, N, 2); far away where a point is beyond the plane's horizon or G is singular."""
    adjugate = adjugates(G)
    determinant = (adjugate[:, 0] * G[:, :, 0]).sum(axis=1)[:, None, None]
    mapped = points @ np.swapaxes(adjugate[:, :, :2], 1, 2) + adjugate[:, None, :, 2]
    scale = mapped[..., 2:] * np.sign(determinant)
    front = scale > 1e-9 * np.abs(determinant)
    return np.where(front, mapped[..., :2] * np.sign(determinant) / np.where(front, scale, 1.0), _BEYOND)


def adjugates(G: Array) -> Array:
    """Return the adjugates of (S, 3, 3): inverses up to a factor, which exist always."""
    flat = G.reshape(-1, 9)
    product = flat[:, _NEXT_NEXT] * flat[:, _LAST_LAST] - flat[:, _NEXT_LAST] * flat[:, _LAST_NEXT]
    return np.asarray(product.reshape(-1, 3, 3))


def fit_homographies(cells: Array, z: Array, weights: Array, ridge: Array) -> Array:
    """Return the regularised least-squares homographies (S, 3, 3) from cells (S, N, 2) to points (S, N, 2).

    z (g31 u + g32 v + 1) = g1 u + g2 v + g3, linear in the eight unknowns (Hartley and Zisserman, 4.1);
    ridge (S,): noise over prior standard deviation of the perspective terms.
    """
    A = np.concatenate([cells, np.ones((*cells.shape[:2], 1))], axis=-1)
    # All sums at once: the weighted products of (A, x A, y A) with each other.
    terms = np.concatenate([A, A * z[..., :1], A * z[..., 1:]], axis=-1)
    gram = np.swapaxes(terms * weights[..., None], 1, 2) @ terms
    M = gram[:, :3, :3] + 1e-9 * np.eye(3)
    # (S, 2, 3, 2) and (S, 2, 3, 1): sums of A with z (u, v) and with z, for both coordinates of z.
    cross = np.stack([gram[:, :3, 3:5], gram[:, :3, 6:8]], axis=1)
    right = np.stack([gram[:, :3, 5:6], gram[:, :3, 8:9]], axis=1)
    inverse = np.linalg.inv(M)[:, None]
    # Eliminate the affine part: a 2 x 2 system for the perspective terms.
    eliminated = np.swapaxes(cross, 2, 3) @ inverse
    D = gram[:, 3:5, 3:5] + gram[:, 6:8, 6:8] - (eliminated @ cross).sum(axis=1)
    c = (eliminated @ right).sum(axis=1) - gram[:, 3:5, 5:6] - gram[:, 6:8, 8:9]
    perspective = np.linalg.solve(D + np.eye(2) * (ridge**2)[:, None, None], c)
    affine = (inverse @ (right + cross @ perspective[:, None]))[..., 0]
    perspective = perspective[..., 0]
    G = np.empty((len(cells), 3, 3))
    G[:, :2], G[:, 2, :2], G[:, 2, 2] = affine, perspective, 1.0
    return G
