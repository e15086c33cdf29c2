"""The reader's network: from a patch of one button to its kind and its characters."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import adaptive_avg_pool2d, gelu, interpolate, relu

from elevator_rectify.core.reading.reader import PATCH_PX
from elevator_rectify.core.reading.vocabulary import BLANK, KINDS, SLOTS

# Channels of the last block, its height and width over a view of half a patch's side, and channels of what is told.
_LAST, _HEIGHT, _WIDTH, _TOLD = 384, PATCH_PX // 32, PATCH_PX // 16, 48
_HIDDEN = 256


def normed(channels: int, out: int, size: int, stride: int | tuple[int, int] = 1, **more: int) -> nn.Sequential:
    """Return a convolution with batch normalisation."""
    return nn.Sequential(nn.Conv2d(channels, out, size, stride, **more), nn.BatchNorm2d(out))


class Stem(nn.Module):
    """Input (B, 3, H, W), output (B, 96, H / 4, W / 4): two ways at half the size, put together."""

    def __init__(self) -> None:
        super().__init__()
        self.first = normed(3, 48, 3, 2, padding=1)
        self.narrow, self.wide = normed(48, 24, 2, padding=1), normed(24, 48, 2, padding=1)
        self.quarter, self.mix = normed(96, 48, 3, 2, padding=1), normed(48, 96, 1)
        self.pool = nn.MaxPool2d(2, 1, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """Map a view to its first features."""
        x = relu(self.first(x))
        # Windows of two look to the right and down: the first ones, which look to the left and up, are left out.
        seen = relu(self.wide(relu(self.narrow(x))[:, :, 1:, 1:]))[:, :, 1:, 1:]
        both = torch.cat([self.pool(x)[:, :, 1:, 1:], seen], dim=1)
        return relu(self.mix(relu(self.quarter(both))))


class Squeeze(nn.Module):
    """Weighs the channels by what all of the view has of each (Hu et al. 2018)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.few = nn.Conv2d(channels, channels // 4, 1)
        self.all = nn.Conv2d(channels // 4, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Return the features weighted."""
        weight: Tensor = self.all(relu(self.few(adaptive_avg_pool2d(x, 1))))
        # Spread over the view first: OpenCV 4.6 multiplies by one number a channel in batches of one alone.
        return x * interpolate(weight.clamp(0.0, 1.0), scale_factor=tuple(float(n) for n in x.shape[2:]))

    def hard_sigmoid(self) -> None:
        """Let weights that were learnt for a hard sigmoid, which is this over six about a half, do without it."""
        self.all.weight.data.div_(6.0)
        if self.all.bias is not None:
            self.all.bias.data.div_(6.0).add_(0.5)


class Block(nn.Module):
    """A depthwise convolution, then two of single pixels around a rectifier: the block of RepViT (Wang et al. 2024)."""

    def __init__(
        self,
        channels: int,
        out: int = 0,
        stride: int | tuple[int, int] = 1,
        squeeze: bool = False,
        smooth: bool = False,
    ) -> None:
        super().__init__()
        self.adds, self.rectify = not out, gelu if smooth else relu
        self.across = normed(channels, channels, 3, stride, padding=1, groups=channels)
        self.squeeze = Squeeze(channels) if squeeze else nn.Identity()
        self.up, self.down = normed(channels, 2 * channels, 1), normed(2 * channels, out or channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Map features to features."""
        x = self.squeeze(self.across(x))
        y: Tensor = self.down(self.rectify(self.up(x)))
        return x + y if self.adds else y


class TextFeatures(nn.Module):
    """What a view shows: the layers of PP-OCRv6's small recogniser, whose weights they begin with (`pretrained`).

    Input (B, 3, H, W), output (B, 384, H / 16, W / 8). as_published: with the rectifiers and the wider features of the
    recogniser (W / 4), which take OpenCV three times as long.
    """

    def __init__(self, as_published: bool = False) -> None:
        super().__init__()
        smooth = as_published
        self.stem = Stem()
        self.blocks = nn.Sequential(
            *(Block(96, squeeze=k == 0, smooth=smooth) for k in range(3)),
            Block(96, 192, (2, 1) if as_published else (2, 2), smooth=smooth),
            *(Block(192, squeeze=k % 2 == 0, smooth=smooth) for k in range(6)),
            Block(192, _LAST, (2, 1), smooth=smooth),
        )

    def forward(self, x: Tensor) -> Tensor:
        """Map a view to its features."""
        out: Tensor = self.blocks(self.stem(x))
        return out


class ReaderNet(nn.Module):
    """Input (B, 3, 96, 96), normalised colours; output (B, K + 4 C) logits of kind and slots.

    Two views of half the side are read by the same layers: the whole patch at half the resolution, which shows symbols
    and plates whole, and its middle at full resolution, for a small print in a large cap.
    """

    def __init__(self) -> None:
        super().__init__()
        self.features = TextFeatures()
        self.halve = nn.AvgPool2d(2)
        self.tell, self.drop = normed(_LAST, _TOLD, 1), nn.Dropout(0.15)
        self.hidden = nn.Linear(2 * _TOLD * _HEIGHT * _WIDTH, _HIDDEN)
        self.out = nn.Linear(_HIDDEN, len(KINDS) + SLOTS * (BLANK + 1))

    def views(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return the whole patch at half the resolution, and its middle at the full one."""
        quarter = PATCH_PX // 4
        return self.halve(x), x[:, :, quarter : 3 * quarter, quarter : 3 * quarter]

    def _told(self, view: Tensor) -> Tensor:
        return relu(self.tell(self.features(view))).flatten(1)

    def forward(self, x: Tensor) -> Tensor:
        """Map patches to logits."""
        y = torch.cat([self._told(view) for view in self.views(x)], dim=1)
        out: Tensor = self.out(self.drop(torch.relu(self.hidden(self.drop(y)))))
        return out
