"""A picture of each stage of a fit: `python3 -m elevator_rectify.benchmark.stages docs/pictures` (docs/method.md)."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from elevator_rectify.benchmark.pictures import Pictured, pictured
from elevator_rectify.core.config import Config
from elevator_rectify.core.lattice.hypotheses import grown_hypotheses
from elevator_rectify.core.pipeline import admitted, fit_panel
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.types import Array, FitResult, Image
from elevator_rectify.core.view.draw import caption, draw_overlay, draw_rectified
from elevator_rectify.core.view.warp import rectify_image
from elevator_rectify.recordings.report import tiled

_CONFIG = Config()
_LEVEL, _SEED, _NUMBER = "medium", 60, 4
# Lattices that are drawn, and their extent in cells.
_DRAWN, _EXTENT = 6, 8
_COLOURS = ((60, 220, 60), (50, 50, 235), (250, 170, 40), (40, 170, 250), (220, 60, 220), (220, 220, 60))
_PATCH_PX, _PATCH_COLUMNS = 84, 7


def stage_pictures(given: Pictured) -> dict[str, Image]:
    """Return the pictures by name, in the order of the stages."""
    scene, image = given.scene, given.image
    boxes = fit_panel(scene.detections, scene.camera, _CONFIG)
    fit = fit_panel(scene.detections, scene.camera, _CONFIG, image=image)
    view = rectify_image(image, scene.camera, fit)
    return {
        "1_detections": with_boxes(given),
        "2_hypotheses": with_hypotheses(given),
        "3_lattice": draw_overlay(image, scene.centres_px, boxes),
        "4_patches": patches_of(given, fit),
        "5_rectified": caption(draw_rectified(view, fit.buttons), ["rectified view, labels as read together"]),
    }


def with_boxes(given: Pictured) -> Image:
    """Return the image with the detector's boxes."""
    canvas = given.image.copy()
    for d in given.scene.detections:
        half = np.array([d.width_px, d.height_px]) / 2.0
        low, high = (np.round(np.array([d.x_px, d.y_px]) + sign * half).astype(int) for sign in (-1, 1))
        cv2.rectangle(canvas, (int(low[0]), int(low[1])), (int(high[0]), int(high[1])), _COLOURS[0], 1, cv2.LINE_AA)
    return caption(canvas, [f"{len(given.scene.detections)} detections"])


def with_hypotheses(given: Pictured) -> Image:
    """Return the image with some of the grown lattice hypotheses, a colour each."""
    scene = given.scene
    usable, sigma, _ = admitted(scene.detections, scene.camera, _CONFIG)
    narrow = replace(_CONFIG.hypotheses, seeds=12)
    maps, _ = grown_hypotheses(usable.rays, sigma, narrow)
    canvas = given.image.copy()
    for G, colour in zip(maps[:: max(1, len(maps) // _DRAWN)], _COLOURS, strict=False):
        for line in lattice_lines(G):
            pixels = scene.camera.project(np.column_stack([line, np.ones(len(line))]))
            cv2.polylines(canvas, [np.clip(pixels, -1e4, 1e4).round().astype(np.int32)], False, colour, 1, cv2.LINE_AA)
    return caption(canvas, [f"{min(_DRAWN, len(maps))} of {len(maps)} hypotheses"])


def lattice_lines(G: Array) -> list[Array]:
    """Return the lines (K, 2) of a lattice in the normalised plane, as far as they are before the camera."""
    ticks, lines = np.arange(-_EXTENT, _EXTENT + 1.0), []
    for k in ticks:
        for points in (
            np.column_stack([np.full_like(ticks, k), ticks]),
            np.column_stack([ticks, np.full_like(ticks, k)]),
        ):
            mapped = np.column_stack([points, np.ones(len(points))]) @ G.T
            before = mapped[mapped[:, 2] > 0.3 * abs(float(G[2, 2]))]
            if len(before) > 1:
                lines.append(before[:, :2] / before[:, 2:])
    return lines


def patches_of(given: Pictured, fit: GridFit) -> Image:
    """Return the buttons' patches, rectified, with their measured centres, and their median: the common template."""
    patches = [_patch(given.image, given.scene.camera.matrix, fit, point) for point in fit.grid_points.reshape(-1, 3)]
    template = np.median(np.stack(patches), axis=0).astype(np.uint8)
    tiles = [
        cv2.drawMarker(p.copy(), (_PATCH_PX // 2, _PATCH_PX // 2), _COLOURS[1], cv2.MARKER_CROSS, 12) for p in patches
    ]
    tiles.append(cv2.copyMakeBorder(template, 3, 3, 3, 3, cv2.BORDER_CONSTANT, value=_COLOURS[0])[3:-3, 3:-3])
    return tiled(tiles, _PATCH_COLUMNS)


def _patch(image: Image, K: Array, fit: FitResult, point: Array) -> Image:
    """Return the square around a cell (3,) in the camera frame, of a pitch's side, warped upright."""
    half = 0.5 * float(fit.pitch[0])
    corners = [
        point + fit.R_camera_panel @ np.array([x * half, y * half, 0.0])
        for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    pixels = np.array([(K @ c)[:2] / c[2] for c in corners], dtype=np.float32)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32) * (_PATCH_PX - 1)
    patch: Image = cv2.warpPerspective(image, cv2.getPerspectiveTransform(pixels, square), (_PATCH_PX, _PATCH_PX))
    return patch


def main(folder: str) -> None:
    """Write the pictures."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    for name, picture in stage_pictures(pictured(_LEVEL, _SEED, _NUMBER, held_out=True)).items():
        path = Path(folder) / f"{name}.jpg"
        cv2.imwrite(str(path), picture, [cv2.IMWRITE_JPEG_QUALITY, 85])
        print(path)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "docs/pictures")
