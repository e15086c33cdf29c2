"""Random crops of labelled pictures: scale, aspect, roll, perspective, light, blur, noise, compression."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from elevator_rectify.train.labelled import LabelledPicture
from elevator_rectify.train.second_look import NOTHING_SEEN, SecondLook

Array = NDArray[np.float64]
Image = NDArray[Any]


@dataclass(frozen=True)
class Crop:
    """A crop with its boxes (N, 4), whether each is a button (N,), and which may be learnt from rather than ignored."""

    image: Image
    boxes_px: Array
    is_button: NDArray[np.bool_]
    learnt: NDArray[np.bool_]


def random_crop(
    picture: LabelledPicture,
    size_px: int,
    rng: np.random.Generator,
    look: SecondLook = NOTHING_SEEN,
    at_no_button: bool = False,
) -> Crop:
    """Cut a random square view out of the picture, around one of its boxes more often than not.

    look: what is no button, around one of which the view is where `at_no_button`, and what is not to be learnt from.
    """
    around = look.no_button_px if at_no_button else picture.boxes_px.astype(float)
    H = _random_homography(picture, around, size_px, rng)
    border = cv2.BORDER_REPLICATE if rng.random() < 0.3 else cv2.BORDER_CONSTANT
    fill = tuple(int(v) for v in rng.integers(0, 255, 3))
    image = cv2.warpPerspective(
        picture.image, H, (size_px, size_px), flags=cv2.INTER_LINEAR, borderMode=border, borderValue=fill
    )
    boxes = warped_boxes(np.concatenate([picture.boxes_px.astype(float), look.unsure_px]), H)
    clipped = np.clip(boxes, 0, size_px)
    area = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
    seen = np.prod(clipped[:, 2:] - clipped[:, :2], axis=1) / np.maximum(area, 1e-6)
    keep = seen > 0.05
    learnt = (seen > 0.65) & ((clipped[:, 2:] - clipped[:, :2]).min(axis=1) >= 5)
    learnt[len(picture.boxes_px) :] = False
    is_button = np.concatenate([picture.is_button, np.ones(len(look.unsure_px), dtype=bool)])
    return Crop(random_light(image, rng), clipped[keep], is_button[keep], learnt[keep])


def _random_homography(picture: LabelledPicture, around_px: Array, size_px: int, rng: np.random.Generator) -> Array:
    """Return the (3, 3) map from the picture to the crop; around_px: boxes (N, 4) of which one is near its middle."""
    height, width = picture.image.shape[:2]
    scale, aspect = np.exp(rng.uniform(np.log(0.65), np.log(2.7))), np.exp(rng.normal(0, 0.2) / 2)
    roll = np.radians(rng.normal(0, 4 if rng.random() < 0.8 else 12))
    flip = -1.0 if rng.random() < 0.5 else 1.0
    cosine, sine = np.cos(roll), np.sin(roll)
    linear = scale * np.array([[cosine, -sine], [sine, cosine]]) @ np.diag([flip * aspect, 1 / aspect])
    if rng.random() < 0.8 and len(around_px):
        box = around_px[rng.integers(len(around_px))]
        centre = (box[:2] + box[2:]) / 2 + rng.uniform(-0.45, 0.45, 2) * size_px / scale
    else:
        centre = rng.uniform(0, 1, 2) * np.array([width, height])
    H = np.eye(3)
    H[:2, :2] = linear
    H[:2, 2] = size_px / 2 - linear @ centre
    tilt = np.eye(3)
    tilt[2, :2] = rng.normal(0, 0.12, 2) / size_px
    middle = np.array([[1, 0, size_px / 2], [0, 1, size_px / 2], [0, 0, 1.0]])
    return np.asarray(middle @ tilt @ np.linalg.inv(middle) @ H)


def warped_boxes(boxes_px: Array, H: Array) -> Array:
    """Return the (N, 4) upright boxes around the warped ones, a little smaller where the warp turns them."""
    x, y = boxes_px[:, [0, 2]], boxes_px[:, [1, 3]]
    mx, my = x.mean(axis=1), y.mean(axis=1)
    # The middles of the four sides: a round or rounded button touches its box there.
    points = np.stack([[x[:, 0], my], [x[:, 1], my], [mx, y[:, 0]], [mx, y[:, 1]]]).transpose(2, 0, 1)
    corners = np.stack([[x[:, i], y[:, j]] for i in (0, 1) for j in (0, 1)]).transpose(2, 0, 1)
    return np.asarray(0.5 * (_extent(points, H) + _extent(corners, H)))


def _extent(points: Array, H: Array) -> Array:
    """Return (N, 4) the extent of (N, K, 2) points after the warp."""
    moved = points @ H[:2, :2].T + H[:2, 2]
    moved = moved / np.maximum(points @ H[2, :2] + H[2, 2], 0.2)[..., None]
    return np.concatenate([moved.min(axis=1), moved.max(axis=1)], axis=1)


def random_light(image: Image, rng: np.random.Generator) -> Image:
    """Change colours, brightness, contrast, sharpness; add noise, compression, a glare or a shadow."""
    work: Image = image.astype(np.float32)
    work = (work - 128) * np.exp(rng.normal(0, 0.25)) + 128 + rng.normal(0, 22)
    work *= np.exp(rng.normal(0, 0.08, 3)).astype(np.float32)
    if rng.random() < 0.12:
        work = np.repeat(work.mean(axis=2, keepdims=True), 3, axis=2)
    if rng.random() < 0.1:
        work = 255 - work
    if rng.random() < 0.3:
        work += _blob(image.shape[0], rng)[..., None] * rng.normal(0, 90)
    work = np.clip(work, 0, 255)
    if rng.random() < 0.3:
        work = 255 * (work / 255) ** np.float32(np.exp(rng.normal(0, 0.35)))
    if rng.random() < 0.25:
        work = cv2.GaussianBlur(work, (0, 0), float(rng.uniform(0.4, 1.8)))
    if rng.random() < 0.3:
        work += rng.normal(0, rng.uniform(1, 12), work.shape).astype(np.float32)
    out = np.clip(work, 0, 255).astype(np.uint8)
    if rng.random() < 0.25:
        _, data = cv2.imencode(".jpg", out, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(20, 85))])
        out = cv2.imdecode(data, cv2.IMREAD_COLOR)
    return out


def _blob(size_px: int, rng: np.random.Generator) -> Image:
    """Return a soft spot or band of light, up to 1."""
    y, x = np.mgrid[0:size_px, 0:size_px].astype(np.float32) / size_px
    cx, cy = rng.uniform(0, 1, 2)
    sx, sy = np.exp(rng.normal(-1.8, 0.7, 2))
    return np.asarray(np.exp(-0.5 * (((x - cx) / sx) ** 2 + ((y - cy) / sy) ** 2)))
