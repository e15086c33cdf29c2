"""The picture that a camera takes of a scene: perspective, light, lens and sensor."""

from __future__ import annotations

import cv2
import numpy as np

from elevator_rectify.core.types import Array, Image
from elevator_rectify.render.scene import Scene
from elevator_rectify.render.texture import PLATE_PX_PER_M, WALL_M, WALL_PX_PER_M, draw_plate, draw_wall, pixel_map

_OVERSAMPLING = 3


def photograph(scene: Scene, rng: np.random.Generator) -> Image:
    """Return the (height, width, 3) BGR uint8 picture of the scene, without lens distortion.

    Drawn oversampled, then reduced, so that edges are where the geometry puts them.
    """
    plate, wall = draw_plate(scene.panel, rng), draw_wall(scene.panel.look, rng)
    fine = _OVERSAMPLING
    size = (scene.camera.width * fine, scene.camera.height * fine)
    # Pixel centres: (u + 1/2) fine - 1/2.
    zoom = np.array([[fine, 0, (fine - 1) / 2], [0, fine, (fine - 1) / 2], [0, 0, 1.0]])
    panel_map = zoom @ scene.camera.matrix @ np.column_stack([scene.R_camera_panel[:, :2], scene.t_camera_panel])
    picture = cv2.warpPerspective(
        wall, panel_map @ pixel_map((-WALL_M, -WALL_M), WALL_PX_PER_M), size, borderMode=cv2.BORDER_REFLECT
    )
    plate_map = panel_map @ pixel_map(scene.panel.plate_m[:2], PLATE_PX_PER_M)
    front = cv2.warpPerspective(_softened(plate, plate_map, scene), plate_map, size)
    mask = cv2.warpPerspective(np.full(plate.shape[:2], 255, np.uint8), plate_map, size)
    shade = cv2.GaussianBlur(mask, (0, 0), 6.0 * fine)
    picture = (picture * (1.0 - 0.45 * (shade / 255.0))[..., None]).astype(np.uint8)
    alpha = (mask / 255.0)[..., None].astype(np.float32)
    picture = cv2.resize(
        picture * (1.0 - alpha) + front * alpha, (scene.camera.width, scene.camera.height), interpolation=cv2.INTER_AREA
    )
    return _exposed(picture.astype(np.float32), rng)


def _softened(plate: Image, plate_map: Array, scene: Scene) -> Image:
    """Blur the texture to the sampling of the oversampled picture, so that brushed steel does not flicker."""
    corners = np.array([[0, 0], [plate.shape[1], plate.shape[0]]], dtype=float)
    mapped = cv2.perspectiveTransform(corners[None], plate_map)[0]
    drawn, shown = (float(np.linalg.norm(p[1] - p[0])) for p in (corners, mapped))
    reduction = drawn / max(1.0, shown)
    return cv2.GaussianBlur(plate, (0, 0), 0.4 * reduction) if reduction > 1.3 else plate


def _exposed(picture: Array, rng: np.random.Generator) -> Image:
    """Add a light gradient, a reflection, vignetting, lens blur and sensor noise."""
    height, width = picture.shape[:2]
    x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    angle = rng.uniform(0, 2 * np.pi)
    light = 1.0 + 0.22 * (np.cos(angle) * x + np.sin(angle) * y)
    spot = rng.uniform(-0.6, 0.6, 2)
    glare = 26.0 * np.exp(-((x - spot[0]) ** 2 + (y - spot[1]) ** 2) / 0.12)
    lit = picture * (light * (1.0 - 0.18 * (x * x + y * y)))[..., None] + glare[..., None]
    blurred = cv2.GaussianBlur(lit, (0, 0), rng.uniform(0.4, 0.9))
    noisy = blurred + rng.normal(0, 1, picture.shape) * (1.2 + 0.10 * np.sqrt(np.maximum(blurred, 0)))[..., :]
    exposed: Image = np.clip(noisy.round(), 0, 255).astype(np.uint8)
    return exposed
