"""Train what tells which lamps are lit: `python -m elevator_rectify.train.lit EXAMPLES`; resumes from its last
checkpoint. The examples are written by `calibrate --lit-examples LABELLED`."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from elevator_rectify.core.lamps.lit import as_given
from elevator_rectify.train.lit_net import LitNet
from elevator_rectify.train.loop import Batch, add_training, train

# Shares of a batch: lit and dark ones as they are, the same with painted lamps on their panels.
_SHARES = ((False, True, 0.25), (False, False, 0.375), (True, True, 0.125), (True, False, 0.25))
# Marks by eye are not always right.
_SURE = 0.98
# Exposure, white balance and noise are drawn anew: standard deviations of logarithms, and over the middle grey.
_EXPOSURE, _BALANCE, _NOISE = 0.25, 0.08, 0.02


@dataclass(frozen=True)
class Examples:
    """Buttons beside others (N, 9, n, n) in grey values, whether each is lit (N,), on a panel with painted lamps or
    not (N,)."""

    seen: NDArray[np.uint8]
    lit: NDArray[np.bool_]
    painted: NDArray[np.bool_]


def read_examples(path: Path) -> Examples:
    """Read what `calibrate --lit-examples` wrote."""
    with np.load(path) as stored:
        return Examples(stored["seen"], stored["lit"], stored["painted"])


def batch_of(examples: Examples, number: int, rng: np.random.Generator) -> Batch:
    """Return patches (B, 9, n, n), and whether each is lit (B,)."""
    chosen = [
        rng.choice(np.flatnonzero((examples.painted == painted) & (examples.lit == lit)), round(share * number))
        for painted, lit, share in _SHARES
    ]
    which = np.concatenate(chosen)
    seen = np.stack([_taken_again(examples.seen[k], rng) for k in which])
    return torch.from_numpy(as_given(seen)), torch.from_numpy(examples.lit[which].astype(np.float32))


def _taken_again(seen: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.float32]:
    """Return the patches (9, n, n) in another light, mirrored now and then."""
    light = np.exp(rng.normal(0.0, _EXPOSURE) + rng.normal(0.0, _BALANCE, 3))
    grey = np.clip(seen * np.tile(light, 3)[:, None, None], 0.0, 255.0)
    grey += rng.normal(0.0, 128.0 * _NOISE, grey.shape)
    for axis in (1, 2):
        grey = np.flip(grey, axis) if rng.random() < 0.5 else grey
    return np.asarray(grey, dtype=np.float32)


def main() -> None:
    """Read the command line and train."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_training(parser, "lit", steps=1500, batch=128, rate=3e-3)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.manual_seed(args.seed)
    net = LitNet()

    def loss_of(batch: Batch) -> Tensor:
        patches, lit = batch
        said = net(patches).squeeze(1)
        return binary_cross_entropy_with_logits(said, lit * (2.0 * _SURE - 1.0) + 1.0 - _SURE)

    train(net, partial(batch_of, read_examples(args.data), args.batch), loss_of, args, decay=2e-2)


if __name__ == "__main__":
    main()
