import numpy as np
import pytest

from elevator_rectify.core.config import MotionConfig
from elevator_rectify.core.geometry.rotations import rotation
from elevator_rectify.core.paper.motion import estimate_motion, jacobian, no_motion, transform
from elevator_rectify.core.types import Array
from test.scenes import rotation_error_deg


def project(references: Array, R: Array, t: Array, delta: Array) -> Array:
    """The perturbed motion, as erratum 2 has it: the whole point is turned from the left."""
    points = np.column_stack([references, np.ones(len(references))]) @ R.T + t
    points = points @ rotation(delta[:3]).T + delta[3:]
    return np.asarray(points[:, :2] / points[:, 2:])


@pytest.mark.parametrize("seed", range(5))
def test_jacobian_equals_central_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    references, R, t = rng.uniform(-0.5, 0.5, (12, 2)), rotation(rng.normal(0, 0.4, 3)), rng.normal(0, 0.1, 3)
    at, depth = project(references, R, t, np.zeros(6)), (np.column_stack([references, np.ones(12)]) @ R.T + t)[:, 2]
    h = 1e-6
    numeric = np.stack(
        [(project(references, R, t, h * e) - project(references, R, t, -h * e)) / (2 * h) for e in np.eye(6)], axis=-1
    )
    # h^2 truncation and rounding / h.
    np.testing.assert_allclose(jacobian(at, depth), numeric, atol=2e-9)
    assert np.abs(jacobian(at, depth, printed=True) - numeric).max() > 1e-2, "erratum 1 is one"


@pytest.mark.parametrize("seed", range(20))
def test_motion_of_projected_grid_is_recovered(seed: int) -> None:
    rng = np.random.default_rng(seed)
    j, i = np.meshgrid(np.linspace(-0.3, 0.3, 4), np.linspace(-0.5, 0.5, 6))
    references = np.column_stack([j.ravel(), i.ravel()])
    R, t = rotation(rng.normal(0, 0.25, 3)), rng.normal(0, 0.1, 3)
    observed = project(references, R, t, np.zeros(6))
    motion = estimate_motion(references, observed, np.ones(24), no_motion(), MotionConfig(max_iterations=200))
    assert motion.converged
    # R and t separately are determined by a full plane's image up to rounding.
    assert rotation_error_deg(motion.R, R) < 1e-4
    assert np.linalg.norm(motion.t - t) < 1e-6
    np.testing.assert_allclose(transform(motion.plane_map, references), observed, atol=1e-8)
