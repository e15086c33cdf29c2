"""Figures that remember: every rate and median of a run with its sampling error, as JSON, and what changed since."""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import elevator_rectify

# A change is told where it is beyond so many standard errors of the difference.
_BEYOND = 2.0
_BOOTSTRAPS = 200


@dataclass(frozen=True)
class Figure:
    """A figure with its sampling error (one standard deviation) and the number of draws; kind: 'rate' or 'median'."""

    value: float
    error: float
    draws: int
    kind: str


class Figures:
    """The figures of one run, by name; a name ends with what is better: '+' for more, '-' for less."""

    def __init__(self) -> None:
        self.table: dict[str, Figure] = {}

    def rate(self, name: str, hits: Sequence[bool] | Any) -> None:
        """Add the share of hits; the error is that with one more hit and one more miss (Agresti and Coull)."""
        flags = np.asarray(hits, dtype=bool)
        if len(flags):
            p = (flags.sum() + 1.0) / (len(flags) + 2.0)
            error = float(np.sqrt(p * (1.0 - p) / (len(flags) + 2.0)))
            self.table[name] = Figure(float(flags.mean()), error, len(flags), "rate")

    def share(self, name: str, hits: int, of: int) -> None:
        """Add a share that is known as two counts."""
        self.rate(name, np.arange(of) < hits)

    def median(self, name: str, values: Sequence[float] | Any) -> None:
        """Add the median of the finite values; the error is bootstrapped."""
        x = np.asarray(values, dtype=float)
        x = x[np.isfinite(x)]
        if len(x):
            rng = np.random.default_rng(0)
            again = np.median(rng.choice(x, (_BOOTSTRAPS, len(x))), axis=1)
            self.table[name] = Figure(float(np.median(x)), float(again.std()), len(x), "median")

    def write(self, path: Path, **settings: Any) -> None:
        """Write all figures with versions and settings (seeds, reference time) as JSON."""
        versions = {
            "elevator_rectify": elevator_rectify.__version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "opencv": cv2.__version__,
        }
        figures = {
            name: {**asdict(f), "value": round(f.value, 5), "error": round(f.error, 5)}
            for name, f in sorted(self.table.items())
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({"versions": versions, "settings": settings, "figures": figures}, indent=1) + "\n")


def read_figures(path: Path) -> dict[str, Figure]:
    """Return the figures of a JSON that `Figures.write` wrote. Raises ValueError where it is none."""
    try:
        return {name: Figure(**entry) for name, entry in json.loads(path.read_text())["figures"].items()}
    except (OSError, KeyError, TypeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path} holds no figures: {error!r}") from error


@dataclass(frozen=True)
class Change:
    """A figure now and before; sigmas: the change over its standard error, positive where it is better now."""

    name: str
    before: Figure
    now: Figure

    @property
    def sigmas(self) -> float:
        """Return by how many standard errors the figure is better."""
        error = float(np.hypot(self.before.error, self.now.error))
        better = -1.0 if self.name.endswith("-") else 1.0
        return better * (self.now.value - self.before.value) / max(error, 1e-9)

    @property
    def worse(self) -> bool:
        """Tell whether it got worse beyond its sampling error."""
        return self.sigmas < -_BEYOND

    def __str__(self) -> str:
        """Return the line of the comparison."""
        return f"{self.name:<52}{self.before.value:>9.4f}{self.now.value:>9.4f}{self.sigmas:>+8.1f}"


def changes(before: dict[str, Figure], now: dict[str, Figure]) -> list[Change]:
    """Return the changes of the figures that both have, by name."""
    return [Change(name, before[name], now[name]) for name in sorted(before.keys() & now.keys())]


def comparison(before: dict[str, Figure], now: dict[str, Figure]) -> tuple[str, bool]:
    """Return what changed beyond its sampling error as text, and whether a rate got worse."""
    both = changes(before, now)
    moved = [c for c in both if abs(c.sigmas) > _BEYOND]
    lines = [f"{len(both)} figures compared, {len(moved)} changed by more than {_BEYOND:g} standard errors"]
    if moved:
        lines += [f"{'figure':<52}{'before':>9}{'now':>9}{'sigmas':>8}", *(str(c) for c in moved)]
    lost = sorted(before.keys() - now.keys())
    if lost:
        lines.append(f"not measured now: {', '.join(lost)}")
    return "\n".join(lines), any(c.worse and c.now.kind == "rate" for c in both)
