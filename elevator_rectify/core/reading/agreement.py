"""One answer from several frames: a button counts as found where enough of the last frames agree on its place."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.reading.target import Choice
from elevator_rectify.core.types import Array, BoolArray

MOST_FRAMES, LONGEST_SECONDS = 1000, 3600.0
_AGREEING, _OF = 5, 7
# 99.7 % of chi squared with three degrees of freedom; places are not told apart below so many metres.
_LARGEST_CHI2, _SAME_M = 14.16, 0.001


@dataclass(frozen=True)
class Request:
    """What is asked for: a label, within seconds, in `agreeing` of the last `of` frames; 0: the usual."""

    label: str
    timeout_s: float
    agreeing: int = _AGREEING
    of: int = _OF
    max_lateral_std_m: float = 0.0

    def problem(self) -> str:
        """Return what of it cannot be used: field, value, and what would be; '' where all can."""
        if not 0.0 < self.timeout_s <= LONGEST_SECONDS:
            return f"timeout_s must lie in (0, {LONGEST_SECONDS:g}], not {self.timeout_s!r}"
        if not 1 <= self.agreeing <= self.of <= MOST_FRAMES:
            return f"1 <= agreeing <= of <= {MOST_FRAMES} must hold, not {self.agreeing} of {self.of}"
        if not 0.0 <= self.max_lateral_std_m < np.inf:
            return f"max_lateral_std_m must be a length, not {self.max_lateral_std_m!r}"
        return ""

    def usual(self) -> Request:
        """Return the request with the usual numbers of frames where none is given."""
        return replace(self, agreeing=_AGREEING, of=_OF) if self.agreeing == self.of == 0 else self


@dataclass(frozen=True)
class Look:
    """What one frame says: the choice, and the button's place (3,) and covariance (3, 3), in the same frame for all."""

    choice: Choice
    place: Array | None = None
    covariance: Array | None = None


@dataclass(frozen=True)
class Verdict:
    """The answer: status and reason; chosen: index of the look amid those that agree, -1 for a refusal."""

    status: str
    reason: str = ""
    chosen: int = -1
    agreed: int = 0

    @property
    def succeeds(self) -> bool:
        """Tell whether the button was found."""
        return self.chosen >= 0


def verdict(looks: Sequence[Look], request: Request) -> Verdict | None:
    """Return the answer that the last looks, `request.of` at most, give, or None where more are needed.

    A refusal needs `request.of` frames, all with an accepted panel: one that is not seen yet may still be.
    """
    chosen, agreed = _amid(looks)
    if agreed >= request.agreeing:
        return Verdict("found", "", chosen, agreed)
    if len(looks) < request.of or any(look.choice.status == "no_panel" for look in looks):
        return None
    return replace(_refused(looks, request), agreed=agreed)


def timed_out(looks: Sequence[Look], request: Request) -> Verdict:
    """Return the answer when there is no more time."""
    if not looks:
        return Verdict("no_frames", f"no frame was answered within {request.timeout_s:g} s")
    refused, agreed = _refused(looks, request), _amid(looks)[1]
    return replace(refused, reason=f"within {request.timeout_s:g} s: {refused.reason}", agreed=agreed)


def _refused(looks: Sequence[Look], request: Request) -> Verdict:
    """Return the commonest refusal, with the newest reason."""
    found = sum(look.place is not None for look in looks)
    if found >= request.agreeing:
        return Verdict("unsteady", f"{found} frames found {request.label}, but not at one place: is the camera moving?")
    refused = [look.choice for look in looks if look.place is None]
    if not refused:
        return Verdict("no_frames", f"{len(looks)} frames were answered, {request.agreeing} must agree")
    status = Counter(choice.status for choice in reversed(refused)).most_common(1)[0][0]
    return Verdict(status, next(c.reason for c in reversed(refused) if c.status == status))


def _amid(looks: Sequence[Look]) -> tuple[int, int]:
    """Return the look that most others agree with, of several the one amid them, and how many agree with it."""
    found = [k for k, look in enumerate(looks) if look.place is not None]
    if not found:
        return -1, 0
    agree, distance = _agreeing([looks[k] for k in found])
    best = min(range(len(found)), key=lambda k: (-int(agree[k].sum()), float(distance[k][agree[k]].sum())))
    return found[best], int(agree[best].sum())


def _agreeing(looks: Sequence[Look]) -> tuple[BoolArray, Array]:
    """Return which of the looks (N, N) have the same place within their covariances, and their distances (N, N)."""
    places = np.array([look.place for look in looks], dtype=float)
    covariance = np.array([look.covariance for look in looks], dtype=float)
    apart = places[:, None] - places[None]
    both = covariance[:, None] + covariance[None] + _SAME_M**2 * np.eye(3)
    chi2 = np.einsum("ijk,ijk->ij", apart, np.linalg.solve(both, apart[..., None])[..., 0])
    return np.asarray(chi2 <= _LARGEST_CHI2), np.linalg.norm(apart, axis=-1)
