"""A second opinion on boxes that the measurement in the picture does not confirm: does our detector see them there?

It settles whether a picture contradicts the boxes (they are another picture's, shifted, mirrored, of another
resolution) or is only unlike the pictures that the measurement's confidence was calibrated on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from elevator_rectify.core.config import NetworkConfig
from elevator_rectify.core.detector.detect import boxes_at, find_boxes
from elevator_rectify.core.detector.peaks import Boxes, centres_of
from elevator_rectify.core.types import Array, BoolArray, FitResult, Image

CONFIRMED, CONTRADICTED, UNSEEN = "confirmed", "contradicted", "unseen"
# Things hotter than this count as seen; buttons hotter than that count as surely elsewhere.
_SEEN_HEAT, _SURE_HEAT = 0.12, 0.45
# A box is seen where a thing's centre is within this share of the box's size of its own.
_NEAR = 0.4
# Several things fill a box together from this intersection over union on.
_FILLED = 0.55
# From this share on the boxes are confirmed (99 held-out real panels all had .9 and more). Below, they are contradicted
# where so many sure buttons have no box: at least, and over the number of boxes.
_CONFIRMED_SHARE = 0.85
_ELSEWHERE, _ELSEWHERE_SHARE = 2, 0.15
# Where so few boxes are seen, some likely buttons elsewhere will do: the picture shows buttons, but not these.
_HARDLY_SEEN, _LIKELY_HEAT = 0.3, 0.25
# Boxes that are seen, but all off to one side by more than this share of their size, are of another moment; those that
# are off by more each, by their root mean square, are another picture's of much the same lattice (252 right panels have
# .15 at most). So it is where this share of them is seen.
_MOSTLY_SEEN, _COMMON_SHIFT, _OWN_SHIFT = 0.5, 0.2, 0.155
# A picture in which so many things are seen over the number of boxes, or so many that have no box, can show buttons;
# of right boxes more than such a share is at a thing, off by less than _WELL_PLACED of its size (the least of 320
# right panels, real and rendered, has .43; .6 finds no more of 199 mirrored, swapped or shifted ones). Where hardly a
# box is at any of them, some things will do.
_SHOWS, _SHOWS_ELSEWHERE, _PLACED_SHARE, _WELL_PLACED = 0.6, 0.4, 0.4, 0.2
_SOME, _NONE_SHARE = 4, 0.1
# A picture is sharp where a hundredth of it has gradients like this (grey levels a pixel); a box is empty where the
# gradients in and around it are below that share of the picture's.
_SHARP, _EMPTY_SHARE, _EMPTY = 25.0, 0.18, 0.6
# Below this, at the detector's scale, a picture is too blurred or dark to say that buttons are elsewhere (137 real
# pictures have 15.6 and more, blurred by 8 px they have 9.2 at most), unless hardly a box is seen and so many sure
# buttons have none: at least, and over the number of boxes (with true boxes 99 real panels that are blurred by 2 to 8
# px or darkened to .3 or .12 have .29 at most).
_DIM = 12.0
_DIM_ELSEWHERE, _DIM_ELSEWHERE_SHARE = 4, 0.35


@dataclass(frozen=True)
class Opinion:
    """What is said: 'confirmed', 'contradicted' or 'unseen', and why; seen_px: (N, 4) centres and sizes of what is seen
    at confirmed boxes, NaN where nothing is."""

    verdict: str
    reason: str
    seen_px: Array | None = None


def second_opinion(image: Image, centres_px: Array, sizes_px: Array, config: NetworkConfig) -> Opinion:
    """Return whether the picture shows buttons at the boxes: centres (N, 2) and sizes (N, 2) in pixels.

    Most boxes are confirmed by a look at their part of the picture.
    """
    around = boxes_at(image, centres_px, sizes_px, config)
    said = _opinion(around, image, centres_px, sizes_px, config)
    found = around if said.verdict == CONFIRMED else find_boxes(image, config)
    return said if found is around else _opinion(found, image, centres_px, sizes_px, config)


def _opinion(found: Boxes, image: Image, centres_px: Array, sizes_px: Array, config: NetworkConfig) -> Opinion:
    """Return what the boxes that were found in the picture say."""
    things = found.boxes_px[found.heat > _SEEN_HEAT]
    seen, shift = _seen(things, centres_px, sizes_px)
    said = f"{seen.mean():.0%} of the boxes are seen in the picture"
    displaced = _displaced(shift, len(seen))
    if displaced:
        return Opinion(CONTRADICTED, displaced)
    if seen.mean() >= _CONFIRMED_SHARE:
        return Opinion(CONFIRMED, said, _nearest(things, centres_px, seen))
    dim = _sharpness(_gradient(_reduced(image, config.detector_side_px))) < _DIM
    if dim and not _all_elsewhere(found, centres_px, float(seen.mean())):
        return Opinion(UNSEEN, f"{said}, which is blurred or dark")
    other = _seen_elsewhere(found, centres_px, float(seen.mean())) or _ill_placed(things, centres_px, shift)
    if other:
        return Opinion(CONTRADICTED, other)
    empty = _empty_share(image, centres_px, sizes_px)
    if empty > _EMPTY:
        return Opinion(CONTRADICTED, f"{empty:.0%} of the boxes are on nothing in a sharp picture")
    return Opinion(UNSEEN, said)


def _displaced(shift: Array, number: int) -> str:
    """Return how the boxes that are seen, of so many, are off from that: shift (S, 2) in sizes; '' if little."""
    if len(shift) < max(1.0, _MOSTLY_SEEN * number):
        return ""
    off, each = np.linalg.norm(np.median(shift, axis=0)), np.sqrt((shift**2).sum(axis=1).mean())
    if off >= _COMMON_SHIFT:
        return f"the boxes are all off by {off:.2f} of their size from what the picture shows"
    if each >= _OWN_SHIFT:
        return f"the boxes are off by {each:.2f} of their size, each another way, from what the picture shows"
    return ""


def _seen_elsewhere(found: Boxes, centres_px: Array, share: float) -> str:
    """Return how many buttons the picture surely shows that have no box, '' for few; share: of the boxes, seen."""
    hardly = share < _HARDLY_SEEN
    sure = found.is_button & (found.heat > (_LIKELY_HEAT if hardly else _SURE_HEAT))
    elsewhere = _elsewhere(found.boxes_px[sure], centres_px)
    if elsewhere < (_ELSEWHERE if hardly else max(_ELSEWHERE, _ELSEWHERE_SHARE * len(centres_px))):
        return ""
    return f"{share:.0%} of the boxes are where the picture shows buttons, {elsewhere} buttons are elsewhere"


def _all_elsewhere(found: Boxes, centres_px: Array, share: float) -> bool:
    """Tell whether even a dim picture shows the panel elsewhere; share: of the boxes, seen."""
    sure = found.boxes_px[found.is_button & (found.heat > _SURE_HEAT)]
    least = max(_DIM_ELSEWHERE, _DIM_ELSEWHERE_SHARE * len(centres_px))
    return share < _HARDLY_SEEN and _elsewhere(sure, centres_px) >= least


def _ill_placed(things: Array, centres_px: Array, shift: Array) -> str:
    """Return how few boxes are well on one of the things (M, 4) that the picture shows, '' if many are, or it shows
    hardly anything."""
    number, seen = len(centres_px), len(shift)
    placed = int((np.linalg.norm(shift, axis=1) < _WELL_PLACED).sum()) / number
    many = len(things) >= _SHOWS * number or _elsewhere(things, centres_px) >= _SHOWS_ELSEWHERE * number
    if placed >= _PLACED_SHARE or not (many or (len(things) >= _SOME and seen < _NONE_SHARE * number)):
        return ""
    return f"only {placed:.0%} of the boxes are where the picture shows things like buttons"


def contradicted(fit: FitResult, opinion: Opinion) -> FitResult:
    """Return the fit, refused where the opinion is that the picture contradicts its boxes."""
    if opinion.verdict != CONTRADICTED:
        return fit
    return replace(fit, status="contradicted", reason=f"the picture contradicts the boxes: {opinion.reason}")


def _seen(things: Array, centres_px: Array, sizes_px: Array) -> tuple[BoolArray, Array]:
    """Return (N,) which boxes have one of the things (M, 4) at their centre, or are filled by several, and the shift
    (S, 2) of those, in sizes, as far as the thing's larger box (a cap with its plate) does not explain it."""
    if not len(things):
        return np.zeros(len(centres_px), dtype=bool), np.zeros((0, 2))
    off = (centres_px[:, None] - centres_of(things)[None]) / sizes_px[:, None]
    nearest = np.linalg.norm(off, axis=2).argmin(axis=1)
    own = off[np.arange(len(off)), nearest]
    larger = np.maximum(things[nearest, 2:] - things[nearest, :2] - sizes_px, 0.0) / (2.0 * sizes_px)
    shift = np.sign(own) * np.maximum(np.abs(own) - larger, 0.0)
    for k in range(len(centres_px)):
        whole = _whole(things[(np.abs(off[k]) < 0.5).all(axis=1)], centres_px[k], sizes_px[k])
        if whole is not None:
            own[k] = shift[k] = whole
    seen = np.asarray(np.linalg.norm(own, axis=1) < _NEAR)
    return seen, shift[seen]


