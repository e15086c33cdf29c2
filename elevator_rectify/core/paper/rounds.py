"""The paper's method: rounds of grid fit and rigid motion, the grid's size chosen by likelihood.

Zhu et al., arXiv 1912.11774, algorithm 1. `printed` keeps initial values and formulas as published.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elevator_rectify.core.config import Config, SizeConfig
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.paper.mixture import (
    COORDINATE,
    JOINT,
    PRINTED,
    Mixture,
    e_step,
    fit_mixture,
    initial_mixture,
)
from elevator_rectify.core.paper.motion import estimate_motion, no_motion, printed_start, transform
from elevator_rectify.core.types import Array, IntArray

# Corrected points beyond this many focal lengths come from a plane seen edge-on.
_FARTHEST = 1e3


@dataclass(frozen=True)
class PaperFit:
    """Result of the rounds.

    G: (3, 3) maps (column, row, 1) to the normalised plane; cells: (N, 2) row and column, -1 for outliers;
    cost: the paper's metric, the mean squared distance in the corrected normalised plane.
    """

    G: Array
    counts: IntArray
    cells: IntArray
    inlier: Array
    log_likelihood: float
    cost: float
    iterations: int
    converged: bool


def candidate_sizes(number: int, config: SizeConfig) -> IntArray:
    """Return the (S, 2) columns and rows to try for `number` detections: all up to the limits, none mostly empty."""
    columns = [config.columns] if config.columns else range(1, config.max_columns + 1)
    rows = [config.rows] if config.rows else range(1, config.max_rows + 1)
    sizes = [(c, r) for c in columns for r in rows if c * r >= 2]
    full = [size for size in sizes if size[0] * size[1] <= 3 * number]
    return np.array(full or sizes, dtype=np.int64)


def fit_paper(rays: Array, camera: Camera, config: Config, printed: bool = False) -> PaperFit:
    """Fit grid and motion to undistorted normalised points (N, 2).

    Erratum 9: the paper gives no rule for the grid's size. All sizes go through the first grid fit together, the
    likeliest few through all rounds, and the likeliest of those is the answer.
    """
    f = camera.focal_px
    points_px = rays * f
    log_area = np.full(len(rays), np.log(camera.width * camera.height))
    sizes = candidate_sizes(len(rays), config.size)
    start = initial_mixture(points_px, sizes, config.em, printed)
    first = fit_mixture(points_px, log_area, start, config.em, PRINTED if printed else COORDINATE)
    best = np.argsort(-first.log_likelihood, kind="stable")[: config.size.candidates]
    fits = [_rounds(rays, f, log_area, first.take(best[k : k + 1]), config, printed) for k in range(len(best))]
    return max(fits, key=lambda fit: fit.log_likelihood)


def _rounds(rays: Array, f: float, log_area: Array, mixture: Mixture, config: Config, printed: bool) -> PaperFit:
    """Alternate motion and grid fit for one size until the image of the grid stays.

    H maps the grid's plane to the image; the corrected points are H^-1 x. Erratum 10: as published, each round
    estimates a motion of the corrected points and H is the product of the rounds' maps, which is no rigid motion: even
    exact points end up a few hundredths of a degree off. Here each round estimates the whole motion from the grid to
    the detections, from the last one on, so that the rounds compose into one R and t.
    """
    motion, H, settled = printed_start() if printed else no_motion(), np.eye(3), False
    iterations = int(mixture.iterations[0])
    corrected, local_area, corners = rays, log_area, np.full((4, 2), np.inf)
    for _ in range(config.rounds.max_rounds):
        references, weights = _references(corrected * f, mixture, local_area, f, config)
        observed = corrected if printed else rays
        motion = estimate_motion(references, observed, weights, motion, config.motion, printed)
        H = H @ motion.plane_map if printed else motion.plane_map
        corrected, log_jacobian = _corrected(H, rays)
        if not np.isfinite(corrected).all() or np.abs(corrected).max() > _FARTHEST:
            break
        # The outliers' density is uniform in the image, so their area changes with the map at each point.
        local_area = log_area + log_jacobian
        mixture = fit_mixture(corrected * f, local_area, mixture, config.em, PRINTED if printed else JOINT)
        iterations += int(mixture.iterations[0])
        last, corners = corners, _grid_corners(H, mixture, f)
        settled = bool(np.abs(corners - last).max() < config.rounds.tolerance)
        if settled:
            break
        motion = no_motion() if printed else motion
    return _summary(H, mixture, corrected * f, local_area, f, iterations, settled, config)


def _references(points_px: Array, mixture: Mixture, log_area: Array, f: float, config: Config) -> tuple[Array, Array]:
    """Return each detection's fitted centre (N, 2), normalised, and its probability of being a button (N,)."""
    posterior = e_step(points_px, log_area, mixture, config.em.inlier_share)
    cells = posterior.cells()[0]
    return (mixture.origin[0] + mixture.pitch[0] * cells[:, ::-1]) / f, posterior.inlier[0]


def _corrected(H: Array, rays: Array) -> tuple[Array, Array]:
    """Return H^-1 x and ln |det d(H^-1 x)/dx| at each point."""
    inverse = np.asarray(np.linalg.inv(H), dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = rays @ inverse[2, :2] + inverse[2, 2]
        return transform(inverse, rays), np.log(abs(np.linalg.det(inverse))) - 3.0 * np.log(np.abs(depth))


def _grid_corners(H: Array, mixture: Mixture, f: float) -> Array:
    """Return the image (4, 2), normalised, of the grid's corners: what settles, whatever motion and grid share."""
    ends = mixture.counts[0] - 1.0
    corners = np.array([[0.0, 0.0], [ends[0], 0.0], [0.0, ends[1]], ends])
    return transform(H, (mixture.origin[0] + mixture.pitch[0] * corners) / f)


def _summary(
    H: Array,
    mixture: Mixture,
    points_px: Array,
    log_area: Array,
    f: float,
    iterations: int,
    settled: bool,
    config: Config,
) -> PaperFit:
    """Compose motion and grid into one map from the lattice to the image, and label the detections."""
    (dx, dy), (ox, oy) = mixture.pitch[0] / f, mixture.origin[0] / f
    grid = np.array([[dx, 0.0, ox], [0.0, dy, oy], [0.0, 0.0, 1.0]])
    posterior = e_step(points_px, log_area, mixture, config.em.inlier_share)
    inlier = posterior.inlier[0]
    references, _ = _references(points_px, mixture, log_area, f, config)
    cost = float(inlier @ ((points_px / f - references) ** 2).sum(axis=1)) / len(points_px)
    cells = np.where(inlier[:, None] > 0.5, posterior.cells()[0], -1)
    # Densities are those of the input image, so that grids of different corrected scales compare.
    image_density = posterior.log_density[0] + log_area
    likelihood = float(image_density.sum()) if settled else -np.inf
    return PaperFit(H @ grid, mixture.counts[0], cells, inlier, likelihood, cost, iterations, settled)
