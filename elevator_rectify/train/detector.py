"""Train the detector: `python -m elevator_rectify.train.detector DATA`; resumes from its last checkpoint."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch

from elevator_rectify.train.augment import random_crop
from elevator_rectify.train.checkpoint import Checkpoint
from elevator_rectify.train.detector_loss import box_loss, heat_loss, predicted_boxes, targets
from elevator_rectify.train.detector_net import DetectorNet, parameters_of
from elevator_rectify.train.labelled import LabelledPicture, read_labelled
from elevator_rectify.train.schedule import Average, learning_rate


def batch_of(pictures: list[LabelledPicture], size: int, number: int, rng: np.random.Generator) -> list[torch.Tensor]:
    """Return images (B, 3, S, S) in RGB / 255 and the targets of `number` random crops."""
    crops = [random_crop(pictures[rng.integers(len(pictures))], size, rng) for _ in range(number)]
    images = np.stack([np.ascontiguousarray(c.image[..., ::-1].transpose(2, 0, 1)) for c in crops])
    rest = [np.stack(part) for part in zip(*(targets(c) for c in crops), strict=True)]
    return [torch.from_numpy(images).float() / 255, *(torch.from_numpy(part) for part in rest)]


def train(args: argparse.Namespace) -> None:
    """Train from the checkpoint where there is one, and write a checkpoint every few minutes."""
    torch.set_num_threads(args.threads)
    torch.manual_seed(args.seed)
    net = DetectorNet().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    average = Average(net)
    optimiser = torch.optim.AdamW(net.parameters(), lr=args.rate, weight_decay=1e-3)
    checkpoint = Checkpoint(args.checkpoint, net, average, optimiser)
    step = checkpoint.load()
    pictures = read_labelled(args.data, None if args.all else False)
    print(f"{parameters_of(net)} weights, {len(pictures)} pictures, from step {step} of {args.steps}", flush=True)
    begun, losses = time.time(), np.zeros(2)
    net.train()
    while step < args.steps:
        rng = np.random.default_rng([args.seed, step])
        images, heat, weight, sides, side_weight = batch_of(pictures, args.size, args.batch, rng)
        for group in optimiser.param_groups:
            group["lr"] = learning_rate(step, args.steps, args.rate)
        output = net(images.to(memory_format=torch.channels_last))
        of_heat = heat_loss(output[:, :2], heat, weight)
        of_boxes = box_loss(predicted_boxes(output), sides, side_weight)
        optimiser.zero_grad(set_to_none=True)
        (of_heat + 2.0 * of_boxes).backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 5.0)
        optimiser.step()
        average.update(net, step)
        losses = 0.99 * losses + 0.01 * np.array([of_heat.item(), of_boxes.item()])
        step += 1
        if step % 100 == 0:
            scale = 1 / (1 - 0.99 ** min(step, 2000))
            print(f"step {step} heat {losses[0] * scale:.3f} boxes {losses[1] * scale:.3f}"
                  f" {time.time() - begun:.0f} s", flush=True)
        checkpoint.save(step, now=step == args.steps)


def main() -> None:
    """Read the command line and train."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="folder with panels_labelled.json and pictures/")
    parser.add_argument("--checkpoint", type=Path, default=Path("detector.pt"))
    parser.add_argument("--steps", type=int, default=25000)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--size", type=int, default=288, help="side of the crops, a multiple of 32")
    parser.add_argument("--rate", type=float, default=3e-3)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--all", action="store_true", help="train on the validation part too")
    train(parser.parse_args())


if __name__ == "__main__":
    main()
