"""Reads buttons by a network of our own: patches in the panel's plane, one batch for a panel, distributions out.

What is read is a probability of every label that the vocabulary can say, not a word; a button that cannot be read has
most of it on 'unreadable'.
"""

from __future__ import annotations

import hashlib
import json
import lzma
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.pose import jacobians_px, on_plane
from elevator_rectify.core.geometry.same_places import stayed
from elevator_rectify.core.reading.carried import as_before
from elevator_rectify.core.reading.vocabulary import BLANK, CHARACTERS, KINDS, SLOTS, SYMBOLS
from elevator_rectify.core.types import Array, Detection, FitResult, FitT, Image

WEIGHTS = Path(__file__).with_name("reader.onnx.xz")
# Side of a patch, and what it shows over the box; the network looks at the whole and, closer, at the middle.
PATCH_PX, MARGIN = 96, 1.25
# Smaller buttons than this, in pixels, are read less surely in other ways than larger ones.
_LARGE_PX = 20.0
# Pictures that are shrunk by more than this are smoothed first.
SHARPEST = 1.6
# What is read as no button with so much is none, on a panel whose buttons are usually read as such with less, and with
# odds that are so many times less.
_NO_BUTTON, _USUAL_OTHER, _UNUSUAL = 0.5, 0.5, 10.0
# So many buttons tell what is usual on a panel.
_SAMPLE = 8
# Labels that are likely enough to be told; a text's slots are searched by so many characters each.
_MOST_LABELS, _MOST_CHARACTERS, _LEAST = 5, 3, 1e-3
# Patches whose logits are kept, by their bytes.
_KEPT = 128
_last_logits: dict[tuple[Path, bytes], Array] = {}
# Written by `calibrate --reader`: the temperatures that soften the network's certainty.
CALIBRATION = Path(__file__).with_name("reader.json")


@dataclass(frozen=True)
class Read:
    """What a button says: (label, probability) of the likeliest labels, best first; other: that it is no button."""

    labels: tuple[tuple[str, float], ...]
    other: float

    @property
    def label(self) -> str:
        """Return the likeliest label, '' where none is likelier than that there is nothing to read."""
        return self.labels[0][0] if self.labels and self.labels[0][1] > 1.0 - self.certainty else ""

    @property
    def certainty(self) -> float:
        """Return the probability that there is a label at all."""
        return float(sum(p for _, p in self.labels))


@cache
def _network(path: Path) -> Any:
    return cv2.dnn.readNetFromONNX(np.frombuffer(lzma.decompress(path.read_bytes()), dtype=np.uint8))


def read_patches(patches: Sequence[Image], weights: Path = WEIGHTS) -> list[Read]:
    """Read square patches (96, 96[, 3]) uint8 in one batch."""
    return [_read(logits) for logits in logits_of(patches, weights) / temperatures()[1]]


def logits_of(patches: Sequence[Image], weights: Path = WEIGHTS) -> Array:
    """Return the network's logits (N, kinds and slots).

    Whether labels stand upright, and which cells hold no button, is asked before they are read: the last patches are
    kept.
    """
    keys = [(weights, hashlib.sha256(np.ascontiguousarray(p).data).digest()) for p in patches]
    new = {key: p for key, p in zip(keys, patches, strict=True) if key not in _last_logits}
    if new:
        network = _network(weights)
        network.setInput(np.stack([normalised(p) for p in new.values()]))
        _last_logits.update(zip(new, np.array(network.forward()), strict=True))
    logits = np.array([_last_logits[key] for key in keys]).reshape(len(keys), len(KINDS) + SLOTS * (BLANK + 1))
    for key in list(_last_logits)[:-_KEPT]:
        del _last_logits[key]
    return logits


@cache
def temperatures() -> tuple[float, float]:
    """Return the temperatures of small buttons and of large ones."""
    table = json.loads(CALIBRATION.read_text())["temperature"]
    return float(table["small"]), float(table["large"])


