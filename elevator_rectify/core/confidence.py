"""How far a fit can be trusted, and whether it may be used."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elevator_rectify.core.config import AcceptConfig


@dataclass(frozen=True)
class Evidence:
    """What speaks for a fit: shares in [0, 1], residual in pitches, rotation uncertainty in radians."""

    inlier_share: float
    occupancy: float
    rms_pitch: float
    rotation_std_rad: float


def confidence(evidence: Evidence, config: AcceptConfig) -> float:
    """Return a score in [0, 1]: how far within the limits the weakest piece of evidence is (1/2: at a limit)."""
    excess = [
        (1.0 - evidence.inlier_share) / (1.0 - config.min_inlier_share + 1e-9),
        (1.0 - evidence.occupancy) / (1.0 - config.min_occupancy + 1e-9),
        evidence.rms_pitch / config.max_rms_pitch,
        evidence.rotation_std_rad / config.max_rotation_std_rad,
    ]
    worst = max(excess)
    return float(1.0 / (1.0 + worst**2)) if np.isfinite(worst) else 0.0


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
