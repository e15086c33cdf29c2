"""Which way up the labels stand: on their side, as a panel that is wider than high may be, or on their head."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.reading.attitude import ATTITUDES, upright_nats
from elevator_rectify.core.reading.reader import plane_corners_px, quadrangle_patch, read_quadrangles
from elevator_rectify.core.reading.vocabulary import SYMBOLS
from elevator_rectify.core.types import Array, Detection, FitResult, Image

# Where so many buttons are read upright with this mean probability, they do not lie on their side; else so many are
# read in every turn.
_FEW, _READABLE, _SAMPLE = 8, 0.5, 14
# Of so many buttons, asked in so many parts, such log odds against every other way to stand are enough; the reader is
# asked whether they are mirrored where the log odds for that are so high. The corners that make a mirror image.
_ASKED, _PARTS, _SURELY_NATS, _SUSPECTED_NATS = 16, 4, 8.0, 2.0
_MIRRORED = [1, 0, 3, 2]
# Half of the few are enough where they are read better upright than on their head by so many labels: so are four in ten
# of 186 real panels, and none of them on its head.
_SURELY = 1.75
# Turned labels are read better than upright ones: by one label more, and so many of them. Of 114 held-out panels that
# stand upright none is, of those that lie on their side seven in eight; of 400 upright ones two seemed to stand on
# their head. Fewer buttons than the last number say nothing.
_MORE, _LEAST_SHARE, _FEWEST = 1.0, 0.15, 6


@dataclass(frozen=True)
class WayUp:
    """By how many quarter turns the labels are turned clockwise against the panel's frame, 0 where upright or unknown;
    upright: whether they are read so much better upright that they do not stand on their head; mirrored: whether they
    surely are, as in a mirror."""

    quarter_turns: int = 0
    upright: bool = False
    mirrored: bool = False


def way_up(
    image: Image, camera: Camera, fit: FitResult, detections: Sequence[Detection], on_head: bool = True
) -> WayUp:
    """Return which way up the labels of an accepted fit to these detections stand.

    A small network is asked first; where it is not sure, the reader: only its certainty counts, not what it reads. Few
    buttons say nothing. Few panels are wider than high: the others do not lie on their side, but may stand on their
    head, where a 7 is read as 4; on_head: whether that is asked.
    """
    corners = [c for c in plane_corners_px(fit, camera, detections) if np.isfinite(c).all()]
    sideways = fit.rows <= fit.columns
    if len(corners) < _FEWEST or not (sideways or on_head):
        return WayUp()
    surely, suspected = _by_prints(image, corners)
    if surely:
        return WayUp(upright=True)
    few = _spread(corners, _FEW)
    turns = (0, 2) if on_head else (0,)
    sums = {turn: _readable(image, few[::2], turn) for turn in turns}
    lying = sideways and sums[0] <= _READABLE * len(few[::2])
    if on_head and not (lying or suspected) and sums[0] > sums[2] + _SURELY:
        return WayUp(0, upright=True)
    # Those that were read already are remembered.
    sums = {turn: _readable(image, few, turn) for turn in turns}
    mirrored = _readable(image, [corners[_MIRRORED] for corners in few], 0) if suspected else 0.0
    if mirrored > _more_than(sums[0], few):
        return WayUp(mirrored=True)
    if sideways and sums[0] <= _READABLE * len(few):
        few = _spread(corners, _SAMPLE)
        sums = {turn: _readable(image, few, turn) for turn in range(4)}
    best = max(sums, key=lambda turn: sums[turn])
    turned = sums[best] > _more_than(sums[0], few)
    return WayUp(best if turned else 0, sums[0] > max(sums.get(2, np.inf), mirrored) + _MORE)


def _more_than(upright: float, asked: list[Array]) -> float:
    """Return what must be read another way than upright, of those asked, to be believed."""
    return max(upright + _MORE, _LEAST_SHARE * len(asked))


def _by_prints(image: Image, corners_px: list[Array]) -> tuple[bool, bool]:
    """Return whether the buttons' prints together surely stand upright, and whether they may be mirrored.

    They are asked in turn, from all over the panel, until it is sure.
    """
    asked, nats = _spread(corners_px, _ASKED), np.zeros(ATTITUDES)
    for first in range(_PARTS):
        patches = [quadrangle_patch(image, corners) for corners in asked[first::_PARTS]]
        nats += upright_nats(patches).sum(axis=0)
        if nats[0] > nats[1:].max() + _SURELY_NATS:
            return True, False
    as_is, mirrored = nats[: ATTITUDES // 2], nats[ATTITUDES // 2]
    return False, bool(mirrored > as_is.max() + _SUSPECTED_NATS)


def _spread(corners_px: list[Array], number: int) -> list[Array]:
    """Return so many at most, from all over the panel."""
    return corners_px[:: max(1, -(-len(corners_px) // number))]


def _readable(image: Image, corners_px: list[Array], turn: int) -> float:
    """Return the sum of the likeliest texts' probabilities, read turned by quarter turns.

    Symbols do not count: many are symbols in other turns, too.
    """
    turned = [np.roll(corners, -turn, axis=0) for corners in corners_px]
    reads = read_quadrangles(image, turned)
    return sum(max((p for label, p in read.labels if label not in SYMBOLS), default=0.0) for read in reads)
