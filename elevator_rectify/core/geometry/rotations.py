"""Rotations: matrices, vectors and angles."""

from __future__ import annotations

import cv2
import numpy as np

from elevator_rectify.core.types import Array

# vector @ _CROSS is its cross product matrix, row by row.
_CROSS = np.array([[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0.0]])


def rotation_angle_rad(R: Array) -> float:
    """Return the angle of a rotation matrix (3, 3), exact near zero too."""
    skew = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.arctan2(np.linalg.norm(skew), np.trace(R) - 1.0))


def rotation(vector: Array) -> Array:
    """Return the rotation matrix (3, 3) of a rotation vector (3,) in radians."""
    return np.asarray(cv2.Rodrigues(np.asarray(vector, dtype=float))[0])


def rotations(vectors: Array) -> Array:
    """Return (B, 3, 3) rotations of vectors (B, 3) (Rodrigues)."""
    angle = np.sqrt((vectors * vectors).sum(axis=1))[:, None, None]
    K = (vectors @ _CROSS).reshape(-1, 3, 3) / np.where(angle > 1e-12, angle, 1.0)
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K))
