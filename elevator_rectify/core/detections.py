"""From any caller's detections to clean arrays: which of them can be used, and why the others cannot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from elevator_rectify.core.config import InputConfig
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.types import Array, BoolArray, Detection, IntArray

# A button at the border may be detected this far beyond it, in image sizes.
_OUTSIDE = 0.01
# Boxes that differ by less than this share of their size are a detector's constant.
_ALIKE = 0.005
# Boxes that come so near to the picture's border are cut off by it, if they are smaller than this share of the others.
_BORDER_PX, _CUT_SHARE = 1.5, 0.8
# Irrational numbers: fractions of a weighted sum of coordinates are spread evenly.
_SCATTER_X, _SCATTER_Y = 0.5 * (np.sqrt(5.0) - 1.0), np.sqrt(2.0)


@dataclass(frozen=True)
class Usable:
    """The usable detections: index (M,) into the input, rays (M, 2), sizes_px (M, 2); the others counted by reason."""

    number: int
    index: IntArray
    rays: Array
    sizes_px: Array
    dropped: dict[str, int]

    def cut_off(self, camera: Camera) -> BoolArray:
        """Return (M,) which boxes the picture's border cuts off: they reach it, and are smaller than usual."""
        centre, half = camera.pixels(self.rays), self.sizes_px / 2.0
        known = np.asarray((self.sizes_px > 0).all(axis=1))
        if not known.any():
            return known
        last = np.array([camera.width, camera.height]) - 1.0
        near = (centre - half < _BORDER_PX) | (centre + half > last - _BORDER_PX)
        small = self.sizes_px < _CUT_SHARE * np.median(self.sizes_px[known], axis=0)
        return np.asarray(known & (near & small).any(axis=1))

    def without(self, left_out: BoolArray) -> Usable:
        """Return the usable detections but those (M,) that are left out."""
        kept = ~left_out
        return replace(self, index=self.index[kept], rays=self.rays[kept], sizes_px=self.sizes_px[kept])

    @cached_property
    def telling_sizes_px(self) -> Array:
        """Return the sizes (M, 2), 0 where they are unknown, or one and the same for all boxes, which says nothing."""
        known = self.sizes_px[(self.sizes_px > 0).all(axis=1)]
        alike = not len(known) or bool((np.ptp(known, axis=0) < _ALIKE * known.max(axis=0)).all())
        return np.zeros_like(self.sizes_px) if alike else self.sizes_px

    @cached_property
    def log_sizes(self) -> Array:
        """Return (M,) ln of the root of the boxes' area in pixels, NaN where it is unknown or says nothing."""
        sizes = self.telling_sizes_px
        known = (sizes > 0).all(axis=1, keepdims=True)
        return np.asarray(np.log(np.where(known, sizes, np.nan)).mean(axis=1))


def as_arrays(detections: Array | Sequence[Detection]) -> tuple[Array, Array, Array]:
    """Return centres (N, 2) px, sizes (N, 2) px (0: unknown) and scores (N,) of an (N, 2) array or a list.

    Raises ValueError for an array of another shape.
    """
    if len(detections) and isinstance(detections[0], Detection):
        table = np.array(
            [[d.x_px, d.y_px, d.width_px, d.height_px, d.score] for d in detections if isinstance(d, Detection)]
        )
        return table[:, :2], table[:, 2:4], table[:, 4]
    centres = np.asarray(detections, dtype=float)
    if centres.size == 0:
        centres = centres.reshape(0, 2)
    if centres.ndim != 2 or centres.shape[1] != 2:
        raise ValueError(
            f"detections must be (N, 2) pixels or a list of Detection, not an array of shape {centres.shape}"
        )
    return centres, np.zeros_like(centres), np.ones(len(centres))


def usable_detections(detections: Array | Sequence[Detection], camera: Camera, config: InputConfig) -> Usable:
    """Return the finite, scored, non-duplicate detections within the image and the camera's model.

    Of more than `config.max_detections` the best-scored are kept; among equal scores, some from everywhere in the
    image, chosen by their coordinates, so that the order of the input does not matter.
    """
    centres, sizes, scores = as_arrays(detections)
    size = np.array([camera.width, camera.height], dtype=float)
    margin = _OUTSIDE * float(size.max())
    reasons = [
        ("not finite", np.isfinite(centres).all(axis=1)),
        ("outside the image", ((centres >= -0.5 - margin) & (centres <= size - 0.5 + margin)).all(axis=1)),
        ("low score", np.nan_to_num(scores, nan=-np.inf) >= config.min_score),
    ]
    keep, dropped = np.ones(len(centres), dtype=bool), {}
    for name, passed in reasons:
        dropped[name] = int((keep & ~passed).sum())
        keep &= passed
    index = np.flatnonzero(keep)
    # By score, then as good as at random, but always the same: the canonical order.
    x, y = centres[index].T
    index = index[np.lexsort((y, x, np.modf(np.abs(x * _SCATTER_X + y * _SCATTER_Y))[0], -scores[index]))]
    first = np.sort(np.unique(centres[index], axis=0, return_index=True)[1])
    dropped["duplicate"] = len(index) - len(first)
    index = index[first]
    dropped["over the cap"] = max(0, len(index) - config.max_detections)
    index = index[: config.max_detections]
    rays = camera.rays(centres[index])
    seen = np.isfinite(rays).all(axis=1)
    dropped["beyond the distortion model"] = int((~seen).sum())
    sizes = np.where(np.isfinite(sizes) & (sizes > 0), sizes, 0.0)
    return Usable(len(centres), index[seen], rays[seen], sizes[index[seen]], {k: n for k, n in dropped.items() if n})
