"""Train the detector: `python -m elevator_rectify.train.detector DATA`; resumes from its last checkpoint."""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np
import torch

from elevator_rectify.train.augment import random_crop
from elevator_rectify.train.detector_loss import box_loss, heat_loss, predicted_boxes, targets
from elevator_rectify.train.detector_net import DetectorNet
from elevator_rectify.train.labelled import LabelledPicture, read_labelled
from elevator_rectify.train.loop import Batch, add_training, train

_BOX_WEIGHT = 2.0


def batch_of(pictures: list[LabelledPicture], size: int, number: int, rng: np.random.Generator) -> Batch:
    """Return images (B, 3, S, S) in RGB / 255 and the targets of `number` random crops."""
    crops = [random_crop(pictures[rng.integers(len(pictures))], size, rng) for _ in range(number)]
    images = np.stack([np.ascontiguousarray(c.image[..., ::-1].transpose(2, 0, 1)) for c in crops])
    rest = [np.stack(part) for part in zip(*(targets(c) for c in crops), strict=True)]
    return torch.from_numpy(images).float() / 255, *(torch.from_numpy(part) for part in rest)


def main() -> None:
    """Read the command line and train."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_training(parser, "detector", steps=30000, batch=8, rate=3e-3)
    parser.add_argument("--size", type=int, default=288, help="side of the crops, a multiple of 32")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.manual_seed(args.seed)
    net, pictures = DetectorNet(), read_labelled(args.data, None if args.all else False)

    def loss_of(batch: Batch) -> torch.Tensor:
        images, heat, weight, sides, side_weight = batch
        output = net(images)
        of_heat = heat_loss(output[:, :2], heat, weight)
        return of_heat + _BOX_WEIGHT * box_loss(predicted_boxes(output), sides, side_weight)

    train(net, partial(batch_of, pictures, args.size, args.batch), loss_of, args, decay=1e-3)


if __name__ == "__main__":
    main()
