"""Panels of few buttons, single rows and columns: the pose from the buttons' outlines."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from elevator_rectify.core.config import Config
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.rotations import rotation_angle_rad, rotations
from elevator_rectify.core.outline.refinement import OutlineFit, fit_outlines
from elevator_rectify.core.outline.shapes import Edges, OutlineModel, edges_of, normals, strengths, unit_shape
from elevator_rectify.core.picture.straight_edges import NO_SEGMENTS, Segments, segments_of, support
from elevator_rectify.core.types import Array, Image

_TILTS_RAD = np.deg2rad([0.0, 12.0, 24.0, 36.0, 48.0, 58.0])
_TURNS = 12
_SCALES = np.linspace(0.7, 1.25, 10)
_CORNER = 0.25
# Grey values per pixel: the score of an edge is half of the best at this strength.
_USUAL_EDGE = 8.0
# The best hypotheses of each shape that are refined, with their mirrored tilts.
_STARTS, _APART_RAD = 2, np.deg2rad(15.0)
_SAME_RAD = np.deg2rad(2.5)
# Buttons whose outlines are fitted; of a longer row, some from all along it.
_MOST_BUTTONS = 5
# Edges are as long as so much of a button's size at least.
_SHORTEST_EDGE = 0.8
_GRAVITY_STD_RAD = np.deg2rad(3.0)


@dataclass(frozen=True)
class FewFit:
    """The best fit to outlines, the best one with another pose (None: there is none), the margin between them in nats,
    and the picture's straight edges, none where they are not asked for."""

    best: OutlineFit
    other: OutlineFit | None
    margin: float
    segments: Segments


def fit_few(boxes: Array, image: Image, camera: Camera, config: Config) -> FewFit | None:
    """Fit the outlines of the buttons in boxes (N, 4) = x, y, width, height px; None where no edges are found."""
    used = np.unique(np.linspace(0, len(boxes) - 1, _MOST_BUTTONS).round().astype(int))
    chosen = boxes[np.argsort(boxes[:, :2] @ _main_direction(boxes[:, :2]))][used]
    edges = edges_of(image, chosen, camera)
    rays = np.column_stack([camera.rays(chosen[:, :2]), np.ones(len(chosen))])
    if not np.isfinite(rays).all():
        return None
    segments = NO_SEGMENTS
    if config.outline.edges:
        segments = segments_of(image, camera, _SHORTEST_EDGE * float(boxes[:, 2:].mean()))
    fits = []
    for shape in (True, False):
        starts = _starts(chosen, rays, edges, camera, config, round_shape=shape)
        fits += [fit_outlines(start, edges) for start in starts]
    fits = [f for f in fits if np.isfinite(f.cost)]
    if not fits:
        return None
    fits.sort(key=lambda f: cost(f, segments, config))
    best = fits[0]
    other = next((f for f in fits[1:] if rotation_angle_rad(normal_turn(f, best)) > _SAME_RAD), None)
    margin = np.inf if other is None else cost(other, segments, config) - cost(best, segments, config)
    return FewFit(best, other, float(margin), segments)


def cost(fit: OutlineFit, segments: Segments, config: Config) -> float:
    """Return the negative log likelihood of outlines, straight edges and gravity."""
    total = fit.cost
    if len(segments.normal):
        total -= max(support(segments, fit.model.R @ rotations(np.array([[0.0, 0.0, a]]))[0]) for a in _TURNED_RAD)
    up = np.array([config.outline.up_x, config.outline.up_y, config.outline.up_z])
    if np.linalg.norm(up) > 0:
        lean = float(np.arcsin(np.clip(fit.model.R[:, 2] @ up / np.linalg.norm(up), -1.0, 1.0)))
        total += 0.5 * min((lean / _GRAVITY_STD_RAD) ** 2, 50.0)
    return total


# A circle says nothing of its turn: the straight edges are tried at each of these.
_TURNED_RAD = np.deg2rad(np.linspace(-8.0, 8.0, 17))


