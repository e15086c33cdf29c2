"""The network that tells how a button's print stands: upright, turned or mirrored."""

from __future__ import annotations

from torch import Tensor, nn

from elevator_rectify.train.detector_net import convolution


class AttitudeNet(nn.Module):
    """Input (B, 1, 48, 48), output (B, 1): how much the patch looks upright; what counts is by how much more than the
    same patch turned and mirrored."""

    def __init__(self) -> None:
        super().__init__()
        self.features = nn.Sequential(
            convolution(1, 16, 2), convolution(16, 32, 2), convolution(32, 48, 2), convolution(48, 64, 2)
        )
        self.said = nn.Sequential(nn.Conv2d(64, 32, 3), nn.ReLU(inplace=True), nn.Conv2d(32, 1, 1))

    def forward(self, x: Tensor) -> Tensor:
        """Map patches (B, 1, 48, 48) to (B, 1)."""
        out: Tensor = self.said(self.features(x)).flatten(1)
        return out
