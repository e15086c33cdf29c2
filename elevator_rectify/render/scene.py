"""One look at a panel: camera, true pose, and what a detector would have made of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.rotations import rotation
from elevator_rectify.core.types import Array, Detection, IntArray
from elevator_rectify.render.outline import half_size_m, outline_m
from elevator_rectify.render.panel import Panel

PAPER_K = np.array([[320.0, 0.0, 320.0], [0.0, 320.0, 240.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Viewpoint:
    """Where the camera looks from, relative to facing the panel's centre."""

    tilt_rad: float
    tilt_axis_rad: float
    roll_rad: float
    fill: float
    offset: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class DetectorModel:
    """A detector's faults: centre noise, shares of missed, false and doubled detections.

    clutter: probability that rows of key switches, in the panel's plane but off its lattice, are detected too.
    """

    sigma_px: float = 1.0
    missed: float = 0.0
    false: float = 0.0
    duplicates: float = 0.0
    clutter: float = 0.0


@dataclass(frozen=True)
class Scene:
    """A panel seen by a camera. pixels: (M, 2) true button centres; button: (N,) of each detection, -1 where false."""

    panel: Panel
    camera: Camera
    R_camera_panel: Array
    t_camera_panel: Array
    pixels: Array
    detections: tuple[Detection, ...]
    button: IntArray
    detector: DetectorModel = DetectorModel()

    @property
    def centres_px(self) -> Array:
        """Return the (N, 2) detected centres."""
        return np.array([[d.x_px, d.y_px] for d in self.detections]).reshape(-1, 2)


def paper_camera() -> Camera:
    """Return the paper's camera: 640 x 480, f = 320 px."""
    return Camera.from_matrix(PAPER_K, 640, 480)


def camera_pose(panel: Panel, camera: Camera, view: Viewpoint) -> tuple[Array, Array]:
    """Return R, t (panel to camera) that show the buttons over the share `fill` of the image, off centre as asked."""
    axis = np.array([np.cos(view.tilt_axis_rad), np.sin(view.tilt_axis_rad), 0.0])
    R = rotation(view.tilt_rad * axis) @ rotation(np.array([0.0, 0.0, view.roll_rad]))
    points = panel.points_m
    centre = (points.max(axis=0) + points.min(axis=0)) / 2.0
    size = np.array([camera.width, camera.height], dtype=float)
    ray = np.append((size * (0.5 + np.array(view.offset)) - camera.matrix[:2, 2]) / camera.focal_px, 1.0)
    near, far = 0.02, 20.0
    for _ in range(60):
        depth = np.sqrt(near * far)
        t = ray * depth - R @ centre
        in_camera = points @ R.T + t
        pixels = camera.project(in_camera)
        small = (in_camera[:, 2] > 0.01).all() and ((pixels.max(axis=0) - pixels.min(axis=0)) / size).max() < view.fill
        near, far = (near, depth) if small else (depth, far)
    return R, ray * far - R @ centre


def make_scene(
    panel: Panel, camera: Camera, view: Viewpoint, detector: DetectorModel, rng: np.random.Generator
) -> Scene:
    """Place the camera and run the detector model."""
    return detected(panel, camera, *camera_pose(panel, camera, view), detector, rng)


def detected(
    panel: Panel, camera: Camera, R: Array, t: Array, detector: DetectorModel, rng: np.random.Generator
) -> Scene:
    """Return what the detector model makes of a panel at a pose (panel to camera)."""
    pixels = camera.project(panel.placed_m @ R.T + t)
    size_px = box_sizes_px(panel, camera, R, t)
    inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)
    found = np.flatnonzero(inside & (rng.random(len(pixels)) >= detector.missed))
    doubled = found[rng.random(len(found)) < detector.duplicates]
    button = np.concatenate([found, doubled, np.full(round(detector.false * len(found)), -1)]).astype(np.int64)
    centres = np.where((button >= 0)[:, None], pixels[button], _false_centres(pixels, len(button), camera, rng))
    centres = centres + rng.normal(0.0, detector.sigma_px, centres.shape) * (button >= 0)[:, None]
    if detector.clutter and rng.random() < detector.clutter:
        clutter = camera.project(_clutter_points(panel, rng) @ R.T + t)
        clutter = clutter[((clutter >= 0) & (clutter < [camera.width, camera.height])).all(axis=1)]
        centres = np.concatenate([centres, clutter + rng.normal(0.0, detector.sigma_px, clutter.shape)])
        button = np.concatenate([button, np.full(len(clutter), -1)]).astype(np.int64)
    sizes = np.where((button >= 0)[:, None], size_px[button], rng.choice(size_px, len(button)))
    boxes = sizes * np.exp(rng.normal(0.0, 0.06, (len(button), 2)))
    scores = np.clip(
        np.where(button >= 0, rng.normal(0.88, 0.07, len(button)), rng.normal(0.55, 0.15, len(button))), 0.05, 0.99
    )
    order = rng.permutation(len(button))
    labels = [panel.buttons[b].label if b >= 0 else "" for b in button]
    detections = tuple(
        Detection(
            float(centres[n, 0]),
            float(centres[n, 1]),
            float(boxes[n, 0]),
            float(boxes[n, 1]),
            labels[n],
            float(scores[n]),
        )
        for n in order
    )
    return Scene(panel, camera, R, t, pixels, detections, button[order], detector)


def box_sizes_px(panel: Panel, camera: Camera, R: Array, t: Array) -> Array:
    """Return width and height (M, 2) of the boxes around the caps, as they are seen."""
    outline = outline_m(panel.look, panel.pitch_m)
    height = panel.look.height_share * 2.0 * half_size_m(panel.look, panel.pitch_m)[1]
    shape = np.concatenate([np.column_stack([outline, np.full(len(outline), z)]) for z in (0.0, -height)])
    pixels = camera.project((panel.placed_m[:, None] + shape) @ R.T + t)
    return np.asarray(np.ptp(np.nan_to_num(pixels), axis=1))


def _clutter_points(panel: Panel, rng: np.random.Generator) -> Array:
    """Return points (M, 3) of rows of key switches or lamps above or below the buttons, at distances of their own."""
    points, pitch = panel.points_m, np.array(panel.pitch_m)
    low, high = points.min(axis=0)[:2], points.max(axis=0)[:2]
    rows, columns = int(rng.integers(1, 5)), int(rng.integers(1, 5))
    step = pitch * rng.uniform(0.5, 1.8, 2)
    at = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2) * step
    across = (low[0] + high[0]) / 2.0 - at[-1, 0] / 2.0 + rng.uniform(-0.5, 0.5) * pitch[0]
    gap = rng.uniform(0.8, 2.5) * pitch[1]
    down = high[1] + gap if rng.random() < 0.5 else low[1] - gap - at[-1, 1]
    return np.column_stack([at + np.array([across, down]), np.zeros(len(at))])


def _false_centres(pixels: Array, number: int, camera: Camera, rng: np.random.Generator) -> Array:
    """Return places of false detections: 60 % around the panel, 40 % anywhere in the image."""
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    margin = 0.25 * (high - low)
    size = np.array([camera.width, camera.height], dtype=float)
    near = rng.uniform(np.maximum(low - margin, 0), np.minimum(high + margin, size - 1), (number, 2))
    return np.where(rng.random((number, 1)) < 0.6, near, rng.uniform(0, size - 1, (number, 2)))
