"""The picture that a camera takes of a scene: perspective, light, lens and sensor."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from elevator_rectify.core.types import Array, Image
from elevator_rectify.render.outline import half_size_m
from elevator_rectify.render.scene import Scene
from elevator_rectify.render.texture import PLATE_PX_PER_M, draw_caps, draw_plate, pixel_map, shade
from elevator_rectify.render.wall import WALL_M, WALL_PX_PER_M, draw_wall

_OVERSAMPLING = 2
# The side of a cap that stands out is drawn as so many slices.
_SLICES = 4


@dataclass(frozen=True)
class Taking:
    """How the picture is taken; blur in pixels of the picture, noise in grey values, jpeg 0: not compressed.

    reflection: brightness of lamps mirrored in the plate; shadow: how dark somebody's shadow is, 0 to 1.
    """

    focus_px: float = 0.65
    motion_px: float = 0.0
    noise: float = 1.2
    jpeg: int = 0
    reflection: float = 26.0
    shadow: float = 0.0
    gain: float = 1.0


def photograph(scene: Scene, rng: np.random.Generator, taking: Taking = Taking()) -> Image:
    """Return the (height, width, 3) BGR uint8 picture of the scene, without lens distortion.

    Drawn oversampled, then reduced, so that edges are where the geometry puts them.
    """
    camera, panel = scene.camera, scene.panel
    fine = _OVERSAMPLING
    size = (camera.width * fine, camera.height * fine)
    wall = draw_wall(panel.look, rng)
    wall_map = _map(scene) @ pixel_map((-WALL_M, -WALL_M), WALL_PX_PER_M)
    picture = cv2.warpPerspective(wall, wall_map, size, borderMode=cv2.BORDER_REFLECT)
    plate = draw_plate(panel, rng)
    texture = pixel_map(panel.plate_m[:2], PLATE_PX_PER_M)
    plate_map = _map(scene) @ texture
    mask = cv2.warpPerspective(np.full(plate.shape[:2], 255, np.uint8), plate_map, size)
    dark = cv2.resize(cv2.blur(cv2.resize(mask, None, fx=0.25, fy=0.25), (9, 9)), size)
    picture = _over(picture, (0, 0, 0), cv2.convertScaleAbs(dark, alpha=0.45))
    picture = _over(picture, _warped(plate, plate_map, size), mask)
    caps, mask = draw_caps(panel)
    height = panel.look.height_share * 2.0 * float(half_size_m(panel.look, panel.pitch_m)[1])
    slices = _SLICES if height else 0
    for k in range(slices):
        side = cv2.warpPerspective(mask, _map(scene, height * k / slices) @ texture, size)
        picture = _over(picture, shade(panel.look.face, 0.45 + 0.25 * k / slices), side)
    top = _map(scene, height) @ texture
    picture = _over(picture, _warped(caps, top, size), cv2.warpPerspective(mask, top, size))
    reduced = cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return _exposed(reduced, rng, taking)


def _map(scene: Scene, height_m: float = 0.0) -> Array:
    """Return the map from metres in the plane `height_m` before the panel's to pixels of the oversampled picture."""
    fine = _OVERSAMPLING
    # Pixel centres: (u + 1/2) fine - 1/2.
    zoom = np.array([[fine, 0, (fine - 1) / 2], [0, fine, (fine - 1) / 2], [0, 0, 1.0]])
    R = scene.R_camera_panel
    plane = np.column_stack([R[:, :2], scene.t_camera_panel - height_m * R[:, 2]])
    return np.asarray(zoom @ scene.camera.matrix @ plane)


def _warped(texture: Image, texture_map: Array, size: tuple[int, int]) -> Image:
    """Return the texture as seen, blurred to the picture's sampling, so that brushed steel does not flicker."""
    corners = np.array([[0, 0], [texture.shape[1], texture.shape[0]]], dtype=float)
    mapped = cv2.perspectiveTransform(corners[None], texture_map)[0]
    drawn, shown = (float(np.linalg.norm(p[1] - p[0])) for p in (corners, mapped))
    reduction = drawn / max(1.0, shown)
    softened = cv2.GaussianBlur(texture, (0, 0), 0.4 * reduction) if reduction > 1.3 else texture
    seen: Image = cv2.warpPerspective(softened, texture_map, size, borderMode=cv2.BORDER_REPLICATE)
    return seen


def _over(below: Image, above: Image | tuple[float, float, float], alpha: Image) -> Image:
    """Return `above` (a picture or a colour) over `below`, by its opacity in 0..255."""
    share = (alpha.astype(np.float32) / 255.0)[..., None]
    mixed: Image = (below + share * (np.asarray(above, np.float32) - below)).astype(np.uint8)
    return mixed


def _exposed(picture: Image, rng: np.random.Generator, taking: Taking) -> Image:
    """Add light, reflection, shadow, vignetting, lens and motion blur, sensor noise, compression."""
    height, width = picture.shape[:2]
    x, y = np.meshgrid(np.linspace(-1, 1, width, dtype=np.float32), np.linspace(-1, 1, height, dtype=np.float32))
    angle, spot = rng.uniform(0, 2 * np.pi), rng.uniform(-0.6, 0.6, 2)
    light = (1.0 + 0.22 * (np.cos(angle) * x + np.sin(angle) * y)) * (1.0 - 0.18 * (x * x + y * y))
    edge = np.cos(2.0 * angle) * x + np.sin(2.0 * angle) * y - spot[1]
    light *= taking.gain * (1.0 - taking.shadow / (1.0 + np.exp(-20.0 * edge)))
    glare = taking.reflection * np.exp(-((x - spot[0]) ** 2 + (y - spot[1]) ** 2) / 0.12)
    lit = picture * light[..., None].astype(np.float32) + glare[..., None].astype(np.float32)
    blurred = cv2.GaussianBlur(lit, (0, 0), taking.focus_px) if taking.focus_px > 0 else lit
    if taking.motion_px > 0.5:
        blurred = cv2.filter2D(blurred, -1, _streak(taking.motion_px, rng.uniform(0, np.pi)))
    noise = rng.standard_normal(picture.shape, dtype=np.float32)
    noisy = blurred + noise * (taking.noise + 0.10 * np.sqrt(np.maximum(blurred, 0)))
    exposed: Image = np.clip(noisy.round(), 0, 255).astype(np.uint8)
    if not taking.jpeg:
        return exposed
    coded = cv2.imencode(".jpg", exposed, [cv2.IMWRITE_JPEG_QUALITY, taking.jpeg])[1]
    decoded: Image = cv2.imdecode(coded, cv2.IMREAD_COLOR)
    return decoded


def _streak(length_px: float, angle_rad: float) -> Array:
    """Return the kernel of a motion of so many pixels."""
    half = int(np.ceil(length_px / 2)) + 1
    grid = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float32)
    kernel = np.zeros(grid.shape[1:], np.float32)
    for s in np.linspace(-0.5, 0.5, 33) * length_px:
        away = np.abs(grid[0] - s * np.sin(angle_rad)), np.abs(grid[1] - s * np.cos(angle_rad))
        kernel += np.maximum(0, 1 - away[0]) * np.maximum(0, 1 - away[1])
    return np.asarray(kernel / kernel.sum())
