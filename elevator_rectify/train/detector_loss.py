"""What the detector's network is to say of a crop, and how far it is from it."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from elevator_rectify.train.augment import Crop
from elevator_rectify.train.detector_net import STRIDE

Array = NDArray[np.float32]
# Spread of the heat around a centre, over the box's size, and its floor in cells.
_HEAT_SIGMA = 0.15
_HEAT_SIGMA_CELLS = 0.75
# Cells within this share of the box's size around its centre learn its sides.
_CORE = 0.2


def targets(crop: Crop) -> tuple[Array, Array, Array, Array]:
    """Return heat (2, h, w), its weights (2, h, w), boxes (4, h, w) in pixels and their weights (h, w)."""
    cells = crop.image.shape[0] // STRIDE
    y, x = (np.mgrid[0:cells, 0:cells].astype(np.float32) + 0.5) * STRIDE
    heat, weight = np.zeros((2, cells, cells), np.float32), np.ones((2, cells, cells), np.float32)
    sides, side_weight = np.zeros((4, cells, cells), np.float32), np.zeros((cells, cells), np.float32)
    order = np.argsort(-np.prod(crop.boxes_px[:, 2:] - crop.boxes_px[:, :2], axis=1))
    for k in order:
        x0, y0, x1, y1 = crop.boxes_px[k]
        if not crop.learnt[k]:
            weight[:, (x > x0 - 2) & (x < x1 + 2) & (y > y0 - 2) & (y < y1 + 2)] = 0
            continue
        dx, dy = x - (x0 + x1) / 2, y - (y0 + y1) / 2
        sx, sy = (max(_HEAT_SIGMA * s, _HEAT_SIGMA_CELLS * STRIDE) for s in (x1 - x0, y1 - y0))
        channel = 0 if crop.is_button[k] else 1
        spot = np.exp(-0.5 * ((dx / sx) ** 2 + (dy / sy) ** 2))
        i, j = np.unravel_index(int(spot.argmax()), spot.shape)
        spot[i, j] = 1.0
        heat[channel] = np.maximum(heat[channel], spot)
        core = (np.abs(dx) <= max(STRIDE, _CORE * (x1 - x0))) & (np.abs(dy) <= max(STRIDE, _CORE * (y1 - y0)))
        sides[:, core] = np.array([x0, y0, x1, y1], np.float32)[:, None]
        side_weight[core] = 1.0 / max(1, int(core.sum()))
    return heat, weight, sides, side_weight


def predicted_boxes(output: Tensor) -> Tensor:
    """Return (B, 4, h, w) boxes in pixels from the network's output (B, 6, h, w)."""
    h, w = output.shape[-2:]
    y = (torch.arange(h, dtype=output.dtype)[:, None] + 0.5) * STRIDE
    x = (torch.arange(w, dtype=output.dtype)[None, :] + 0.5) * STRIDE
    d = torch.exp(output[:, 2:].clamp(-3, 5)) * STRIDE
    return torch.stack([x - d[:, 0], y - d[:, 1], x + d[:, 2], y + d[:, 3]], dim=1)


def heat_loss(logits: Tensor, heat: Tensor, weight: Tensor) -> Tensor:
    """Return the focal loss of centre points (Zhou et al., "Objects as Points", equation 1), per button."""
    p = torch.sigmoid(logits).clamp(1e-5, 1 - 1e-5)
    positive = (heat >= 0.9999).float() * weight
    gain = -positive * (1 - p) ** 2 * torch.log(p)
    cost = -(1 - positive) * weight * (1 - heat) ** 4 * p**2 * torch.log(1 - p)
    # Other things are fewer, more varied, and mistaken for buttons: they weigh more.
    share = torch.tensor([1.0, 1.5])[None, :, None, None]
    total: Tensor = ((gain + cost) * share).sum() / positive.sum().clamp(min=1.0)
    return total


def box_loss(boxes: Tensor, true: Tensor, weight: Tensor) -> Tensor:
    """Return 1 - the generalised intersection over union (Rezatofighi et al. 2019), weighted mean over the cells."""

    def area(b: Tensor) -> Tensor:
        return (b[:, 2] - b[:, 0]).clamp(min=0) * (b[:, 3] - b[:, 1]).clamp(min=0)

    inner = torch.cat([torch.maximum(boxes[:, :2], true[:, :2]), torch.minimum(boxes[:, 2:], true[:, 2:])], dim=1)
    outer = torch.cat([torch.minimum(boxes[:, :2], true[:, :2]), torch.maximum(boxes[:, 2:], true[:, 2:])], dim=1)
    both = area(inner)
    union = area(boxes) + area(true) - both
    hull = area(outer)
    giou = both / union.clamp(min=1e-3) - (hull - union) / hull.clamp(min=1e-3)
    total: Tensor = ((1 - giou) * weight).sum() / weight.sum().clamp(min=1e-3)
    return total