def _nearest(things: Array, centres_px: Array, seen: BoolArray) -> Array:
    """Return centres and sizes (N, 4) of the things (M, 4) nearest to the boxes that are seen, NaN for the others."""
    nearest = things[np.linalg.norm(centres_px[:, None] - centres_of(things)[None], axis=2).argmin(axis=1)]
    return np.where(seen[:, None], np.column_stack([centres_of(nearest), nearest[:, 2:] - nearest[:, :2]]), np.nan)


def _whole(inside: Array, centre_px: Array, size_px: Array) -> Array | None:
    """Return how far (2,) a box is from the things in it together, in sizes, None where they do not fill it.

    Many people draw one box around a cap and the plate with its label.
    """
    if len(inside) < 2:
        return None
    low, high = inside[:, :2].min(axis=0) - 0.5, inside[:, 2:].max(axis=0) - 0.5
    both = np.minimum(high, centre_px + size_px / 2.0) - np.maximum(low, centre_px - size_px / 2.0)
    overlap = float(np.prod(np.maximum(both, 0.0)))
    if overlap < _FILLED * float(np.prod(size_px) + np.prod(high - low) - overlap):
        return None
    return np.asarray((centre_px - (low + high) / 2.0) / size_px)


def _elsewhere(buttons: Array, centres_px: Array) -> int:
    """Count the buttons (M, 4) that have no box's centre at theirs."""
    size = np.maximum(buttons[:, 2:] - buttons[:, :2], 1.0)
    off = np.linalg.norm((centres_of(buttons)[:, None] - centres_px[None]) / size[:, None], axis=2)
    return int((off.min(axis=1, initial=np.inf) > _NEAR).sum())


