"""Trials on generated panels: success, honesty and time, beside the oracle."""

from __future__ import annotations

import time
from dataclasses import dataclass

import cv2
import numpy as np

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.oracle import cramer_rao_rad, oracle_rotation
from elevator_rectify.core.config import Config, with_values
from elevator_rectify.core.geometry.rotations import rotation_angle_rad
from elevator_rectify.core.pipeline import fit_panel
from elevator_rectify.core.types import Array, FitResult
from elevator_rectify.recordings.evaluate import cells_right
from elevator_rectify.render.levels import LEVELS, random_scene
from elevator_rectify.render.scene import Scene

SUCCESS_DEG, RIGHT_CELLS = 2.0, 0.95
# 95 % of a chi-squared variable of three degrees of freedom.
CHI2_3 = 7.815


@dataclass(frozen=True)
class Trial:
    """One fit beside the truth; errors in degrees, `detections` counted, `coverage` None where there is no pose."""

    error_deg: float
    oracle_deg: float
    bound_deg: float
    cells: float
    accepted: bool
    confidence: float
    mahalanobis2: float
    metric: float
    milliseconds: float
    detections: int

    @property
    def right(self) -> bool:
        """Tell whether the fit is no gross error: rotation within reach of the noise."""
        return self.error_deg <= max(4.0, 4.0 * self.bound_deg)


def run_trial(level: str, seed: int, number: int, method: str) -> Trial:
    """Fit one generated scene."""
    scene = random_scene(LEVELS[level], seed, number)
    config = with_values(Config(), {"method": method})
    start = time.perf_counter()
    fit = fit_panel(scene.centres_px, scene.camera, config)
    elapsed = 1e3 * (time.perf_counter() - start)
    return judged(scene, fit, elapsed)


def judged(scene: Scene, fit: FitResult, milliseconds: float) -> Trial:
    """Compare a fit with its scene's truth."""
    truth, real = scene.R_camera_panel, scene.button >= 0
    found = bool(np.isfinite(fit.R_camera_panel).all())
    button = scene.button[real]
    share = cells_right(fit.cells[real], scene.panel.cells[button], scene.panel.blocks[button]) if found else 0.0
    return Trial(
        error_deg=float(np.rad2deg(rotation_angle_rad(fit.R_camera_panel.T @ truth))) if found else 180.0,
        oracle_deg=float(np.rad2deg(rotation_angle_rad(oracle_rotation(scene).T @ truth))),
        bound_deg=float(np.rad2deg(cramer_rao_rad(scene, scene.detector.sigma_px))),
        cells=share,
        accepted=fit.ok,
        confidence=fit.confidence,
        mahalanobis2=_mahalanobis2(fit, truth) if found else float("nan"),
        metric=fit.cost_x1000,
        milliseconds=milliseconds,
        detections=len(scene.button),
    )


def _mahalanobis2(fit: FitResult, truth: Array) -> float:
    """Return the squared length of the rotation's error in its own covariance."""
    error = cv2.Rodrigues(truth @ fit.R_camera_panel.T)[0].ravel()
    covariance = fit.covariance[3:, 3:]
    return float(error @ np.linalg.solve(covariance, error)) if np.isfinite(covariance).all() else float("nan")


def oracle_row(level: str, trials: list[Trial]) -> str:
    """Return the oracle's line of the table."""
    errors = np.array([t.oracle_deg for t in trials])
    return f"{level:<8}{'oracle':<17}{np.mean(errors < SUCCESS_DEG):>8.3f}{1.0:>7.3f}" + (
        f"{np.median(errors):>8.2f}{np.percentile(errors, 95):>8.2f}"
    )


HEADER = (
    f"{'level':<8}{'method':<17}{'success':>8}{'cells':>7}{'med deg':>8}{'p95':>8}{'rmse/or':>8}{'metric':>8}"
    f"{'accept':>8}{'gross %':>8}{'cover':>7}{'ece':>7}{'med ms':>8}{'p95 ms':>8}{'p95/warp':>9}"
)


def table_row(level: str, method: str, trials: list[Trial], yardstick_ms: float) -> str:
    """Return one line of the table."""
    error = np.array([t.error_deg for t in trials])
    cells = np.array([t.cells >= RIGHT_CELLS for t in trials])
    oracle = np.array([t.oracle_deg for t in trials])
    accepted = [t for t in trials if t.accepted]
    gross = 100.0 * np.mean([not t.right for t in accepted]) if accepted else np.nan
    d2 = np.array([t.mahalanobis2 for t in accepted if t.right])
    ms = np.array([t.milliseconds for t in trials])
    ratio = np.sqrt((error[cells] ** 2).mean() / (oracle[cells] ** 2).mean()) if cells.any() else np.nan
    found = error < 180.0
    return (
        f"{level:<8}{method:<17}{np.mean((error < SUCCESS_DEG) & cells):>8.3f}{cells.mean():>7.3f}"
        f"{np.median(error):>8.2f}{np.percentile(error, 95):>8.2f}{ratio:>8.3f}"
        f"{np.nanmedian([t.metric for t in trials]) if found.any() else np.nan:>8.4f}"
        f"{len(accepted) / len(trials):>8.3f}{gross:>8.2f}{np.mean(d2 < CHI2_3) if len(d2) else np.nan:>7.3f}"
        f"{calibration_error(trials):>7.3f}{np.median(ms):>8.1f}{np.percentile(ms, 95):>8.1f}"
        f"{np.percentile(ms, 95) / yardstick_ms:>9.1f}"
    )


def record(figures: Figures, name: str, trials: list[Trial]) -> None:
    """Add what a table's line says, as far as it has a sampling error."""
    figures.rate(f"{name} success+", [t.error_deg < SUCCESS_DEG and t.cells >= RIGHT_CELLS for t in trials])
    figures.rate(f"{name} cells right+", [t.cells >= RIGHT_CELLS for t in trials])
    figures.rate(f"{name} accepted+", [t.accepted for t in trials])
    figures.rate(f"{name} gross error among accepted-", [not t.right for t in trials if t.accepted])
    figures.rate(f"{name} coverage+", [t.mahalanobis2 < CHI2_3 for t in trials if t.accepted and t.right])
    figures.median(f"{name} error deg-", [t.error_deg for t in trials])


def calibration_error(trials: list[Trial], bins: int = 10) -> float:
    """Return the expected calibration error of the confidence."""
    p = np.array([t.confidence for t in trials])
    right = np.array([t.right and t.cells >= RIGHT_CELLS for t in trials])
    place = np.minimum((p * bins).astype(int), bins - 1)
    return float(
        sum(abs(p[place == b].mean() - right[place == b].mean()) * np.mean(place == b) for b in np.unique(place))
    )


def yardstick_ms(repeats: int = 50) -> float:
    """Return the median milliseconds of one cv2.warpPerspective of a 640 x 480 colour image, on one thread."""
    image = np.random.default_rng(0).integers(0, 255, (480, 640, 3), dtype=np.uint8)
    H = np.array([[0.9, 0.1, 20.0], [-0.05, 1.1, 10.0], [1e-4, 2e-4, 1.0]])
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        cv2.warpPerspective(image, H, (640, 480))
        times.append(1e3 * (time.perf_counter() - start))
    return float(np.median(times))
