"""Find the buttons of a picture: one pass over all of it, a second one where it shows hardly any, a finer one over the
panel where its buttons are small."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from pathlib import Path

import numpy as np

from elevator_rectify.core.config import NetworkConfig
from elevator_rectify.core.detector.network import heat_map
from elevator_rectify.core.detector.peaks import Boxes, peaks, probabilities, suppressed
from elevator_rectify.core.types import Array, BoolArray, Detection, Image

# Written by `calibrate --detector`: how probable a peak of some heat is a button.
SCORES = Path(__file__).with_name("scores.json")
DEFAULT_NETWORK = NetworkConfig()
# Below this side in the network's input buttons are worth a finer look; then they are brought to about that side.
_SMALL_PX, _FINE_PX = 22.0, 30.0
# The finer pass takes a region of so many times the boxes' extent, where at least so many surely are.
_MARGIN, _FEWEST, _SURE = 0.15, 3, 0.3
# Pictures are not enlarged beyond what the network has learnt from.
_LARGEST_SCALE = 2.5
# It costs no more than this many of the first pass's pixels.
_MOST_AREA = 3.0
# Where hardly a button is seen, a larger picture is looked at again at so many times the scale, but not enlarged.
_AGAIN = 1.4
# A pass at less than so many times the scale of the one before shows nothing new.
_FINER = 1.2
# A part that is more than this share of the picture is not looked at by itself.
_MOST_OF_IT = 0.7
# With fewer buttons there is no lattice that would tell them from other things.
_FEW = 6
# A part of the picture: xmin, ymin, xmax, ymax, without the last column and row.
Region = tuple[int, int, int, int]
# By picture and the side at which it was looked at: of the last one only.
_last_found: dict[tuple[bytes, tuple[int, ...], int], Boxes] = {}


@cache
def score_model() -> Array:
    """Return the coefficients of the scores."""
    return np.array(json.loads(SCORES.read_text())["coefficients"], dtype=float)


def detect_buttons(image: Image, config: NetworkConfig = DEFAULT_NETWORK) -> list[Detection]:
    """Return the buttons in a picture (height, width[, 3]) uint8, BGR or grey, the surest first.

    Scores are probabilities that a button is there; those below `config.min_score` are left out. Displays, keyholes,
    speakers and plates are told from buttons and left out. Deterministic. Raises ValueError for another kind of array.
    """
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        shape = "(height, width) or (height, width, 3)"
        raise ValueError(f"image must be uint8 of {shape}, not {image.dtype} of {image.shape}")
    found = find_boxes(image, config)
    score = probabilities(found, score_model())
    order = np.argsort(-score, kind="stable")
    chosen = order[found.is_button[order] & (score[order] >= config.min_score)]
    if len(chosen) < _FEW:
        chosen = chosen[score[chosen] >= config.min_score_few]
    return [_detection(found.boxes_px[k], float(score[k])) for k in chosen]


def find_boxes(image: Image, config: NetworkConfig = DEFAULT_NETWORK) -> Boxes:
    """Return all boxes of all passes, other things too.

    A fit asks for them several times: those of the last picture, known by its bytes, are kept.
    """
    key = _key_of(image, config)
    found = _last_found.get(key)
    if found is None:
        found = _found(image, config)
        _last_found.clear()
        _last_found[key] = found
    return found


def boxes_at(image: Image, centres_px: Array, sizes_px: Array, config: NetworkConfig = DEFAULT_NETWORK) -> Boxes:
    """Return the boxes that a picture shows at given ones, and around them: centres (N, 2) and sizes (N, 2) in pixels.

    Only their part of the picture is looked at, unless all of it was, or the part is most of it.
    """
    known = _last_found.get(_key_of(image, config))
    if known is not None:
        return known
    scale = _first_scale(image, config)
    side = float(np.median(np.sqrt(sizes_px.prod(axis=1))))
    low, high = (centres_px - sizes_px / 2.0).min(axis=0), (centres_px + sizes_px / 2.0).max(axis=0)
    x0, y0, x1, y1 = region = _region(low, high, side, image)
    part = max(x1 - x0, 0) * max(y1 - y0, 0) / (image.shape[0] * image.shape[1])
    if not (side > 0.0 and 0.0 < part < _MOST_OF_IT):
        return find_boxes(image, config)
    finer = _finer_scale(region, scale, side, image) if scale * side < _SMALL_PX else scale
    return _seen_in(image, region, max(scale, finer))


def _key_of(image: Image, config: NetworkConfig) -> tuple[bytes, tuple[int, ...], int]:
    picture = hashlib.sha256(np.ascontiguousarray(image).data).digest()
    return picture, image.shape, config.detector_side_px


def _first_scale(image: Image, config: NetworkConfig) -> float:
    return float(min(config.detector_side_px / max(image.shape[:2]), _LARGEST_SCALE))


def _found(image: Image, config: NetworkConfig) -> Boxes:
    scale = _first_scale(image, config)
    found = peaks(heat_map(image, scale))
    again = min(1.0, _AGAIN * scale)
    if _sure(found).sum() < _FEWEST and again > _FINER * scale:
        scale, found = again, peaks(heat_map(image, again))
    small = _small_region(found, scale, image)
    if small is None:
        return found
    region, finer = small
    return _joined(found, _seen_in(image, region, finer), np.array(region, dtype=float))


def _seen_in(image: Image, region: Region, scale: float) -> Boxes:
    """Return the boxes in a part of the picture, looked at by itself."""
    x0, y0, x1, y1 = region
    seen = peaks(heat_map(np.ascontiguousarray(image[y0:y1, x0:x1]), scale))
    return Boxes(seen.boxes_px + np.array([x0, y0, x0, y0], dtype=float), seen.heat, seen.is_button)


def _sure(found: Boxes) -> BoolArray:
    """Return (N,) which boxes surely are buttons."""
    return found.is_button & (found.heat > _SURE)


def _small_region(found: Boxes, scale: float, image: Image) -> tuple[Region, float] | None:
    """Return the part of the picture and the scale of a finer pass, None where it is not needed or does not help."""
    sure = _sure(found)
    if sure.sum() < _FEWEST:
        return None
    boxes = found.boxes_px[sure]
    side = float(np.median(np.sqrt(np.prod(boxes[:, 2:] - boxes[:, :2], axis=1))))
    if scale * side >= _SMALL_PX:
        return None
    region = _region(boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0), side, image)
    finer = _finer_scale(region, scale, side, image)
    return (region, finer) if finer > _FINER * scale else None


def _region(low: Array, high: Array, side: float, image: Image) -> Region:
    """Return the part of the picture around boxes of that extent and usual side."""
    margin = np.maximum(_MARGIN * (high - low), 3.0 * side)
    height, width = image.shape[:2]
    x0, y0 = np.maximum(low - margin, 0.0).astype(int)
    x1, y1 = np.minimum(high + margin + 1.0, [width, height]).astype(int)
    return int(x0), int(y0), int(x1), int(y1)


def _finer_scale(region: Region, scale: float, side: float, image: Image) -> float:
    """Return the scale at which a region's buttons of some side are large enough, as far as it does not cost too
    much."""
    x0, y0, x1, y1 = region
    height, width = image.shape[:2]
    most = np.sqrt(_MOST_AREA * scale**2 * height * width / max(1, (x1 - x0) * (y1 - y0)))
    return float(min(_FINE_PX / side, most, _LARGEST_SCALE))


def _joined(coarse: Boxes, fine: Boxes, region: Array) -> Boxes:
    """Return the finer boxes within the region, the coarse ones outside; of overlapping ones the best."""
    centre = (coarse.boxes_px[:, :2] + coarse.boxes_px[:, 2:]) / 2.0
    outside = ~((centre > region[:2]) & (centre < region[2:])).all(axis=1)
    boxes = np.concatenate([fine.boxes_px, coarse.boxes_px[outside]])
    heat = np.concatenate([fine.heat, coarse.heat[outside]])
    button = np.concatenate([fine.is_button, coarse.is_button[outside]])
    order = np.argsort(-heat, kind="stable")
    return suppressed(Boxes(boxes[order], heat[order], button[order]))


def _detection(box: Array, score: float) -> Detection:
    x0, y0, x1, y1 = (float(v) for v in box)
    # The network counts pixels by their corners, detections by their middles: (0, 0) is the corner pixel's middle.
    return Detection((x0 + x1) / 2.0 - 0.5, (y0 + y1) / 2.0 - 0.5, x1 - x0, y1 - y0, "", score)
