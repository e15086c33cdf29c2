"""The network that tells whether a button's lamp is lit."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import adaptive_avg_pool2d, adaptive_max_pool2d

from elevator_rectify.train.detector_net import convolution


class LitNet(nn.Module):
    """Input (B, 9, 24, 24): a button beside the panel's others (`core.lamps.lit.beside_others`); output (B, 1)."""

    def __init__(self) -> None:
        super().__init__()
        self.patch = nn.Sequential(convolution(9, 24, 2), convolution(24, 48), convolution(48, 48, 2))
        self.lit = nn.Sequential(nn.Dropout(0.3), nn.Linear(96, 48), nn.ReLU(inplace=True), nn.Dropout(0.3))
        self.odds = nn.Linear(48, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Map patches (B, 9, 24, 24) to log odds (B, 1)."""
        seen = self.patch(x)
        pooled = torch.cat([adaptive_avg_pool2d(seen, 1), adaptive_max_pool2d(seen, 1)], dim=1).flatten(1)
        out: Tensor = self.odds(self.lit(pooled))
        return out