def normal_turn(one: OutlineFit, other: OutlineFit) -> Array:
    """Return the rotation (3, 3) from one plane's normal to the other's."""
    a, b = one.model.R[:, 2], other.model.R[:, 2]
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    angle = np.arctan2(sine, float(a @ b))
    return np.asarray(rotations((axis / max(sine, 1e-12) * angle)[None])[0])


def _main_direction(points: Array) -> Array:
    return np.asarray(np.linalg.svd(points - points.mean(axis=0))[2][0])


def _tilted(config: Config) -> Array:
    """Return rotations (M, 3, 3) of planes tilted in all directions, upright otherwise."""
    turns = np.linspace(0.0, 2.0 * np.pi, _TURNS, endpoint=False)
    vectors = [t * np.array([np.cos(a), np.sin(a), 0.0]) for t, a in product(_TILTS_RAD[1:], turns)]
    upright = rotations(np.array([[0.0, 0.0, config.joint.camera_roll_rad]]))[0]
    return np.asarray(rotations(np.array([np.zeros(3), *vectors])) @ upright)


def _starts(
    boxes: Array, rays: Array, edges: Edges, camera: Camera, config: Config, round_shape: bool
) -> list[OutlineModel]:
    """Return the models, of one shape, along whose outlines the picture changes most, with their mirrored tilts."""
    bases = [_on_plane(R, boxes, rays, camera, round_shape) for R in _tilted(config)]
    scores = _edge_scores(bases, edges, camera)
    chosen: list[OutlineModel] = []
    for index in np.argsort(-scores, axis=None, kind="stable"):
        place, scale = np.unravel_index(index, scores.shape)
        model = replace(bases[place], half=bases[place].half * _SCALES[scale])
        if all(float(model.R[:, 2] @ c.R[:, 2]) < np.cos(_APART_RAD) for c in chosen):
            chosen.append(model)
        if len(chosen) == _STARTS:
            break
    return [*chosen, *(_mirrored(m, boxes, rays, camera) for m in chosen)]


def _on_plane(R: Array, boxes: Array, rays: Array, camera: Camera, round_shape: bool) -> OutlineModel:
    """Return the model in a plane of this rotation, its centres in the middle of the boxes, its size by theirs."""
    origin = np.append(rays[:, :2].mean(axis=0), 1.0)
    normal = R[:, 2]
    points = rays * ((normal @ origin) / (rays @ normal))[:, None]
    size = np.sqrt(boxes[:, 2:].prod(axis=1)) * points[:, 2] / camera.focal_px
    half = 0.5 * float(np.median(size)) / np.sqrt(max(0.3, abs(float(normal[2]))))
    return OutlineModel(R, origin, (points - origin) @ R[:, :2], np.full(2, half), _CORNER, round_shape)


def _mirrored(model: OutlineModel, boxes: Array, rays: Array, camera: Camera) -> OutlineModel:
    """Return the model with the tilt against the line of sight reversed (Necker)."""
    sight = model.origin / np.linalg.norm(model.origin)
    R = model.R - 2.0 * np.outer(sight, sight @ model.R)
    R[:, 2] = np.cross(R[:, 0], R[:, 1])
    if R[2, 2] < 0:
        return model
    return replace(_on_plane(R, boxes, rays, camera, model.round), half=model.half)


def _edge_scores(models: list[OutlineModel], edges: Edges, camera: Camera) -> Array:
    """Return (models, scales) the mean of how strong the edges along the outlines are, 0 to 1."""
    shape = unit_shape(models[0])
    half = np.array([m.half for m in models])[:, None] * _SCALES[:, None]
    plane = np.array([m.centres for m in models])[:, None, :, None] + half[:, :, None, None] * shape
    axes = np.array([m.R[:, :2] for m in models])[:, None, None]
    outlines = camera.project(plane @ np.swapaxes(axes, -1, -2) + models[0].origin)
    strength = np.abs(strengths(edges, outlines, normals(outlines)))
    return np.asarray((strength / (strength + _USUAL_EDGE)).mean(axis=(2, 3)))
