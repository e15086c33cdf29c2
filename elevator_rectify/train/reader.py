"""Train the reader: `python -m elevator_rectify.train.reader DATA`; resumes from its last checkpoint."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import cross_entropy

from elevator_rectify.core.reading.vocabulary import BLANK, KINDS, SLOTS, encoded
from elevator_rectify.train.labelled import is_other_thing, read_labelled
from elevator_rectify.train.loop import add_training, train
from elevator_rectify.train.patches import cut_patch, drawn_patch, font_files, normalised, random_text, spoilt_patch
from elevator_rectify.train.reader_net import PATCH, ReaderNet

# Patches are cut from pictures of twice the size: the turn and shear then lose nothing.
_GROWN = 2
Sample = tuple[Any, NDArray[np.float64], str, tuple[int, ...], str]


def samples_of(data: Path, validation: bool | None) -> list[Sample]:
    """Return (picture, box, kind, slots, label) of every box that the network can say."""
    samples: list[Sample] = []
    for picture in read_labelled(data, validation):
        grown = cv2.resize(picture.image, None, fx=_GROWN, fy=_GROWN, interpolation=cv2.INTER_CUBIC)
        for box, label in zip(picture.boxes_px, picture.labels, strict=True):
            said = ("other", (BLANK,) * SLOTS) if is_other_thing(label) else encoded(label)
            if said is not None:
                samples.append((grown, box.astype(float) * _GROWN, *said, label))
    return samples


def weights_of(samples: list[Sample]) -> NDArray[np.float64]:
    """Return how often to draw each sample: rare labels more often than they are, by the root of their number."""
    counts = Counter(label for *_, label in samples)
    w = np.array(
        [
            counts[label] ** -0.5 * (0.4 if kind in ("unreadable", "other", "empty") else 1.0)
            for _, _, kind, _, label in samples
        ]
    )
    return np.asarray(w / w.sum())


def batch_of(
    samples: list[Sample],
    weights: NDArray[np.float64],
    number: int,
    drawn: float,
    rng: np.random.Generator,
    fonts: list[Path],
) -> tuple[Tensor, Tensor, Tensor]:
    """Return patches (B, 1, S, S), kinds (B,) and slots (B, 4), a share of them drawn."""
    patches, kinds, slots = [], [], []
    for k in rng.choice(len(samples), number, p=weights):
        if rng.random() < drawn:
            text = random_text(rng)
            said = encoded("s" + text[1:] if text.startswith("*") else text)
            assert said is not None
            patch, (kind, code) = drawn_patch(text, PATCH, rng, fonts), said
        else:
            image, box, kind, code, _ = samples[k]
            patch = cut_patch(image, box, PATCH, rng)
        patches.append(normalised(spoilt_patch(patch, rng)))
        kinds.append(KINDS.index(kind))
        slots.append(code)
    return torch.from_numpy(np.stack(patches)[:, None]), torch.tensor(kinds), torch.tensor(slots)


def loss_of(logits: Tensor, kinds: Tensor, slots: Tensor) -> Tensor:
    """Return the cross entropy of the kinds, and of texts' characters."""
    text = kinds == KINDS.index("text")
    total = cross_entropy(logits[:, : len(KINDS)], kinds, label_smoothing=0.02)
    if text.any():
        each = logits[text, len(KINDS) :].reshape(-1, BLANK + 1)
        total = total + SLOTS * cross_entropy(each, slots[text].reshape(-1), label_smoothing=0.01) * text.float().mean()
    return total


def main() -> None:
    """Read the command line and train."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_training(parser, "reader", steps=7000, batch=96, rate=2e-3)
    parser.add_argument("--drawn", type=float, default=0.3, help="share of drawn patches")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.manual_seed(args.seed)
    net, samples, fonts = ReaderNet(), samples_of(args.data, None if args.all else False), font_files()
    weights = weights_of(samples)

    def of_batch(rng: np.random.Generator) -> Tensor:
        patches, kinds, slots = batch_of(samples, weights, args.batch, args.drawn, rng, fonts)
        return loss_of(net(patches), kinds, slots)

    train(net, of_batch, args, decay=1e-2)


if __name__ == "__main__":
    main()