def normalised(patch: Image) -> NDArray[np.float32]:
    """Return the patch (96, 96[, 3]) as (3, 96, 96), its brightness of mean 0 and standard deviation 1."""
    colours = cv2.cvtColor(patch, cv2.COLOR_GRAY2BGR) if patch.ndim == 2 else patch
    grey = cv2.cvtColor(colours, cv2.COLOR_BGR2GRAY).astype(np.float32)
    planes = (colours.astype(np.float32) - grey.mean()) / (grey.std() + np.float32(8.0))
    return np.ascontiguousarray(planes.transpose(2, 0, 1))


def _read(logits: Array) -> Read:
    """Return the labels of one patch's logits of kinds and slots."""
    kind = _softmax(logits[: len(KINDS)])
    slots = _softmax(logits[len(KINDS) :].reshape(SLOTS, BLANK + 1))
    found = {name: float(kind[KINDS.index(name)]) for name in SYMBOLS}
    for text, p in _texts(slots).items():
        found[text] = found.get(text, 0.0) + float(kind[KINDS.index("text")]) * p
    best = sorted(found.items(), key=lambda item: -item[1])[:_MOST_LABELS]
    return Read(tuple((label, p) for label, p in best if p > _LEAST), float(kind[KINDS.index("other")]))


def _softmax(logits: Array) -> Array:
    e = np.exp(logits - logits.max(axis=-1, keepdims=True))
    return np.asarray(e / e.sum(axis=-1, keepdims=True))


def _texts(slots: Array) -> dict[str, float]:
    """Return the likeliest texts: characters up to the first blank, of the best few of every slot."""
    texts = {"": 1.0}
    done: dict[str, float] = {}
    for slot in slots:
        best = np.argsort(-slot)[:_MOST_CHARACTERS]
        longer: dict[str, float] = {}
        for text, p in texts.items():
            for c in best:
                if c == BLANK:
                    done[text] = done.get(text, 0.0) + p * float(slot[c])
                else:
                    longer[text + CHARACTERS[c]] = p * float(slot[c])
        texts = dict(sorted(longer.items(), key=lambda item: -item[1])[: _MOST_CHARACTERS**2])
    done.update(texts)
    done.pop("", None)
    return done


def read_boxes(image: Image, detections: Sequence[Detection], weights: Path = WEIGHTS) -> list[Read]:
    """Read the boxes of a picture as they are, without a pose."""
    return read_quadrangles(image, box_corners_px(detections), weights)


def box_corners_px(detections: Sequence[Detection]) -> list[Array]:
    """Return the corners (4, 2) of the boxes with their margin, clockwise from the upper left."""
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * MARGIN
    return [np.array([d.x_px, d.y_px]) + square * np.maximum([d.width_px, d.height_px], 4.0) for d in detections]


def read_in_plane(image: Image, camera: Camera, fit: FitResult, which: Sequence[int] | None = None) -> list[Read]:
    """Read the detections of an accepted fit, or some of them, each in the panel's plane: upright, from the front."""
    corners = plane_corners_px(fit, camera, fit.detections)
    return read_quadrangles(image, corners if which is None else [corners[k] for k in which])


def plane_corners_px(fit: FitResult, camera: Camera, detections: Sequence[Detection]) -> list[Array]:
    """Return the corners (4, 2) in the picture of the fit's detections with their margin, as squares of the panel's
    plane, clockwise from the upper left; NaN for those that the fit does not use, or that have no size."""
    place, size = on_plane(fit.R_camera_panel, fit.t_camera_panel, fit.rays)[0], _units(fit, camera, detections)
    sound = np.isfinite(place).all(axis=1) & np.isfinite(size).all(axis=1)
    corners = np.full((len(size), 4, 2), np.nan)
    corners[sound] = _corners_px(fit, camera, place[sound], size[sound])
    return list(corners)


