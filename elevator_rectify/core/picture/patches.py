"""Patches of the picture around lattice points, sampled in the rectified plane."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.types import Array, Image

# Half of a patch over half of the button, and its bound in pitches: what is beyond belongs to the neighbours.
_WINDOW, _WIDEST_PITCH = 1.4, 0.6
# Samples are so far apart, in pixels; a patch has between so many along each axis, all patches together so many.
_STEP_PX, _FEWEST, _MOST = 0.9, 17, 41
_ALL = 24000
# Where samples are further apart, the image is reduced first.
_COARSEST_PX = 1.8
# The camera maps so many points of a patch along each axis; the others are interpolated, exact to 0.01 px.
_KNOTS = 4
_SMALLEST_HALF, _LARGEST_HALF = 0.12, 0.49


@dataclass(frozen=True)
class Picture:
    """The grey image (height, width), reduced by the whole number `reduction`."""

    grey: Image
    reduction: int
    camera: Camera


@dataclass(frozen=True)
class Window:
    """Half size (2,) of a patch in pitches (columns, rows), and its number of samples along each axis."""

    half: Array
    samples: int

    @property
    def step(self) -> Array:
        """Return the distance (2,) of two samples in pitches."""
        return 2.0 * self.half / (self.samples - 1)

    def coarser(self, times: float) -> Window:
        """Return the same window with fewer samples."""
        return Window(self.half, max(_FEWEST, 2 * (int(self.samples / times) // 2) + 1))


def picture_of(image: Image, camera: Camera, reduction: int = 1) -> Picture:
    """Return the image (height, width[, 3]) in grey."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    if reduction > 1:
        size = camera.width // reduction, camera.height // reduction
        grey = cv2.resize(grey[: size[1] * reduction, : size[0] * reduction], size, interpolation=cv2.INTER_AREA)
    return Picture(grey, reduction, camera)


def window_of(half: Array, px_per_pitch: Array) -> tuple[Window, int]:
    """Return the window for buttons of half size (2,) in pitches, and by what the image may be reduced for it.

    px_per_pitch: (M, 2, 2) pixels (second axis) per pitch along columns and rows (last axis), at each button.
    """
    half_window = np.minimum(_WINDOW * half, _WIDEST_PITCH)
    length = 2.0 * float((half_window * np.linalg.norm(px_per_pitch.mean(axis=0), axis=0)).max())
    # The more buttons, the less each one has to be seen.
    most = min(_MOST, int(np.sqrt(_ALL / len(px_per_pitch))))
    samples = max(_FEWEST, min(int(length / _STEP_PX), most) // 2 * 2 + 1)
    step = length / (samples - 1)
    return Window(half_window, samples), int(step) if step > _COARSEST_PX else 1


def half_size_pitch(sizes_px: Array, px_per_pitch: Array, usual: Array) -> Array:
    """Return the buttons' half size (2,) in pitches, from their boxes (M, 2) px; `usual` where they have none.

    An ellipse of half axes h has a box of (w / 2)^2 = h_u^2 d_xu^2 + h_v^2 d_xv^2, linear in the squares;
    px_per_pitch: (M, 2, 2) at each button.
    """
    known = (sizes_px > 0).all(axis=1)
    if known.sum() < 2:
        return usual
    A = (px_per_pitch[known] ** 2).reshape(-1, 2)
    b = 0.25 * (sizes_px[known] ** 2).reshape(-1)
    # Every equation counts by its own size: boxes that hold a label too are the largest.
    squares = np.linalg.lstsq(A / b[:, None], np.ones(len(b)), rcond=None)[0]
    if not (squares > 0).all():
        return usual
    return np.asarray(np.clip(np.sqrt(squares), _SMALLEST_HALF, _LARGEST_HALF))


def sample(picture: Picture, G: Array, nodes: Array, window: Window) -> tuple[Array, Array]:
    """Return patches (M, n, n) float32 around lattice points (M, 2), and which samples lie in the image (M, n, n).

    G: (3, 3) from (column, row, 1) to the normalised plane.
    """
    n, camera = window.samples, picture.camera
    knots = np.linspace(-1.0, 1.0, _KNOTS)
    offsets = np.stack(np.meshgrid(knots, knots), axis=-1).reshape(-1, 2) * window.half
    points = (nodes[:, None] + offsets) @ G[:, :2].T + G[:, 2]
    pixels = np.clip(np.nan_to_num(camera.project(points), nan=-1e4), -1e4, 1e4)
    coarse = np.moveaxis(pixels.reshape(len(nodes), _KNOTS, _KNOTS, 2), 3, 1).astype(np.float32)
    between = _interpolation(n)
    x, y = np.moveaxis(between @ coarse @ between.T, 1, 0)
    inside = (x >= 0.0) & (y >= 0.0) & (x <= camera.width - 1.0) & (y <= camera.height - 1.0)
    if picture.reduction > 1:
        x, y = ((p + 0.5) / picture.reduction - 0.5 for p in (x, y))
    flat = [np.ascontiguousarray(p.reshape(-1, n)) for p in (x, y)]
    patches = cv2.remap(picture.grey, *flat, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return patches.reshape(-1, n, n).astype(np.float32), inside


@cache
def _interpolation(n: int) -> Array:
    """Return the matrix (n, knots) of Lagrange's cubic polynomials."""
    knots, at = np.linspace(-1.0, 1.0, _KNOTS), np.linspace(-1.0, 1.0, n)
    columns = [
        np.prod([(at - knots[j]) / (knots[k] - knots[j]) for j in range(_KNOTS) if j != k], axis=0)
        for k in range(_KNOTS)
    ]
    return np.asarray(np.stack(columns, axis=-1), dtype=np.float32)