def _empty_share(image: Image, centres_px: Array, sizes_px: Array) -> float:
    """Return the share of the boxes with nothing in them, 0 where the picture is too dark or blurred to tell."""
    gradient = _gradient(image)
    sharp = _sharpness(gradient)
    if sharp < _SHARP / 2.0:
        return 0.0
    empty = []
    low = np.maximum((centres_px - 0.6 * sizes_px).astype(int), 0)
    high = np.maximum((centres_px + 0.6 * sizes_px).astype(int) + 1, 1)
    for (x0, y0), (x1, y1) in zip(low, high, strict=True):
        part = gradient[y0:y1, x0:x1]
        if part.size:
            empty.append(float(np.quantile(part, 0.9)) < _EMPTY_SHARE * sharp)
    return float(np.mean(empty)) if empty else 0.0


def _reduced(image: Image, side_px: int) -> Image:
    """Return the picture with its longer side reduced to so many pixels, where it is longer."""
    scale = side_px / max(image.shape[:2])
    return image if scale >= 1.0 else cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def _gradient(image: Image) -> Array:
    """Return the length of the gradient (height, width) in grey values a pixel."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return np.asarray(cv2.magnitude(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)) / 8.0)


def _sharpness(gradient: Array) -> float:
    """Return the gradient that a hundredth of the picture has, of its gradients (height, width)."""
    return float(np.quantile(gradient[::3, ::3], 0.99))
