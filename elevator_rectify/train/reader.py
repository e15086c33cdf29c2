"""Train the reader: `python -m elevator_rectify.train.reader DATA`; resumes from its last checkpoint."""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import cross_entropy

from elevator_rectify.core.reading.reader import PATCH_PX, normalised
from elevator_rectify.core.reading.vocabulary import BLANK, KINDS, SLOTS, encoded
from elevator_rectify.train.labelled import is_other_thing, read_labelled
from elevator_rectify.train.loop import add_training, train
from elevator_rectify.train.patches import cut_patch, drawn_patch, font_files, random_text, spoilt_patch, with_lamp
from elevator_rectify.train.pretrained import begin_with_recogniser
from elevator_rectify.train.reader_net import ReaderNet

# Batches, of so many patches, that show a recogniser of texts what buttons look like.
_BATCHES_SHOWN, _SHOWN = 8, 64
# Shares of buttons without print that get a lamp, and of texts that are shown on their head; characters that no other
# one is upside down.
_WITH_LAMP, _ON_ITS_HEAD = 0.4, 0.04
_UPRIGHT_ONLY = frozenset("23457ABCDEFGJKLPQRTUVY")
Sample = tuple[Any, NDArray[np.float64], str, tuple[int, ...], str]


def samples_of(data: Path, validation: bool | None) -> list[Sample]:
    """Return (picture, box, kind, slots, label) of every box that the network can say."""
    samples: list[Sample] = []
    for picture in read_labelled(data, validation):
        for box, label in zip(picture.boxes_px, picture.labels, strict=True):
            said = ("other", (BLANK,) * SLOTS) if is_other_thing(label) else encoded(label)
            if said is not None:
                samples.append((picture.image, box.astype(float), *said, label))
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


@dataclass(frozen=True)
class Source:
    """Where batches come from: samples with how often to draw each, and the share of drawn patches with their fonts."""

    samples: list[Sample]
    weights: NDArray[np.float64]
    drawn: float
    fonts: list[Path]

    def batch(self, number: int, rng: np.random.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """Return patches (B, 3, S, S), kinds (B,) and slots (B, 4)."""
        patches, kinds, slots = [], [], []
        for k in rng.choice(len(self.samples), number, p=self.weights):
            if rng.random() < self.drawn:
                patch, kind, code = self._drawn(rng)
            else:
                patch, kind, code = self._cut(k, rng)
            patches.append(normalised(spoilt_patch(patch, rng)))
            kinds.append(KINDS.index(kind))
            slots.append(code)
        return torch.from_numpy(np.stack(patches)), torch.tensor(kinds), torch.tensor(slots)

    def _cut(self, k: int, rng: np.random.Generator) -> tuple[Any, str, tuple[int, ...]]:
        """Return the sample's patch; now and then on its head, which must not be read, or without print but a lamp."""
        image, box, kind, code, label = self.samples[k]
        patch = cut_patch(image, box, PATCH_PX, rng)
        if kind == "empty" and rng.random() < _WITH_LAMP:
            return with_lamp(patch, rng), kind, code
        if kind == "text" and set(label) & _UPRIGHT_ONLY and rng.random() < _ON_ITS_HEAD:
            return patch[::-1, ::-1], "unreadable", (BLANK,) * SLOTS
        return patch, kind, code

    def _drawn(self, rng: np.random.Generator) -> tuple[Any, str, tuple[int, ...]]:
        text = random_text(rng)
        said = encoded("s" + text[1:] if text.startswith("*") else text)
        assert said is not None
        return drawn_patch(text, PATCH_PX, rng, self.fonts), *said


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
    add_training(parser, "reader", steps=3000, batch=64, rate=1.5e-3)
    parser.add_argument("--drawn", type=float, default=0.15, help="share of drawn patches")
    parser.add_argument("--pretrained", type=Path, metavar="ONNX", help="recogniser of texts to begin with")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.manual_seed(args.seed)
    net, samples = ReaderNet(), samples_of(args.data, None if args.all else False)
    source = Source(samples, weights_of(samples), args.drawn, font_files())
    if args.pretrained is not None:
        batches = (source.batch(_SHOWN, np.random.default_rng([args.seed, k]))[0] for k in range(_BATCHES_SHOWN))
        begin_with_recogniser(net.features, args.pretrained, (view for x in batches for view in net.views(x)))

    def loss(batch: tuple[Tensor, Tensor, Tensor]) -> Tensor:
        patches, kinds, slots = batch
        return loss_of(net(patches), kinds, slots)

    train(net, partial(source.batch, args.batch), loss, args, decay=2e-2, slow=net.features.parameters())


if __name__ == "__main__":
    main()
