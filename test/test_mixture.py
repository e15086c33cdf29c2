import numpy as np
import pytest

from elevator_rectify.core.config import EmConfig
from elevator_rectify.core.paper.mixture import COORDINATE, JOINT, Mixture, e_step, fit_mixture, initial_mixture, m_step
from elevator_rectify.core.types import Array

CONFIG = EmConfig()
LOG_AREA = float(np.log(640 * 480))


def grid_points(rows: int, columns: int, sigma_px: float, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    j, i = np.meshgrid(np.arange(columns), np.arange(rows))
    points = np.column_stack([j.ravel() * 70.0 - 90.0, i.ravel() * 55.0 - 130.0])
    return points + rng.normal(0, sigma_px, points.shape) if sigma_px else points


def log_area(points: Array) -> Array:
    return np.full(len(points), LOG_AREA)


def naive_density(points: Array, mixture: Mixture, candidate: int) -> Array:
    """The mixture as the paper writes it, cell by cell."""
    columns, rows = mixture.counts[candidate]
    total = np.full(len(points), (1 - CONFIG.inlier_share) * np.exp(-LOG_AREA))
    for i in range(rows):
        for j in range(columns):
            centre = mixture.origin[candidate] + mixture.pitch[candidate] * [j, i]
            exponent = ((points - centre) ** 2 / mixture.variance[candidate]).sum(axis=1)
            normal = np.exp(-0.5 * exponent) / (2 * np.pi * np.sqrt(mixture.variance[candidate].prod()))
            total += CONFIG.inlier_share / (rows * columns) * normal
    return total


def test_separable_e_step_equals_the_sum_over_cells() -> None:
    points = grid_points(4, 3, 3.0, 1)
    start = initial_mixture(points, np.array([[3, 4], [2, 6]]), EmConfig(initial_sigma_px=40.0))
    posterior = e_step(points, log_area(points), start, CONFIG.inlier_share)
    for candidate in range(2):
        np.testing.assert_allclose(
            np.exp(posterior.log_density[candidate]), naive_density(points, start, candidate), rtol=1e-12
        )


@pytest.mark.parametrize("update", [COORDINATE, JOINT])
@pytest.mark.parametrize("seed", range(10))
def test_likelihood_never_falls(seed: int, update: str) -> None:
    points = np.vstack([grid_points(5, 3, 4.0, seed), np.random.default_rng(seed).uniform(-200, 200, (4, 2))])
    mixture = initial_mixture(points, np.array([[3, 5], [2, 5], [4, 4]]), CONFIG)
    last = np.full(3, -np.inf)
    for _ in range(60):
        posterior = e_step(points, log_area(points), mixture, CONFIG.inlier_share)
        likelihood = posterior.log_density.sum(axis=1)
        # Rounding of some hundred summed logarithms.
        assert (likelihood >= last - 1e-9).all()
        last, mixture = likelihood, m_step(points, posterior, mixture, CONFIG, update)


def test_noise_free_grid_is_found_exactly() -> None:
    points = grid_points(5, 3, 0.0, 0)
    start = initial_mixture(points, np.array([[3, 5]]), CONFIG)
    near = fit_mixture(points, log_area(points), start, CONFIG, COORDINATE)
    fit = fit_mixture(points, log_area(points), near, CONFIG, JOINT)
    # At the floor of the variance no other cell takes part.
    np.testing.assert_allclose(fit.pitch[0], [70.0, 55.0], atol=1e-6)
    np.testing.assert_allclose(fit.origin[0], [-90.0, -130.0], atol=1e-6)
    assert fit.converged[0]


def test_order_of_points_does_not_matter() -> None:
    points = grid_points(6, 3, 2.0, 3)
    order = np.random.default_rng(0).permutation(len(points))
    sizes = np.array([[3, 6], [2, 7]])
    one, other = (
        fit_mixture(p, log_area(p), initial_mixture(p, sizes, CONFIG), CONFIG, COORDINATE)
        for p in (points, points[order])
    )
    np.testing.assert_allclose(one.pitch, other.pitch, rtol=1e-7)
    np.testing.assert_allclose(one.log_likelihood, other.log_likelihood, rtol=1e-7)


def test_candidates_fitted_together_equal_those_fitted_alone() -> None:
    points = grid_points(4, 3, 2.0, 5)
    sizes = np.array([[3, 4], [2, 4], [4, 6]])
    together = fit_mixture(points, log_area(points), initial_mixture(points, sizes, CONFIG), CONFIG, COORDINATE)
    for k, size in enumerate(sizes):
        alone = fit_mixture(points, log_area(points), initial_mixture(points, size[None], CONFIG), CONFIG, COORDINATE)
        np.testing.assert_allclose(alone.log_likelihood[0], together.log_likelihood[k], rtol=1e-9)
    assert together.log_likelihood.argmax() == 0
