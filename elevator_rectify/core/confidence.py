"""How far a fit can be trusted, and whether it may be used."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from elevator_rectify.core.config import AcceptConfig
from elevator_rectify.core.detections import Usable
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.lattice import sizes
from elevator_rectify.core.lattice.layout import LayoutFit
from elevator_rectify.core.types import Array, FitResult

# Written by `python3 -m elevator_rectify calibrate`.
COEFFICIENTS = Path(__file__).with_name("confidence.json")
FEATURES = (
    "ln inliers",
    "inlier share",
    "occupancy",
    "margin",
    "nats an inlier",
    "ln sigma ratio",
    "ln rotation std",
    "free lines an inlier",
    "few inliers",
    "tilt",
    "ln aspect squared",
    "two lines",
    "ln cells",
    "nats",
    "ln detections",
    *sizes.FEATURES,
)
_MARGIN_NATS = 15.0
_NATS = 50.0
_FARTHEST_STD = 2.5


@dataclass(frozen=True)
class Evidence:
    """What speaks for a fit: shares in [0, 1], residual in pitches, rotation uncertainty in radians."""

    inlier_share: float
    occupancy: float
    rms_pitch: float
    rotation_std_rad: float


def confidence(evidence: Evidence, config: AcceptConfig) -> float:
    """Return a score in [0, 1]: how far within the limits the weakest piece of evidence is."""
    excess = [
        (1.0 - evidence.inlier_share) / (1.0 - config.min_inlier_share + 1e-9),
        (1.0 - evidence.occupancy) / (1.0 - config.min_occupancy + 1e-9),
        evidence.rms_pitch / config.max_rms_pitch,
        evidence.rotation_std_rad / config.max_rotation_std_rad,
    ]
    # At a limit the confidence is 0.8, the default threshold of the joint method's.
    worst = max(excess)
    return float(1.0 / (1.0 + 0.25 * worst**2)) if np.isfinite(worst) else 0.0


def refusal(evidence: Evidence, config: AcceptConfig) -> tuple[str, str] | None:
    """Return status and reason of the first limit that the evidence misses, or None."""
    checks = [
        (
            "no_lattice",
            "detections on the grid",
            evidence.inlier_share,
            evidence.inlier_share < config.min_inlier_share,
        ),
        ("no_lattice", "filled cells", evidence.occupancy, evidence.occupancy < config.min_occupancy),
        ("no_lattice", "rms residual in pitches", evidence.rms_pitch, not evidence.rms_pitch <= config.max_rms_pitch),
        (
            "uncertain",
            "rotation std in rad",
            evidence.rotation_std_rad,
            not evidence.rotation_std_rad <= config.max_rotation_std_rad,
        ),
        (
            "low_confidence",
            "confidence",
            confidence(evidence, config),
            confidence(evidence, config) < config.min_confidence,
        ),
    ]
    for status, name, number, missed in checks:
        if missed:
            return status, f"{name} {number:.3g} misses its limit"
    return None


def rotation_std_rad(covariance: Array) -> float:
    """Return the standard deviation of the rotation about its least certain axis; infinite where undetermined."""
    if not np.isfinite(covariance).all():
        return float("inf")
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(covariance[3:, 3:])[-1])))


def features(fit: LayoutFit, margin: float, sigma: float, found: FitResult, usable: Usable, camera: Camera) -> Array:
    """Return what the confidence of a joint fit is computed from, in the order of FEATURES."""
    inliers = float((fit.inlier > 0.5).sum())
    layout = fit.layout
    free = (
        len(layout.row_breaks)
        + len(layout.column_breaks)
        + float(layout.row_stagger.sum() + layout.column_stagger.sum())
    )
    filled = np.count_nonzero(np.bincount(fit.node[fit.inlier > 0.5]))
    lines = len(layout.rows), len(layout.columns)
    return np.array(
        [
            np.log(max(inliers, 1.0)),
            inliers / len(fit.inlier),
            filled / layout.cells,
            min(margin, _MARGIN_NATS) / _MARGIN_NATS,
            fit.log_likelihood / max(inliers, 1.0) / 5.0,
            np.log(fit.sigma / sigma),
            np.log(np.clip(rotation_std_rad(found.covariance), 1e-4, 3.0)),
            free / max(inliers, 1.0),
            1.0 / max(inliers - 3.0, 1.0),
            np.arccos(min(1.0, abs(fit.pose.R[0, 2, 2]))),
            fit.pose.log_aspect[0] ** 2,
            float(min(lines) == 2),
            np.log(lines[0] * lines[1]),
            fit.log_likelihood / _NATS,
            np.log(len(fit.inlier)),
            *sizes.size_features(found, usable.index, usable.telling_sizes_px, camera),
        ]
    )


def expanded(x: Array, mean: Array, std: Array) -> Array:
    """Return (..., P) a constant, the standardised features (..., F) and their products two by two, bounded."""
    # Beyond what was seen in calibration, nothing is extrapolated.
    z = np.clip((x - mean) / std, -_FARTHEST_STD, _FARTHEST_STD)
    one, other = np.triu_indices(z.shape[-1])
    return np.concatenate([np.ones((*z.shape[:-1], 1)), z, z[..., one] * z[..., other]], axis=-1)


@cache
def _model(path: Path) -> tuple[Array, Array, Array]:
    """Return the features' means and standard deviations, and the logistic model's coefficients."""
    table = json.loads(path.read_text())
    mean, std = np.array(list(table["features"].values())).T
    return mean, std, np.array(table["coefficients"])


def logistic_confidence(x: Array, model: Path) -> float:
    """Return the probability that a fit with these features is right, by a file that `calibrate` wrote."""
    mean, std, coefficients = _model(model)
    return float(1.0 / (1.0 + np.exp(-np.clip(expanded(x, mean, std) @ coefficients, -30.0, 30.0))))
