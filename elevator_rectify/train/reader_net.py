"""The reader's network: from a patch of one button to its kind and its characters."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from elevator_rectify.core.reading.vocabulary import BLANK, KINDS, SLOTS
from elevator_rectify.train.detector_net import convolution

# Side of a patch, pixels.
PATCH = 48


class ReaderNet(nn.Module):
    """Input (B, 1, 48, 48), grey, of mean 0 and standard deviation 1; output (B, K + 4 C) logits of kind and slots."""

    def __init__(self) -> None:
        super().__init__()
        pool = nn.MaxPool2d(2)
        self.layers = nn.Sequential(
            convolution(1, 20), pool,
            convolution(20, 40), pool,
            convolution(40, 80), convolution(80, 80), pool,
            convolution(80, 128), convolution(128, 48, size=1),
        )  # fmt: skip
        self.drop = nn.Dropout(0.3)
        self.hidden = nn.Linear(48 * 6 * 6, 256)
        self.out = nn.Linear(256, len(KINDS) + SLOTS * (BLANK + 1))

    def forward(self, x: Tensor) -> Tensor:
        """Map patches to logits."""
        y = self.layers(x).flatten(1)
        out: Tensor = self.out(self.drop(torch.relu(self.hidden(self.drop(y)))))
        return out
