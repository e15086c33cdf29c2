"""Train the detector: `python -m elevator_rectify.train.detector DATA`; resumes from its last checkpoint."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import torch

from elevator_rectify.train.augment import Crop, random_crop
from elevator_rectify.train.detector_loss import box_loss, heat_loss, predicted_boxes, targets
from elevator_rectify.train.detector_net import DetectorNet
from elevator_rectify.train.labelled import LabelledPicture, read_labelled
from elevator_rectify.train.loop import Batch, add_training, train
from elevator_rectify.train.second_look import NOTHING_SEEN, SecondLook, read_second_look

_BOX_WEIGHT, DECAY = 2.0, 1e-3
# The share of the crops that show what was taken for a button and is none.
_AT_NO_BUTTON = 0.15


@dataclass(frozen=True)
class Source:
    """The pictures that crops are cut from, and what a second look at them added."""

    pictures: list[LabelledPicture]
    looks: dict[str, SecondLook]

    @cached_property
    def with_no_button(self) -> list[LabelledPicture]:
        """Return the pictures that show something that was taken for a button and is none."""
        return [p for p in self.pictures if len(self.look(p).no_button_px)]

    def look(self, picture: LabelledPicture) -> SecondLook:
        """Return what a second look at the picture added."""
        return self.looks.get(picture.name, NOTHING_SEEN)

    def crop(self, size: int, rng: np.random.Generator) -> Crop:
        """Cut a random crop out of a random picture."""
        at_no_button = bool(self.with_no_button) and rng.random() < _AT_NO_BUTTON
        pictures = self.with_no_button if at_no_button else self.pictures
        picture = pictures[rng.integers(len(pictures))]
        return random_crop(picture, size, rng, self.look(picture), at_no_button)


def batch_of(source: Source, size: int, number: int, rng: np.random.Generator) -> Batch:
    """Return images (B, 3, S, S) in RGB / 255 and the targets of `number` random crops."""
    crops = [source.crop(size, rng) for _ in range(number)]
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
    net = DetectorNet()
    source = Source(read_labelled(args.data, None if args.all else False), read_second_look())

    def loss_of(batch: Batch) -> torch.Tensor:
        images, heat, weight, sides, side_weight = batch
        output = net(images)
        of_heat = heat_loss(output[:, :2], heat, weight)
        return of_heat + _BOX_WEIGHT * box_loss(predicted_boxes(output), sides, side_weight)

    train(net, partial(batch_of, source, args.size, args.batch), loss_of, args, decay=DECAY)


if __name__ == "__main__":
    main()
