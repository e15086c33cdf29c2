"""The paper's Gaussian mixture over a regular grid, fitted by expectation maximisation.

    p(x) = (1 - a) / C + (a / K) sum_ij N(x | (ox + Dx j, oy + Dy i), diag(vx, vy)),   K = rows * columns

The covariance is diagonal and the weights are uniform, so the sum over cells is a product of a sum over columns and a
sum over rows: an E-step costs rows + columns terms a detection instead of rows * columns. Every array has a leading
axis of S candidate sizes, which are fitted together.

Zhu, Liu, Ma, Min, Meng, arXiv 1912.11774, section III-B; numbers of errata in the comments.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.config import EmConfig
from elevator_rectify.core.types import Array, IntArray

# Updates of offset and pitch in the M-step.
JOINT, COORDINATE, PRINTED = "joint", "coordinate", "printed"
_LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True)
class Mixture:
    """Parameters of S mixtures; the axis of length 2 is (x over columns, y over rows), counts likewise.

    origin, pitch: (S, 2) px; variance: (S, 2) px^2; counts: (S, 2) number of columns and rows; log_likelihood: (S,).
    """

    origin: Array
    pitch: Array
    variance: Array
    counts: IntArray
    log_likelihood: Array
    iterations: IntArray
    converged: IntArray

    def take(self, chosen: IntArray | slice) -> Mixture:
        """Return the chosen candidates."""
        return Mixture(**{name: values[chosen] for name, values in vars(self).items()})


@dataclass(frozen=True)
class Responsibilities:
    """E-step: inlier (S, N); axis 0 and 1: (S, N, columns), (S, N, rows), each a distribution given inlier."""

    inlier: Array
    axes: tuple[Array, Array]
    log_density: Array

    def cells(self) -> IntArray:
        """Return the most probable (S, N, 2) row and column of each detection."""
        return np.stack([self.axes[1].argmax(-1), self.axes[0].argmax(-1)], axis=-1)


def initial_mixture(points: Array, counts: IntArray, config: EmConfig, printed: bool = False) -> Mixture:
    """Return the paper's starting values for S sizes: o = top-left detection, D = 100 px, sigma = 640 px.

    points: (N, 2) px; counts: (S, 2) columns and rows. Erratum 6: 640 is the standard deviation, not the variance
    that the formula makes it; `printed` keeps the formula.
    """
    size = len(counts)
    top_left = points[np.argmin(points.sum(axis=1))]
    variance = config.initial_sigma_px if printed else config.initial_sigma_px**2
    return Mixture(
        origin=np.tile(top_left, (size, 1)),
        pitch=np.full((size, 2), config.initial_pitch_px),
        variance=np.full((size, 2), float(variance)),
        counts=counts,
        log_likelihood=np.full(size, -np.inf),
        iterations=np.zeros(size, dtype=np.int64),
        converged=np.zeros(size, dtype=np.int64),
    )


def e_step(points: Array, log_area: Array, mixture: Mixture, inlier_share: float) -> Responsibilities:
    """Return the posteriors of (N, 2) points, in the log domain.

    log_area: (N,) logarithm of C, the area over which outliers are uniform, at each point.
    """
    logs, axes = [], []
    for axis in (0, 1):
        log_normal = _axis_log_normal(points[:, axis], mixture, axis)
        top = log_normal.max(axis=-1, keepdims=True)
        likelihood = np.exp(log_normal - top)
        total = likelihood.sum(axis=-1, keepdims=True)
        axes.append(likelihood / total)
        logs.append((np.log(total) + top)[..., 0])
    log_cells = np.log(mixture.counts).sum(axis=1)[:, None]
    log_inlier = np.log(inlier_share) - log_cells + logs[0] + logs[1]
    log_outlier = np.log1p(-inlier_share) - log_area
    log_density = np.logaddexp(log_inlier, log_outlier)
    return Responsibilities(np.exp(log_inlier - log_density), (axes[0], axes[1]), log_density)


def _axis_log_normal(x: Array, mixture: Mixture, axis: int) -> Array:
    """Return log N(x_n | o + D i, v): (S, N, largest count), -inf beyond a candidate's own count."""
    index = np.arange(mixture.counts[:, axis].max())
    origin, pitch, variance = (
        values[:, axis, None, None] for values in (mixture.origin, mixture.pitch, mixture.variance)
    )
    log_normal = -0.5 * ((x[:, None] - origin - pitch * index) ** 2 / variance + np.log(variance) + _LOG_2PI)
    beyond = index >= mixture.counts[:, axis, None, None]
    return np.where(beyond, -np.inf, log_normal)


