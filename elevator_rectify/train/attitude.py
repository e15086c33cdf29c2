"""Train what tells how prints stand: `python -m elevator_rectify.train.attitude DATA`; resumes from its last
checkpoint."""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import cross_entropy

from elevator_rectify.core.reading.attitude import ATTITUDES, put, shrunk
from elevator_rectify.core.reading.reader import MARGIN, PATCH_PX
from elevator_rectify.core.types import Array, Image
from elevator_rectify.train.attitude_net import AttitudeNet
from elevator_rectify.train.loop import Batch, add_training, train
from elevator_rectify.train.patches import cut_patch, drawn_patch, font_files, random_text, spoilt_patch
from elevator_rectify.train.reader import Source, samples_of, weights_of

# Kinds that do not tell how they stand; the side of drawn patches.
_UNREAD = ("unreadable", "other", "empty")
_DRAWN_PX = 128
# Around a box so many times its size are turned with it.
_AROUND = 1.5


def batch_of(source: Source, number: int, rng: np.random.Generator) -> Batch:
    """Return patches (B, 1, 48, 48), and how to put each upright (B,).

    Turned and mirrored before they are cut and spoilt: how that is done must not tell how they stand.
    """
    patches, ways = [], rng.integers(ATTITUDES, size=number)
    for k, way in zip(rng.choice(len(source.samples), number, p=source.weights), ways, strict=True):
        image, box = _turned(*_sample(source, k, rng), int(way))
        patches.append(shrunk(spoilt_patch(cut_patch(image, box, PATCH_PX, rng), rng)))
    # Of turns the reverse is undone by; of mirrored ones, themselves.
    undone = np.where(ways < 4, -ways % 4, ways)
    return torch.from_numpy(np.stack(patches)), torch.from_numpy(undone)


def _sample(source: Source, k: int, rng: np.random.Generator) -> tuple[Image, Array]:
    """Return the picture and box of a sample, now and then of a drawn button instead."""
    if rng.random() >= source.drawn:
        return source.samples[k][:2]
    edge = (1.0 - 1.0 / MARGIN) * _DRAWN_PX / 2.0
    box = np.array([edge, edge, _DRAWN_PX - edge, _DRAWN_PX - edge])
    return drawn_patch(random_text(rng), _DRAWN_PX, rng, source.fonts), box


def _turned(image: Image, box_px: Array, way: int) -> tuple[Image, Array]:
    """Return the box's part of the picture, and the box in it, put another way."""
    size = box_px[2:] - box_px[:2]
    low = np.maximum(box_px[:2] - _AROUND * size, 0).astype(int)
    high = np.minimum(box_px[2:] + _AROUND * size + 1, [image.shape[1], image.shape[0]]).astype(int)
    part = put(image[low[1] : high[1], low[0] : high[0]], way)
    # About the part's middle.
    corners = (box_px - np.tile(low + high, 2) / 2.0).reshape(2, 2)
    if way >= 4:
        corners = corners * np.array([-1.0, 1.0])
    for _ in range(way % 4):
        # Counterclockwise by a quarter, as np.rot90 does.
        corners = corners[:, ::-1] * np.array([1.0, -1.0])
    middle = np.array([part.shape[1], part.shape[0]]) / 2.0
    return part, np.concatenate([corners.min(axis=0) + middle, corners.max(axis=0) + middle])


def main() -> None:
    """Read the command line and train."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_training(parser, "attitude", steps=5000, batch=64, rate=2e-3)
    parser.add_argument("--drawn", type=float, default=0.15, help="share of drawn patches")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.manual_seed(args.seed)
    samples = [s for s in samples_of(args.data, None if args.all else False) if s[2] not in _UNREAD]
    source, net = Source(samples, weights_of(samples), args.drawn, font_files()), AttitudeNet()

    def loss_of(batch: Batch) -> Tensor:
        patches, way = batch
        flipped = torch.flip(patches, (3,))
        put_all = [torch.rot90(x, k, (2, 3)) for x in (patches, flipped) for k in range(4)]
        return cross_entropy(net(torch.cat(put_all)).reshape(ATTITUDES, -1).T, way)

    train(net, partial(batch_of, source, args.batch), loss_of, args, decay=1e-2)


if __name__ == "__main__":
    main()
