import numpy as np
import pytest

from elevator_rectify.core.geometry.pose import (
    LatticePose,
    lattice_jacobian,
    on_plane,
    pose_covariance,
    pose_from_homography,
    scale_pose_covariance,
)
from elevator_rectify.core.geometry.rotations import rotation
from elevator_rectify.core.types import Array
from test.scenes import rotation_error_deg

LATTICE = np.stack(np.meshgrid(np.arange(3.0), np.arange(6.0)), axis=-1).reshape(-1, 2)


def random_pose(seed: int) -> LatticePose:
    rng = np.random.default_rng(seed)
    return LatticePose(rotation(rng.normal(0, 0.4, 3)), np.array([-1.0, -3.0, 9.0]), float(np.exp(rng.normal(0, 0.2))))


def image(pose: LatticePose, delta: Array) -> Array:
    moved = LatticePose(rotation(delta[3:6]) @ pose.R, pose.t + delta[:3], pose.aspect * np.exp(delta[6]))
    points = moved.camera_points(LATTICE)
    return np.asarray(points[:, :2] / points[:, 2:])


@pytest.mark.parametrize("seed", range(5))
def test_jacobian_equals_central_differences(seed: int) -> None:
    pose, h = random_pose(seed), 1e-6
    numeric = np.stack([(image(pose, h * e) - image(pose, -h * e)) / (2 * h) for e in np.eye(7)], axis=-1)
    np.testing.assert_allclose(lattice_jacobian(LATTICE, pose), numeric, atol=2e-9)


@pytest.mark.parametrize("sign", [1.0, -3.0])
def test_homography_of_a_pose_gives_the_pose(sign: float) -> None:
    pose = random_pose(3)
    G = sign * np.column_stack([pose.R[:, 0], pose.aspect * pose.R[:, 1], pose.t])
    found = pose_from_homography(G)
    assert rotation_error_deg(found.R, pose.R) < 1e-6
    np.testing.assert_allclose(found.t, pose.t, atol=1e-9)
    assert found.aspect == pytest.approx(pose.aspect)


def test_covariance_predicts_the_spread_of_least_squares() -> None:
    pose, sigma, rng = random_pose(1), 1e-3, np.random.default_rng(0)
    J = lattice_jacobian(LATTICE, pose).reshape(-1, 7)
    draws = np.linalg.pinv(J) @ rng.normal(0, sigma, (len(J), 4000))
    predicted = pose_covariance(LATTICE, pose, np.ones(len(LATTICE)), sigma)
    # 4000 draws give a variance to 2.2 %; five of these.
    np.testing.assert_allclose(np.cov(draws)[:6, :6].diagonal(), predicted.diagonal(), rtol=0.12)


def test_one_row_has_no_finite_covariance() -> None:
    row = np.column_stack([np.arange(8.0), np.zeros(8)])
    assert np.isinf(pose_covariance(row, random_pose(0), np.ones(8), 1e-3)).all()


def test_scale_uncertainty_moves_the_translation_along_itself() -> None:
    t, covariance = np.array([0.0, 0.0, 10.0]), np.eye(6) * 1e-6
    scaled = scale_pose_covariance(covariance, t, 0.045, 0.002)
    assert np.sqrt(scaled[2, 2]) == pytest.approx(10 * 0.002, rel=1e-3)
    assert scaled[3, 3] == pytest.approx(1e-6)


def test_rays_meet_the_plane_where_its_points_are() -> None:
    R, t = rotation(np.array([0.4, -0.3, 0.1])), np.array([0.1, -0.2, 2.0])
    plane = np.random.default_rng(3).uniform(-0.5, 0.5, (20, 2))
    points = plane @ R[:, :2].T + t
    found, depth = on_plane(R, t, points[:, :2] / points[:, 2:])
    np.testing.assert_allclose(found, plane, atol=1e-12)
    np.testing.assert_allclose(depth, points[:, 2], rtol=1e-12)
