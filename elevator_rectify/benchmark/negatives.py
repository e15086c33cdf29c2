"""Detections without a panel: what must not be accepted."""

from __future__ import annotations

import numpy as np

from elevator_rectify.core.config import Config
from elevator_rectify.core.geometry.rotations import rotation_angle_rad
from elevator_rectify.core.pipeline import fit_panel
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.types import Array, Detection
from elevator_rectify.render.scene import paper_camera

# Both lattices face the camera; noise turns the pose by less than this.
_WRONG_RAD = float(np.deg2rad(12.0))
_SIZE = np.array([640.0, 480.0])


def uniform(rng: np.random.Generator) -> Array:
    """Return points anywhere."""
    return rng.uniform(0, _SIZE, (int(rng.integers(6, 41)), 2))


def clustered(rng: np.random.Generator) -> Array:
    """Return points in a few heaps."""
    centres = rng.uniform(60, _SIZE - 60, (int(rng.integers(2, 5)), 2))
    number = int(rng.integers(6, 41))
    return np.asarray(
        np.clip(centres[rng.integers(len(centres), size=number)] + rng.normal(0, 25, (number, 2)), 0, _SIZE - 1)
    )


def collinear(rng: np.random.Generator) -> Array:
    """Return points on one line, some pixels off."""
    ends = rng.uniform(0, _SIZE, (2, 2))
    s = np.sort(rng.uniform(0, 1, (int(rng.integers(6, 21)), 1)), axis=0)
    points = ends[0] + s * (ends[1] - ends[0]) + rng.normal(0, 2.0, (len(s), 2))
    return np.asarray(np.clip(points, 0, _SIZE - 1))


def curves(rng: np.random.Generator) -> Array:
    """Return points along a circle's arc or a parabola."""
    s = np.linspace(0, 1, int(rng.integers(6, 25)))
    centre, radius, start, span = (
        rng.uniform(150, 330, 2),
        rng.uniform(60, 200),
        rng.uniform(0, 6.28),
        rng.uniform(1.5, 6.28),
    )
    arc = centre + radius * np.column_stack([np.cos(start + span * s), np.sin(start + span * s)])
    parabola = np.column_stack([600 * s + 20, 100 + rng.uniform(300, 1200) * (s - rng.uniform(0.3, 0.7)) ** 2])
    points = (arc if rng.random() < 0.5 else parabola) + rng.normal(0, 1.5, (len(s), 2))
    return np.asarray(np.clip(points, 0, _SIZE - 1))


def boxes(rng: np.random.Generator) -> Array:
    """Return the box centres of a crowd: a few sizes, loosely in a row."""
    number = int(rng.integers(6, 20))
    return np.asarray(
        np.clip(np.column_stack([rng.uniform(20, 620, number), 240 + rng.normal(0, 60, number)]), 0, _SIZE - 1)
    )


KINDS = {"uniform": uniform, "clustered": clustered, "collinear": collinear, "curves": curves, "crowd": boxes}


def overlapping(rng: np.random.Generator) -> Array:
    """Return two frontal lattices of different pitch and place, one over the other."""
    grids = []
    for pitch in (rng.uniform(35, 45), rng.uniform(50, 70)):
        rows, columns = rng.integers(3, 6, 2)
        at = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
        grids.append(at * pitch + rng.uniform(80, 200, 2))
    points = np.vstack(grids)
    return np.asarray(points + rng.normal(0, 1.0, points.shape))


def run_overlapping(seed: int, number: int) -> bool:
    """Tell whether a fit to two overlapping lattices was accepted with a pose that neither of them has."""
    fit = fit_panel(overlapping(np.random.default_rng([seed, number])), paper_camera(), Config())
    return fit.ok and rotation_angle_rad(fit.R_camera_panel) > _WRONG_RAD


def boxed(points: Array, rng: np.random.Generator) -> list[Detection]:
    """Return boxes about points (N, 2) px, all of one size but for a detector's errors."""
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1) + np.diag(np.full(len(points), np.inf))
    usual = rng.uniform(0.4, 0.8) * float(np.median(apart.min(axis=1)))
    sizes = usual * np.exp(rng.normal(0.0, 0.06, (len(points), 2)))
    return [Detection(float(x), float(y), float(w), float(h)) for (x, y), (w, h) in zip(points, sizes, strict=True)]


def run_negative(kind: str, seed: int, number: int) -> GridFit:
    """Fit one draw."""
    rng = np.random.default_rng([seed, number, list(KINDS).index(kind)])
    return fit_panel(KINDS[kind](rng), paper_camera(), Config())
