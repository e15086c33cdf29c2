"""The steps of a training: seeded batches, a scheduled rate, a moving average, checkpoints and progress."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from elevator_rectify.train.checkpoint import Checkpoint
from elevator_rectify.train.schedule import Average, learning_rate

_LARGEST_GRADIENT, _TOLD_EVERY = 5.0, 100


def add_training(parser: argparse.ArgumentParser, name: str, steps: int, batch: int, rate: float) -> None:
    """Add the arguments of every training; name: of the checkpoint's file."""
    parser.add_argument("data", type=Path, help="folder with panels_labelled.json and pictures/")
    parser.add_argument("--checkpoint", type=Path, default=Path(f"{name}.pt"), help="is resumed where it exists")
    parser.add_argument("--steps", type=int, default=steps, help="steps in all, those before a resumption too")
    parser.add_argument("--batch", type=int, default=batch)
    parser.add_argument("--rate", type=float, default=rate, help="highest learning rate")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--all", action="store_true", help="train on the validation part too")


def train(
    net: torch.nn.Module, loss_of: Callable[[np.random.Generator], Tensor], args: argparse.Namespace, decay: float
) -> None:
    """Train from the checkpoint where there is one. loss_of: draws a batch and returns the network's loss on it."""
    average = Average(net)
    optimiser = torch.optim.AdamW(net.parameters(), lr=args.rate, weight_decay=decay)
    checkpoint = Checkpoint(args.checkpoint, net, average, optimiser)
    step, begun, mean = checkpoint.load(), time.time(), 0.0
    print(f"{sum(p.numel() for p in net.parameters())} weights, from step {step} of {args.steps}", flush=True)
    net.train()
    while step < args.steps:
        for group in optimiser.param_groups:
            group["lr"] = learning_rate(step, args.steps, args.rate)
        loss = loss_of(np.random.default_rng([args.seed, step]))
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), _LARGEST_GRADIENT)
        optimiser.step()
        average.update(net, step)
        mean = loss.item() if mean == 0.0 else 0.99 * mean + 0.01 * loss.item()
        step += 1
        if step % _TOLD_EVERY == 0:
            print(f"step {step} loss {mean:.3f} {time.time() - begun:.0f} s", flush=True)
        checkpoint.save(step, now=step == args.steps)
