"""The centres-only oracle: least squares with every true lattice position known, and the information limit."""

from __future__ import annotations

import numpy as np

from elevator_rectify.core.config import JointConfig
from elevator_rectify.core.lattice.refinement import Poses, gauss_newton, jacobians, stepped
from elevator_rectify.core.types import Array
from elevator_rectify.render.scene import Scene

# The oracle has no opinion on the pitch ratio.
_FLAT = JointConfig(log_aspect_std=10.0)
_STEPS = 15


def true_lattice(scene: Scene) -> tuple[Array, Array]:
    """Return the true detections' rays (M, 2) and their true lattice positions (M, 2) = (column, row)."""
    real = scene.button >= 0
    pitch = np.array(scene.panel.pitch_m)
    return scene.camera.rays(scene.centres_px)[real], scene.panel.points_m[scene.button[real], :2] / pitch


def true_pose(scene: Scene, centre: Array) -> Poses:
    """Return the true pose, referred to a lattice point (2,)."""
    pitch = np.array(scene.panel.pitch_m)
    t = (scene.R_camera_panel[:, :2] @ (centre * pitch) + scene.t_camera_panel) / pitch[0]
    aspect = np.log(pitch[1] / pitch[0])
    return Poses(scene.R_camera_panel[None], t[None], np.array([aspect]), centre[None], np.zeros(1))


def oracle_rotation(scene: Scene) -> Array:
    """Return the least-squares rotation (3, 3), from the truth on."""
    rays, lattice = true_lattice(scene)
    pose, weights = true_pose(scene, lattice.mean(axis=0)), np.ones((1, len(rays)))
    for _ in range(_STEPS):
        predicted, J, _ = jacobians(pose, lattice[None])
        pose = stepped(pose, gauss_newton(J, rays - predicted, weights, np.array([1e-3]), pose.log_aspect, _FLAT))
    return np.asarray(pose.R[0])


def cramer_rao_rad(scene: Scene, sigma_px: float) -> float:
    """Return the root of the summed rotation variances that no unbiased estimate of these centres can beat."""
    _, lattice = true_lattice(scene)
    _, J, _ = jacobians(true_pose(scene, lattice.mean(axis=0)), lattice[None])
    flat = J.reshape(-1, 7) / (sigma_px / scene.camera.focal_px)
    return float(np.sqrt(np.trace(np.linalg.pinv(flat.T @ flat)[3:6, 3:6])))