def m_step(points: Array, posterior: Responsibilities, mixture: Mixture, config: EmConfig, update: str) -> Mixture:
    """Return a mixture of higher expected log likelihood, in closed form.

    update: how offset and pitch are computed, see `_line`. Erratum 4: i_k, j_k weighted by the responsibilities (with
    1/sigma, which cancels) take part, not i_n, j_n.
    """
    origin, pitch, variance = mixture.origin.copy(), mixture.pitch.copy(), mixture.variance.copy()
    for axis in (0, 1):
        weights = posterior.inlier[..., None] * posterior.axes[axis]
        x = points[:, axis]
        origin[:, axis], pitch[:, axis] = _line(x, weights, mixture, axis, update)
        index = np.arange(weights.shape[-1])
        error = x[:, None] - origin[:, axis, None, None] - pitch[:, axis, None, None] * index
        # Erratum 3: the published update divides by N where the sum of the responsibilities belongs.
        total = np.full(len(origin), float(len(x))) if update == PRINTED else weights.sum(axis=(1, 2))
        spread = np.einsum("snk,snk->s", weights, error**2) / np.maximum(total, 1e-12)
        variance[:, axis] = np.maximum(spread, config.min_sigma_px**2)
    return replace(mixture, origin=origin, pitch=pitch, variance=variance)


def _line(x: Array, weights: Array, mixture: Mixture, axis: int, update: str) -> tuple[Array, Array]:
    """Return offset and slope (S,), (S,) of the weighted line x = o + D i.

    PRINTED: both from the other's old value, as published (erratum 5); nothing keeps that from lowering the likelihood.
    JOINT: both at once, the maximum. From sigma = 640 px, where all cells are equally likely, it throws the start away:
    the pitch falls to almost zero, a saddle that EM leaves only after hundreds of steps.
    COORDINATE: the slope for the old offset, then the offset for the new slope. It raises the likelihood too, and keeps
    the paper's start alive: the update for the first fit.
    """
    index = np.arange(weights.shape[-1], dtype=float)
    per_index = weights.sum(axis=1)
    s0, s1, s2 = per_index.sum(axis=1), per_index @ index, per_index @ index**2
    moments = np.einsum("snk,n->sk", weights, x)
    t0, t1 = moments.sum(axis=1), moments @ index
    old_slope = mixture.pitch[:, axis]
    top, bottom = (s0 * t1 - s1 * t0, s0 * s2 - s1**2) if update == JOINT else (t1 - mixture.origin[:, axis] * s1, s2)
    # With all weight in one index there is no slope; the old one stays.
    defined = bottom > 1e-9 * np.maximum(s0 * s2 if update == JOINT else s0, 1e-12)
    slope = np.where(defined, top / np.where(defined, bottom, 1.0), old_slope)
    return (t0 - (old_slope if update == PRINTED else slope) * s1) / np.maximum(s0, 1e-12), slope


def fit_mixture(points: Array, log_area: Array, start: Mixture, config: EmConfig, update: str) -> Mixture:
    """Run EM on all candidates until each one's likelihood settles.

    points: (N, 2) px; log_area: (N,), see `e_step`; update: see `_line`. Candidates that settled are set aside.
    """
    done = start
    active = np.arange(len(start.counts))
    current = replace(start, log_likelihood=np.full(len(active), -np.inf))
    for iteration in range(config.max_iterations):
        posterior = e_step(points, log_area, current, config.inlier_share)
        likelihood = posterior.log_density.sum(axis=1)
        settled = np.abs(likelihood - current.log_likelihood) < config.tolerance
        steps = np.full(len(active), iteration)
        current = replace(current, log_likelihood=likelihood, iterations=steps, converged=settled.astype(np.int64))
        done = _put(done, active, current)
        if settled.all():
            break
        inlier, axes = posterior.inlier[~settled], (posterior.axes[0][~settled], posterior.axes[1][~settled])
        active, current = active[~settled], current.take(np.flatnonzero(~settled))
        posterior = Responsibilities(inlier, axes, posterior.log_density[~settled])
        current = m_step(points, posterior, current, config, update)
    return done


def _put(target: Mixture, places: IntArray, source: Mixture) -> Mixture:
    """Return `target` with the candidates at `places` replaced by `source`'s."""
    merged = {}
    for name, values in vars(target).items():
        merged[name] = values.copy()
        merged[name][places] = getattr(source, name)
    return Mixture(**merged)
