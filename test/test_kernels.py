"""The compiled kernels: each does what its NumPy function does. Without numba they run as they are written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
import pytest

from elevator_rectify.core.compiled import COMPILED
from elevator_rectify.core.config import Config
from elevator_rectify.core.geometry.rotations import rotation_angle_rad, rotations
from elevator_rectify.core.lattice import hypotheses, pose_kernels, refinement
from elevator_rectify.core.lattice import kernels as of_lattice
from elevator_rectify.core.lattice import layout as of_layout
from elevator_rectify.core.lattice.layout import Layout, LayoutFit, evaluate, refine_layout
from elevator_rectify.core.lattice.refinement import Poses, projected
from elevator_rectify.core.picture import kernels as of_picture
from elevator_rectify.core.picture import measured, template
from elevator_rectify.core.picture.template import feature, make_template
from elevator_rectify.core.types import Array
from elevator_rectify.core.warm_up import warm_up

JOINT = Config().joint
AREA, SIGMA = 0.7, 0.01
T = TypeVar("T")


def both(monkeypatch: pytest.MonkeyPatch, do: Callable[[], T]) -> tuple[T, T]:
    """Return what is done in NumPy and by the kernels."""
    done = []
    for by_kernels in (False, True):
        for module in (hypotheses, refinement, of_layout, measured, template):
            monkeypatch.setattr(module, "COMPILED", by_kernels)
        done.append(do())
    return done[0], done[1]


def drawn(seed: int) -> tuple[LayoutFit, Array, Array]:
    """Return a fit near noisy points (N, 2) of a layout with breaks and staggers, and the ln of their sizes (N,)."""
    rng = np.random.default_rng(seed)
    rows, columns = np.arange(float(rng.integers(2, 7))), np.arange(float(rng.integers(2, 5)))
    breaks = (1,) if rng.random() < 0.5 else ()
    stagger = (rng.random(len(rows)) < 0.3).astype(float)
    layout = Layout(rows, columns, stagger, np.zeros(len(columns)), breaks, (1,) if rng.random() < 0.3 else ())
    turn, at = rotations(rng.normal(0, 0.4, (1, 3))), np.array([[0.3, -0.2, 9.0]])
    pose = Poses(turn, at, np.array([0.1]), np.array([[columns.mean(), rows.mean()]]), np.zeros(1))
    x, _, depth = projected(pose, layout.nodes.reshape(1, -1, 2))
    rays = np.concatenate([x[0] + rng.normal(0, SIGMA / 2, x[0].shape), rng.uniform(-0.5, 0.5, (3, 2))])
    sizes = np.append(-1.5 * np.log(depth[0]) + rng.normal(0, 0.05, len(depth[0])), [np.nan, 0.3, -0.3])
    off = replace(pose, R=rotations(rng.normal(0, 0.05, (1, 3))) @ turn, t=at + 0.05, log_aspect=pose.log_aspect - 0.05)
    return evaluate(off, layout, rays, 2 * SIGMA, AREA, JOINT), rays, sizes


def assert_alike(one: LayoutFit, other: LayoutFit) -> None:
    """Assert that they are equal to a billionth: sums are added up in another order."""
    assert rotation_angle_rad(one.pose.R[0].T @ other.pose.R[0]) < 1e-9
    np.testing.assert_allclose(one.pose.t, other.pose.t, atol=1e-9)
    np.testing.assert_array_equal(one.node, other.node)
    np.testing.assert_allclose(one.inlier, other.inlier, atol=1e-9)
    np.testing.assert_allclose(one.layout.nodes, other.layout.nodes, atol=1e-9)
    numbers = [np.array([f.sigma, f.log_likelihood, f.size_nats]) for f in (one, other)]
    np.testing.assert_allclose(numbers[0], numbers[1], rtol=1e-8)


@pytest.mark.parametrize("seed", range(8))
def test_a_layout_is_evaluated_and_refined_alike(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    fit, rays, sizes = drawn(seed)
    given = (rays, SIGMA, AREA, JOINT)
    assert_alike(*both(monkeypatch, lambda: evaluate(fit.pose, fit.layout, *given)))
    for log_sizes in (None, sizes):
        assert_alike(*both(monkeypatch, partial(refine_layout, fit, *given, 4, log_sizes)))


@pytest.mark.parametrize("seed", range(8))
def test_points_and_their_derivatives_are_alike(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    fit, rays, _ = drawn(seed)
    lattice = fit.layout.nodes.reshape(1, -1, 2)
    for do in (partial(refinement.jacobians, fit.pose, lattice), partial(of_layout.design, fit, rays)):
        for one, other in zip(*both(monkeypatch, do), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-12)


def test_many_poses_are_stepped_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = [drawn(seed)[0] for seed in range(3)]
    rays = drawn(0)[1]
    poses = refinement.joined(*(f.pose for f in fits))
    cells = refinement.nearest_cells(poses.maps, poses.brick, rays)[0]
    inlier = np.random.default_rng(1).uniform(0, 1, cells.shape[:2])
    for huber in (np.inf, 2.0 * SIGMA):
        sigma = np.full(len(fits), SIGMA)
        for points in (rays, np.stack([rays, rays + SIGMA, rays - SIGMA])):
            given = (poses, cells, inlier, points, sigma, JOINT, huber)
            one, other = both(monkeypatch, partial(refinement.towards, *given))
            for name in ("R", "t", "log_aspect"):
                np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-9)


def test_seeds_are_supported_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    rays = drawn(3)[1]
    origins, bases = hypotheses.affine_seeds(rays, Config().hypotheses)
    brick = np.asarray(np.arange(len(origins)) % 2.0, dtype=float)
    one, other = both(monkeypatch, partial(hypotheses.seed_support, rays, origins, bases, brick))
    # Sums in single precision.
    np.testing.assert_allclose(one, other, atol=1e-5)


def test_far_ones_are_left_out_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(4)
    cells, inlier = np.round(rng.normal(0, 4, (5, 12, 2))), rng.uniform(0, 1, (5, 12))
    one, other = both(monkeypatch, partial(refinement.connected, cells, inlier))
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("seed", range(4))
def test_the_steps_towards_places_are_alike(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    fit, rays, _ = drawn(seed)
    on = fit.inlier > 0.5
    seen = replace(fit, node=fit.node[on], inlier=fit.inlier[on])
    root = np.random.default_rng(seed).normal(0, 50.0, (on.sum(), 2, 2))
    weight = np.asarray(root @ np.swapaxes(root, 1, 2), dtype=float)
    moved = both(monkeypatch, lambda: measured._moved_to(seen, rays[on], weight, JOINT, 3))
    assert_alike(*moved)
    for a, b in zip(*both(monkeypatch, lambda: measured._in_lattice(moved[0], rays[on])), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_patches_are_aligned_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    look = np.hypot(*(np.mgrid[-9:10, -9:10][:, None] - rng.uniform(-1, 1, (2, 6, 1, 1))))
    patches = (200.0 * (look < 6) + rng.normal(0, 4, look.shape)).astype(np.float32)
    inside = np.ones(patches.shape, dtype=bool)
    inside[5, :, 14:] = False
    features = feature(patches, 0.6)
    common = make_template(features, inside, 0.7, 0.6)
    one, other = both(monkeypatch, lambda: template.align(common, features, inside))
    # Sums of some hundred single precision numbers.
    for a, b in ((one.shift, other.shift), (one.correlation, other.correlation)):
        np.testing.assert_allclose(a, b, atol=2e-5)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-3, atol=1e-6)


@pytest.mark.skipif(not COMPILED, reason="numba is not installed")
def test_every_kernel_is_compiled_once_and_for_all() -> None:
    """What is compiled for other types of arguments would hold up a frame for seconds."""
    warm_up(Config())
    called: dict[str, Any] = {
        **{name: getattr(of_lattice, name) for name in ("support", "connected", "explained", "refined")},
        **{name: getattr(of_picture, name) for name in ("in_lattice", "placed", "aligned")},
        "steps_towards": pose_kernels.steps_towards,
    }
    assert {name: kernel.signatures for name, kernel in called.items() if len(kernel.signatures) != 1} == {}
