"""Checkpoints: written in one piece every few minutes, read where there is one."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import torch

from elevator_rectify.train.schedule import Average

_SECONDS = 120.0


class Checkpoint:
    """The state of a training in a file."""

    def __init__(self, path: Path, net: torch.nn.Module, average: Average, optimiser: torch.optim.Optimizer) -> None:
        self._path, self._net, self._average, self._optimiser = path, net, average, optimiser
        self._saved = time.time()

    def load(self) -> int:
        """Read the file where it exists; return the step to go on from."""
        if not self._path.exists():
            return 0
        state = torch.load(self._path, weights_only=True)
        self._net.load_state_dict(state["net"])
        self._average.net.load_state_dict(state["average"])
        self._optimiser.load_state_dict(state["optimiser"])
        return int(state["step"])

    def save(self, step: int, now: bool = False) -> None:
        """Write the file where the last one is some minutes old, or `now`."""
        if not now and time.time() - self._saved < _SECONDS:
            return
        state: dict[str, Any] = {
            "net": self._net.state_dict(),
            "average": self._average.net.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "step": step,
        }
        part = self._path.with_suffix(".part")
        torch.save(state, part)
        part.replace(self._path)
        self._saved = time.time()
