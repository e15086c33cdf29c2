"""Panels of one to five buttons: the errors of the pose by their outlines, with and without straight edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.pictures import few_pictured
from elevator_rectify.core.config import Config, with_values
from elevator_rectify.core.geometry.rotations import rotation_angle_rad
from elevator_rectify.core.pipeline import fit_panel
from elevator_rectify.core.types import Array, FitResult

_WRONG_DEG = 4.0
_SHAPES = ("round", "square")


@dataclass(frozen=True)
class FewTrial:
    """Errors of the normal in degrees, of the best pose and of the better of two; of the rotation; 180 where there is
    none."""

    error_deg: float
    better_deg: float
    rotation_deg: float
    status: str


def run_few(task: tuple[str, int, int, int, bool]) -> FewTrial:
    """Fit one panel: (shape, buttons, seed, number, with straight edges)."""
    shape, buttons, seed, number, edges = task
    scene, image = few_pictured(shape, buttons, seed, number, held_out=True)
    fit = fit_panel(scene.detections, scene.camera, with_values(Config(), {"outline.edges": edges}), image=image)
    errors = [_error_deg(f, scene.R_camera_panel[:, 2]) for f in (fit, *fit.alternatives)]
    rotation = 180.0
    if np.isfinite(fit.R_camera_panel).all():
        rotation = float(np.rad2deg(rotation_angle_rad(fit.R_camera_panel.T @ scene.R_camera_panel)))
    return FewTrial(errors[0], min(errors), rotation, fit.status)


def _error_deg(fit: FitResult, normal: Array) -> float:
    if not np.isfinite(fit.R_camera_panel).all():
        return 180.0
    return float(np.rad2deg(np.arccos(np.clip(fit.R_camera_panel[:, 2] @ normal, -1.0, 1.0))))


def few_table(trials: int, seed: int, figures: Figures) -> str:
    """Return the table of held-out looks."""
    lines = [
        f"{'buttons':<10}{'edges':>6}{'med deg':>9}{'< 3 deg':>9}{'better of two':>15}{'accept':>8}{'ambiguous':>11}"
        f"{'accepted, normal':>18}{'and rotation > 4 deg':>22}"
    ]
    for edges in (False, True):
        for shape in _SHAPES:
            for buttons in (1, 2, 3, 4, 5):
                tasks = [(shape, buttons, seed, n, edges) for n in range(trials)]
                results = parallel(run_few, tasks, f"{buttons} {shape}")
                error = np.array([r.error_deg for r in results])
                better = np.median([r.better_deg for r in results])
                accepted = np.array([r.status == "ok" for r in results])
                wrong = 100.0 * np.mean(accepted & (error > _WRONG_DEG))
                askew = 100.0 * np.mean(accepted & (np.array([r.rotation_deg for r in results]) > _WRONG_DEG))
                ambiguous = np.mean([r.status == "ambiguous" for r in results])
                name = f"{buttons} {shape} {'with' if edges else 'without'} edges"
                figures.rate(f"{name} within 3 deg+", error < 3)
                figures.rate(f"{name} accepted and normal wrong-", accepted & (error > _WRONG_DEG))
                lines.append(
                    f"{buttons} {shape:<8}{'with' if edges else 'no':>6}{np.median(error):>9.2f}"
                    f"{np.mean(error < 3):>9.2f}{better:>15.2f}{accepted.mean():>8.2f}{ambiguous:>11.2f}"
                    f"{wrong:>16.2f} %{askew:>20.2f} %"
                )
    return "\n".join(lines)