def no_buttons(image: Image, camera: Camera, fit: FitResult) -> set[tuple[int, int]]:
    """Return the cells in which the picture shows something like the buttons, nothing was detected, and the reader
    sees no button: a display, a keyhole, bare metal."""
    cells = _undetected_cells(fit)
    detected = sorted({(int(row), int(column)) for row, column in fit.cells if row >= 0})
    # Some of the buttons, from all over the panel.
    sample = detected[:: max(1, -(-len(detected) // _SAMPLE))]
    if not cells or not sample:
        return set()
    other = [read.other for read in _read_cells(image, camera, fit, [*cells, *sample])]
    # Buttons without print are read as no buttons, too: then nothing can be said.
    usual = float(np.median(other[len(cells) :]))
    if not usual < _USUAL_OTHER:
        return set()
    odds = _UNUSUAL * usual / (1.0 - usual)
    return {cell for cell, o in zip(cells, other, strict=False) if o > max(_NO_BUTTON, odds / (1.0 + odds))}


def read_undetected(image: Image, camera: Camera, fit: FitT, last: FitResult | None = None) -> FitT:
    """Return the fit with the buttons that the picture shows and nobody detected, as they are read.

    last: a fit to a frame just before, in which the same cells were read.
    """
    cells = [cell for cell in _undetected_cells(fit) if cell not in fit.undetected]
    if not cells or fit.measurement is None:
        return fit
    boxes = {}
    for cell in cells:
        width, height = np.ptp(_cell_corners_px(fit, camera, cell), axis=0) / MARGIN
        x, y = fit.measurement.centre_px[cell]
        boxes[cell] = Detection(float(x), float(y), float(width), float(height))
    before = {} if last is None or not stayed(fit, last) else last.undetected
    known = {cell: as_before(boxes[cell], read) for cell in cells if (read := before.get(cell)) is not None}
    unread = [cell for cell in cells if cell not in known]
    reads = labelled([boxes[cell] for cell in unread], _read_cells(image, camera, fit, unread))
    return replace(fit, undetected={**fit.undetected, **known, **dict(zip(unread, reads, strict=True))})


def _undetected_cells(fit: FitResult) -> list[tuple[int, int]]:
    """Return the cells of an accepted fit in which the picture shows a button and nothing was detected."""
    if not fit.ok or fit.measurement is None:
        return []
    empty = np.isfinite(fit.measurement.correlation)
    empty[tuple(fit.cells[fit.cells[:, 0] >= 0].T)] = False
    return [(int(row), int(column)) for row, column in np.argwhere(empty)]


def _read_cells(image: Image, camera: Camera, fit: FitResult, cells: Sequence[tuple[int, int]]) -> list[Read]:
    return read_quadrangles(image, [_cell_corners_px(fit, camera, cell) for cell in cells])


def _cell_corners_px(fit: FitResult, camera: Camera, cell: tuple[int, int]) -> Array:
    """Return the corners (4, 2) of the button that the picture shows in a cell, or that would be there."""
    if fit.measurement is None:
        return np.full((4, 2), np.nan)
    shown = np.isfinite(fit.measurement.centre_px[cell]).all()
    ray = camera.rays(fit.measurement.centre_px[cell] if shown else fit.grid_px[cell])
    place = on_plane(fit.R_camera_panel, fit.t_camera_panel, ray)[0]
    return np.asarray(_corners_px(fit, camera, place, 2.0 * fit.measurement.half_size[None])[0])


def _corners_px(fit: FitResult, camera: Camera, place: Array, size: Array) -> Array:
    """Return the corners (N, 4, 2) in the picture of buttons with their margin; place, size: (N, 2) on the panel."""
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.5 * MARGIN
    plane = (place[:, None] + square * size[:, None]).reshape(-1, 2)
    return camera.project(plane @ fit.R_camera_panel[:, :2].T + fit.t_camera_panel).reshape(-1, 4, 2)


def read_quadrangles(image: Image, corners_px: Sequence[Array], weights: Path = WEIGHTS) -> list[Read]:
    """Read the picture's quadrangles (4, 2), clockwise from the upper left; NaN reads as nothing."""
    temperature = np.where([is_small(c) for c in corners_px], *temperatures())
    return [_read(logits) for logits in quadrangle_logits(image, corners_px, weights) / temperature[:, None]]


def is_small(corners_px: Array) -> bool:
    """Tell whether a quadrangle (4, 2) of the picture shows a button of less than 20 pixels; True for NaN."""
    return not _side_px(np.nan_to_num(corners_px)) >= _LARGE_PX * MARGIN


def quadrangle_logits(image: Image, corners_px: Sequence[Array], weights: Path = WEIGHTS) -> Array:
    """Return the logits of the picture's quadrangles (4, 2), clockwise from the upper left, NaN where there is none."""
    blank = np.zeros((PATCH_PX, PATCH_PX), np.uint8)
    return logits_of([quadrangle_patch(image, c) if np.isfinite(c).all() else blank for c in corners_px], weights)


def _units(fit: FitResult, camera: Camera, detections: Sequence[Detection]) -> Array:
    """Return width and height (N, 2) of the detections' boxes on the panel, in the fit's unit; NaN where unknown.

    Detections without a size have that of the buttons which the picture shows.
    """
    box = np.array([[d.width_px, d.height_px] for d in detections], dtype=float).reshape(-1, 2)
    used, has_size = np.isfinite(fit.rays).all(axis=1), (box > 0.0).all(axis=1)
    sized = used & has_size
    sizes = np.full((len(box), 2), np.nan)
    if fit.measurement is not None:
        sizes[used & ~has_size] = 2.0 * fit.measurement.half_size
    places = on_plane(fit.R_camera_panel, fit.t_camera_panel, fit.rays[sized])[0]
    # NaN beyond the horizon of the panel's plane.
    sizes[sized] = _box_on_panel(np.abs(jacobians_px(fit, places, camera)), box[sized])
    return sizes


def _box_on_panel(A: Array, box_px: Array) -> Array:
    """Return the sizes (N, 2) on the panel of ellipses with boxes (N, 2): squares add (`patches.half_size_pitch`).

    A: (N, 2, 2) absolute derivatives of pixels by the place. Where no ellipse has that box, the size is that of a
    rectangle as it would be without shear.
    """
    (a, b), (c, d) = (A**2).transpose(1, 2, 0)
    width, height = (box_px**2).T
    with np.errstate(divide="ignore", invalid="ignore"):
        squares = np.column_stack([d * width - b * height, a * height - c * width]) / (a * d - b * c)[:, None]
    usual = box_px / np.maximum(np.diagonal(A, axis1=1, axis2=2), 1e-9)
    real = np.isfinite(squares).all(axis=1) & (squares > 0.0).all(axis=1)
    return np.where(real[:, None], np.sqrt(np.where(real[:, None], squares, 0.0)), usual)


def _side_px(corners_px: Array) -> float:
    return float(np.sqrt(abs(cv2.contourArea(corners_px.astype(np.float32)))))


def quadrangle_patch(image: Image, corners_px: Array) -> Image:
    """Return the quadrangle (4, 2) of the picture, clockwise from its upper left corner, as a square patch."""
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32) * PATCH_PX - 0.5
    factor = max(1.0, _side_px(corners_px) / PATCH_PX)
    M = cv2.getPerspectiveTransform(corners_px.astype(np.float32), square)
    low = np.clip(np.floor(corners_px.min(axis=0)) - 4, 0, [image.shape[1] - 1, image.shape[0] - 1]).astype(int)
    high = np.clip(np.ceil(corners_px.max(axis=0)) + 5, low + 1, [image.shape[1], image.shape[0]]).astype(int)
    part = image[low[1] : high[1], low[0] : high[0]]
    if factor > SHARPEST:
        part = cv2.GaussianBlur(part, (0, 0), 0.4 * factor)
    shift = np.array([[1, 0, low[0]], [0, 1, low[1]], [0, 0, 1.0]])
    patch: Image = cv2.warpPerspective(part, M @ shift, (PATCH_PX, PATCH_PX), borderMode=cv2.BORDER_REPLICATE)
    return patch


def labelled(detections: Sequence[Detection], reads: Sequence[Read]) -> tuple[Detection, ...]:
    """Return the detections with what was read where they bring no label of their own."""
    return tuple(d if d.label else _with_read(d, r) for d, r in zip(detections, reads, strict=True))


def _with_read(detection: Detection, read: Read) -> Detection:
    if not read.label:
        return replace(detection, readings=read.labels)
    return replace(detection, label=read.label, score=read.labels[0][1], readings=read.labels)
