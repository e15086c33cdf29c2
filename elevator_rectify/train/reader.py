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

from elevator_rectify.core.reading.reader import PATCH_PX, normalised, read_patches
from elevator_rectify.core.reading.vocabulary import BLANK, CHARACTERS, KINDS, SLOTS, encoded
from elevator_rectify.train.labelled import is_other_thing, read_labelled
from elevator_rectify.train.loop import add_training, train
from elevator_rectify.train.patches import cut_patch, drawn_patch, font_files, random_text, spliced_patch, spoilt_patch
from elevator_rectify.train.reader_net import ReaderNet

# Halves of two patches are put together in this share of the draws where they can be: where so many such are read.
_SPLICED, _LEAST_READ = 0.4, 0.5
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


def partners_of(samples: list[Sample]) -> dict[int, list[int]]:
    """Return for samples of two characters the others of their picture whose right halves may stand beside their left
    ones: of pictures in which most such are read as what they then say, by the committed reader."""
    of_picture: dict[int, list[int]] = {}
    for k, (image, _, kind, code, _) in enumerate(samples):
        if kind == "text" and BLANK not in code[:2] and code[2] == BLANK:
            of_picture.setdefault(id(image), []).append(k)
    found = {}
    for several in of_picture.values():
        if len(several) >= 2 and _spliced_reads(samples, several) >= _LEAST_READ:
            found.update({k: [other for other in several if other != k] for k in several})
    return found


def _spliced_reads(samples: list[Sample], several: list[int]) -> float:
    """Return the share of neighbours' halves that are read as what they say together."""
    pairs = list(zip(several, several[1:] + several[:1], strict=True))
    reads = read_patches([spliced_patch(samples[a][0], samples[a][1], samples[b][1], PATCH_PX) for a, b in pairs])
    said = ["".join(CHARACTERS[c] for c in (samples[a][3][0], samples[b][3][1])) for a, b in pairs]
    return float(np.mean([r.label == s for r, s in zip(reads, said, strict=True)]))


@dataclass(frozen=True)
class Source:
    """Where batches come from: samples with how often to draw each, whose halves go together, and the share of drawn
    patches with their fonts."""

    samples: list[Sample]
    partners: dict[int, list[int]]
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
                patch, kind, code = self._cut(int(k), rng)
            patches.append(normalised(spoilt_patch(patch, rng)))
            kinds.append(KINDS.index(kind))
            slots.append(code)
        return torch.from_numpy(np.stack(patches)), torch.tensor(kinds), torch.tensor(slots)

    def _cut(self, k: int, rng: np.random.Generator) -> tuple[Any, str, tuple[int, ...]]:
        image, box, kind, code, _ = self.samples[k]
        others = self.partners.get(k, [])
        if not others or rng.random() > _SPLICED:
            return cut_patch(image, box, PATCH_PX, rng), kind, code
        _, other, _, its, _ = self.samples[others[int(rng.integers(len(others)))]]
        return spliced_patch(image, box, other, PATCH_PX, rng), kind, (code[0], *its[1:])

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
    add_training(parser, "reader", steps=7000, batch=96, rate=2e-3)
    parser.add_argument("--drawn", type=float, default=0.3, help="share of drawn patches")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.manual_seed(args.seed)
    net, samples = ReaderNet(), samples_of(args.data, None if args.all else False)
    source = Source(samples, partners_of(samples), weights_of(samples), args.drawn, font_files())

    def loss(batch: tuple[Tensor, Tensor, Tensor]) -> Tensor:
        patches, kinds, slots = batch
        return loss_of(net(patches), kinds, slots)

    train(net, partial(source.batch, args.batch), loss, args, decay=1e-2)


if __name__ == "__main__":
    main()
