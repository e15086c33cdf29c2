"""Begin a wider detector with what a narrower one learnt: `python -m elevator_rectify.train.widen NARROW.pt WIDE.pt`.

The wider network says the same at first: its new channels are random, and nothing that was there listens to them yet
(after Chen, Goodfellow and Shlens, "Net2Net", who copy channels instead).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from torch import Tensor

from elevator_rectify.train.checkpoint import Checkpoint
from elevator_rectify.train.detector import DECAY
from elevator_rectify.train.detector_net import DetectorNet
from elevator_rectify.train.schedule import Average

_KERNEL_AXES = 4


def widened(wide: Tensor, narrow: Tensor) -> Tensor:
    """Return the wider tensor with the narrower one in its first places; its kernels there do not hear new channels."""
    new = wide.clone()
    if new.ndim == _KERNEL_AXES and narrow.shape[1] < new.shape[1]:
        new[: narrow.shape[0], narrow.shape[1] :] = 0
    new[tuple(slice(0, side) for side in narrow.shape)] = narrow
    return new


def main() -> None:
    """Read the command line and write the checkpoint, at step 0."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("narrow", type=Path, help="checkpoint of a detector with fewer channels")
    parser.add_argument("wide", type=Path, help="checkpoint to write; train.detector --checkpoint goes on from it")
    parser.add_argument("--seed", type=int, default=3)
    args = parser.parse_args()
    torch.manual_seed(args.seed)
    net, narrow = DetectorNet(), torch.load(args.narrow, weights_only=True)["average"]
    net.load_state_dict({name: widened(value, narrow[name]) for name, value in net.state_dict().items()})
    Checkpoint(args.wide, net, Average(net), torch.optim.AdamW(net.parameters(), weight_decay=DECAY)).save(0, now=True)


if __name__ == "__main__":
    main()
