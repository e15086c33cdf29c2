"""The reader's network: from a patch of one button to its kind and its characters."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from elevator_rectify.core.reading.reader import PATCH_PX
from elevator_rectify.core.reading.vocabulary import BLANK, KINDS, SLOTS
from elevator_rectify.train.detector_net import convolution

# Channels of what is told of a view, over sides of an eighth of the view's.
_TOLD = 32


class ReaderNet(nn.Module):
    """Input (B, 3, 96, 96), normalised colours; output (B, K + 4 C) logits of kind and slots.

    Two views of half the side are read by the same layers: the whole patch at half the resolution, which shows symbols
    and plates whole, and its middle at full resolution, for a small print in a large cap.
    """

    def __init__(self) -> None:
        super().__init__()
        pool = nn.MaxPool2d(2)
        self.halve = nn.AvgPool2d(2)
        self.layers = nn.Sequential(
            convolution(3, 32, 2, size=5),
            convolution(32, 48), pool,
            convolution(48, 96), convolution(96, 96), pool,
            convolution(96, 160), convolution(160, _TOLD, size=1),
        )  # fmt: skip
        self.drop = nn.Dropout(0.15)
        self.hidden = nn.Linear(2 * _TOLD * (PATCH_PX // 16) ** 2, 256)
        self.out = nn.Linear(256, len(KINDS) + SLOTS * (BLANK + 1))

    def forward(self, x: Tensor) -> Tensor:
        """Map patches to logits."""
        quarter = PATCH_PX // 4
        wide, close = self.halve(x), x[:, :, quarter : 3 * quarter, quarter : 3 * quarter]
        y = torch.cat([self.layers(wide), self.layers(close)], dim=1).flatten(1)
        out: Tensor = self.out(self.drop(torch.relu(self.hidden(self.drop(y)))))
        return out
