"""The steps of a training: seeded batches, a scheduled rate, a moving average, checkpoints and progress."""

from __future__ import annotations

import argparse
import multiprocessing
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from elevator_rectify.train.checkpoint import Checkpoint
from elevator_rectify.train.schedule import Average, learning_rate
from elevator_rectify.train.start import begin_with

Batch = tuple[Tensor, ...]
Draw = Callable[[np.random.Generator], Batch]
_draw: Draw
# Batches drawn ahead.
_AHEAD = 4
_LARGEST_GRADIENT, _TOLD_EVERY = 5.0, 100
# Batches that show the normalisations of an exported network what their inputs are.
_SHOWN = 20


def add_training(parser: argparse.ArgumentParser, name: str, steps: int, batch: int, rate: float) -> None:
    """Add the arguments of every training; name: of the checkpoint's file."""
    parser.add_argument("data", type=Path, help="folder with panels_labelled.json and pictures/")
    parser.add_argument("--checkpoint", type=Path, default=Path(f"{name}.pt"), help="is resumed where it exists")
    parser.add_argument(
        "--start", type=Path, metavar="ONNX", help="exported network to begin with, without a checkpoint"
    )
    parser.add_argument("--steps", type=int, default=steps, help="steps in all, those before a resumption too")
    parser.add_argument("--batch", type=int, default=batch)
    parser.add_argument("--rate", type=float, default=rate, help="highest learning rate")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--all", action="store_true", help="train on the validation part too")


def batches(draw: Draw, seed: int, step: int, steps: int) -> Iterator[Batch]:
    """Yield the batches of the steps, each of its own seed, drawn ahead in a second process."""
    context = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(1, mp_context=context, initializer=_keep, initargs=(draw,)) as pool:
        ahead = deque(pool.submit(_drawn, seed, k) for k in range(step, min(step + _AHEAD, steps)))
        for k in range(step, steps):
            batch = ahead.popleft().result()
            if k + _AHEAD < steps:
                ahead.append(pool.submit(_drawn, seed, k + _AHEAD))
            yield tuple(torch.from_numpy(part) for part in batch)


def _keep(draw: Draw) -> None:
    """Keep what draws in the process that draws: its data are inherited, not sent."""
    global _draw
    _draw = draw
    cv2.setNumThreads(1)
    torch.set_num_threads(1)


def _drawn(seed: int, step: int) -> tuple[NDArray[Any], ...]:
    return tuple(part.numpy() for part in _draw(np.random.default_rng([seed, step])))


def _by_rate(net: torch.nn.Module, slow: Iterable[torch.nn.Parameter]) -> list[dict[str, Any]]:
    """Return the network's parameters in groups, each with its share of the rate."""
    late = list(slow)
    known = {id(p) for p in late}
    usual = [p for p in net.parameters() if id(p) not in known]
    return [{"params": usual, "share": 1.0}, *([{"params": late, "share": 0.5}] if late else [])]


def train(
    net: torch.nn.Module,
    draw: Draw,
    loss_of: Callable[[Batch], Tensor],
    args: argparse.Namespace,
    decay: float,
    slow: Iterable[torch.nn.Parameter] = (),
) -> None:
    """Train from the checkpoint where there is one. draw: draws a batch; loss_of: the network's loss on it; slow: the
    parameters that learn at half the rate."""
    # OpenCV's threads, once begun, would not be there in the process that draws ahead, which would wait for them.
    cv2.setNumThreads(1)
    if args.start is not None and not args.checkpoint.exists():
        shown = (draw(np.random.default_rng([args.seed, args.steps + k]))[0] for k in range(_SHOWN))
        new = begin_with(net, args.start, shown)
        print(f"begun with {args.start}, new: {', '.join(new) or 'nothing'}", flush=True)
    # Convolutions on a processor are one and a half to two times as fast with the channels last.
    net.to(memory_format=torch.channels_last)
    average = Average(net)
    optimiser = torch.optim.AdamW(_by_rate(net, slow), lr=args.rate, weight_decay=decay)
    checkpoint = Checkpoint(args.checkpoint, net, average, optimiser)
    step, begun, mean = checkpoint.load(), time.time(), 0.0
    print(f"{sum(p.numel() for p in net.parameters())} weights, from step {step} of {args.steps}", flush=True)
    net.train()
    for batch in batches(draw, args.seed, step, args.steps):
        for group in optimiser.param_groups:
            group["lr"] = group.get("share", 1.0) * learning_rate(step, args.steps, args.rate)
        loss = loss_of((batch[0].contiguous(memory_format=torch.channels_last), *batch[1:]))
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
