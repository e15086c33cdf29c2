"""Learning rate over the steps, and the moving average of the weights."""

from __future__ import annotations

import copy
import math

import torch

_WARM_UP = 300


def learning_rate(step: int, steps: int, peak: float) -> float:
    """Return the rate: a linear warm-up, then a half cosine down to a hundredth of the peak."""
    if step < _WARM_UP:
        return peak * (step + 1) / _WARM_UP
    done = (step - _WARM_UP) / max(1, steps - _WARM_UP)
    return peak * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(1.0, done))))


class Average:
    """Exponential moving average of a network's weights; the average is what is used in the end."""

    def __init__(self, net: torch.nn.Module, decay: float = 0.9993) -> None:
        self.net = copy.deepcopy(net).eval()
        self.decay = decay

    def update(self, net: torch.nn.Module, step: int) -> None:
        """Move the average towards the weights, faster in the first steps."""
        decay = min(self.decay, (1 + step) / (20 + step))
        with torch.no_grad():
            for mine, new in zip(self.net.state_dict().values(), net.state_dict().values(), strict=True):
                if mine.dtype.is_floating_point:
                    mine.lerp_(new, 1 - decay)
                else:
                    mine.copy_(new)
