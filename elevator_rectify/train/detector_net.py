"""The detector's network: a heat map of centres (buttons, other things) and the distances to the four sides."""

from __future__ import annotations

from torch import Tensor, nn

# Pixels of the input per cell of the output.
STRIDE = 4


def convolution(inputs: int, outputs: int, stride: int = 1, groups: int = 1, size: int = 3) -> nn.Sequential:
    """Return a convolution with batch normalisation and rectifier."""
    layer = nn.Conv2d(inputs, outputs, size, stride, size // 2, groups=groups, bias=False)
    return nn.Sequential(layer, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


class Separable(nn.Module):
    """A depthwise and a pointwise convolution, with a short cut where the shape stays."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            convolution(inputs, inputs, stride, groups=inputs), convolution(inputs, outputs, size=1)
        )
        self.keeps_shape = inputs == outputs and stride == 1

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, C, H, W) to (B, C', H / stride, W / stride)."""
        y: Tensor = self.layers(x)
        return x + y if self.keeps_shape else y


def stage(inputs: int, outputs: int, blocks: int) -> nn.Sequential:
    """Return blocks of which the first halves the resolution."""
    return nn.Sequential(Separable(inputs, outputs, 2), *(Separable(outputs, outputs) for _ in range(blocks - 1)))


class DetectorNet(nn.Module):
    """Encoder to stride 32 and decoder to stride 4; input RGB / 255, output (B, 6, H / 4, W / 4).

    Channels: logits of the heat of buttons and of other things, ln of the distances to left, top, right and bottom
    side over the stride.
    """

    def __init__(self) -> None:
        super().__init__()
        self.to_4 = nn.Sequential(convolution(3, 24, 2), convolution(24, 48, 2))
        self.to_8 = stage(48, 108, 3)
        self.to_16 = stage(108, 192, 4)
        self.to_32 = stage(192, 240, 4)
        self.from_32 = convolution(240, 192, size=1)
        self.at_16 = Separable(192, 192)
        self.from_16 = convolution(192, 108, size=1)
        self.at_8 = Separable(108, 108)
        self.from_8 = convolution(108, 48, size=1)
        # At this resolution a full convolution costs as much as all that comes before it.
        self.at_4 = nn.Sequential(Separable(48, 64), Separable(64, 64))
        self.head = nn.Conv2d(64, 6, 1)
        self.up = nn.Upsample(scale_factor=2, mode="nearest")
        nn.init.constant_(self.head.bias, 0.0)
        self.head.bias.data[:2] = -4.0
        self.head.bias.data[2:] = 1.0

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, 3, H, W), H and W multiples of 32, to (B, 6, H / 4, W / 4)."""
        x4 = self.to_4(x)
        x8 = self.to_8(x4)
        x16 = self.to_16(x8)
        x32 = self.to_32(x16)
        y16 = self.at_16(x16 + self.up(self.from_32(x32)))
        y8 = self.at_8(x8 + self.up(self.from_16(y16)))
        y4 = self.at_4(x4 + self.up(self.from_8(y8)))
        out: Tensor = self.head(y4)
        return out
