"""Matches of a taught panel with one picture's detections: poses, what each explains, and how much likelier it is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from elevator_rectify.core.config import Config
from elevator_rectify.core.detections import Usable
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.rotations import rotations
from elevator_rectify.core.known.hypotheses import grown, hypotheses, nearest
from elevator_rectify.core.known.placed import PlacedLayout
from elevator_rectify.core.lattice.refinement import (
    Poses,
    fitted,
    joined,
    log_prior,
    mirrored,
    mixture_likelihood,
    poses_from_maps,
    projected,
)
from elevator_rectify.core.types import Array, BoolArray, FitResult, IntArray, KnownPanel

# A button that should be seen and is not costs so many nats; it should be, so many pitches within the picture's border.
_MISSED_NATS, _INSIDE = 2.0, 0.5
# A tracked pose must explain so much of what it should see.
_TRACKED_SHARE = 0.8
# Lattice steps by which the best fit is shifted to see what else explains the detections.
_SHIFTS, _MOST_SHIFTED = 2, 8
# So many detections must lie on the panel when it is sheared.
_FEWEST_SHEARED, _SHEARED_STEPS = 6, 4


@dataclass(frozen=True)
class Scene:
    """What does not change while one picture is fitted. sigma: of the usable detections, normalised."""

    usable: Usable
    camera: Camera
    sigma: float
    config: Config
    layout: PlacedLayout
    known: KnownPanel

    @property
    def area(self) -> float:
        """Return the picture's area in the normalised plane."""
        return self.camera.width * self.camera.height / self.camera.focal_px**2

    @property
    def R_upright_camera(self) -> Array:
        """Return the rotation (3, 3) to a camera in which the panel's rows point to the right."""
        return np.asarray(rotations(np.array([[0.0, 0.0, -self.config.joint.camera_roll_rad]]))[0])


@dataclass(frozen=True)
class Matches:
    """B poses with what they explain: node, inlier (B, N) of the usable detections, log likelihood (B,)."""

    poses: Poses
    node: IntArray
    inlier: Array
    nats: Array

    @property
    def best(self) -> Poses:
        """Return the likeliest pose as a batch of one."""
        return self.poses.take(np.array([0]))

    @property
    def margin(self) -> float:
        """Return the nats between the best match and the best that takes the detections for other buttons."""
        mine = np.where(self.inlier[0] > 0.5, self.node[0], -1)
        for b in range(1, len(self.nats)):
            both = (self.inlier[b] > 0.5) & (mine >= 0)
            if not both.any() or (self.node[b] == mine)[both].mean() < 0.5:
                return float(self.nats[0] - self.nats[b])
        return float("inf")


def tracked(scene: Scene, evidence: Array, previous: FitResult | None) -> Matches | None:
    """Return the matches around an earlier pose of the panel, None where it explains less than most of them."""
    if previous is None or not previous.ok or previous.known is not scene.known:
        return None
    matches = _followed(scene, _pose_of(previous), evidence, shear=False)
    filled = np.unique(matches.node[0][matches.inlier[0] > 0.5])
    seen = np.flatnonzero(in_view(scene, matches.best)[0])
    return matches if len(seen) and np.isin(seen, filled).mean() > _TRACKED_SHARE else None


def searched(scene: Scene, evidence: Array) -> Matches | None:
    """Return the matches from everywhere, the likeliest first; None without any."""
    upright = scene.R_upright_camera
    rays = scene.usable.rays @ upright[:2, :2].T
    found = hypotheses(scene.layout.places, rays, evidence, scene.sigma, scene.config.joint)
    if found is None:
        return None
    return _followed(scene, replace(found, R=upright.T @ found.R, t=found.t @ upright), evidence, shear=True)


def _followed(scene: Scene, poses: Poses, evidence: Array, shear: bool) -> Matches:
    """Return what the poses grow into, and the best of them shifted along the panel, and sheared where that is asked
    for, until none is better."""
    matches = ranked(scored(scene, _grown(scene, poses), evidence))
    for _ in range(_MOST_SHIFTED):
        before = matches.nats[0]
        others = joined(_shifted(scene, matches.best), *(_sheared(scene, matches) if shear else ()))
        matches = ranked(_together(matches, scored(scene, _grown(scene, others), evidence)))
        if matches.nats[0] <= before:
            break
    return matches


def _grown(scene: Scene, poses: Poses) -> Poses:
    return grown(poses, scene.layout.places, scene.usable.rays, scene.sigma, scene.config.joint)


def _pose_of(fit: FitResult) -> Poses:
    """Return an earlier fit's pose in pitches."""
    zero = np.zeros(1)
    return Poses(fit.R_camera_panel[None], fit.t_camera_panel[None] / float(fit.pitch[0]), zero, np.zeros((1, 2)), zero)


def _shifted(scene: Scene, poses: Poses) -> Poses:
    """Return a pose (batch of one) shifted along the panel by some rows and columns."""
    steps = np.arange(-_SHIFTS, _SHIFTS + 1, dtype=float)
    by = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    by = by[np.abs(by).sum(axis=1) > 0] * (scene.known.pitch / scene.known.pitch[0])
    many = poses.take(np.zeros(len(by), dtype=np.int64))
    return replace(many, t=many.t + by @ poses.R[0, :, :2].T)


def _sheared(scene: Scene, matches: Matches) -> list[Poses]:
    """Return the poses that the best match has where every column is taken a row further than the one before, or every
    row a column: a lattice that is sheared looks much like itself seen from another side."""
    cells, on = scene.known.cells[matches.node[0]], matches.inlier[0] > 0.5
    button = {(int(r), int(c)): k for k, (r, c) in enumerate(scene.known.cells) if r >= 0}
    found = []
    for axis in (0, 1):
        for by in (-1, 1):
            for fixed in {0, int(cells[:, 1 - axis].max())}:
                moved = cells.copy()
                moved[:, axis] += by * (cells[:, 1 - axis] - fixed)
                nodes = np.array([button.get((int(r), int(c)), -1) for r, c in moved])
                found += _posed(scene, nodes, on & (cells[:, 0] >= 0) & (nodes >= 0))
    return found


def _posed(scene: Scene, nodes: IntArray, on: BoolArray) -> list[Poses]:
    """Return the pose, with its mirrored tilt, in which the detections that are `on` are the buttons `nodes` (N,); none
    where they do not determine it."""
    places, rays = scene.layout.places[nodes[on]], scene.usable.rays[on]
    if on.sum() < _FEWEST_SHEARED or np.linalg.svd(places - places.mean(axis=0), compute_uv=False)[1] < 1e-6:
        return []
    G = cv2.findHomography(places, rays)[0]
    if G is None or not np.isfinite(G).all():
        return []
    pose = replace(poses_from_maps(G[None], places.mean(axis=0)[None], np.zeros(1)), log_aspect=np.zeros(1))
    both = joined(pose, mirrored(pose))
    every = [np.stack([part, part]) for part in (places, np.ones(len(places)))]
    return [fitted(both, every[0], every[1], rays, scene.sigma, scene.config.joint, _SHEARED_STEPS)]


def scored(scene: Scene, poses: Poses, evidence: Array) -> Matches:
    """Return what each pose explains, by places and readings, and what it leaves unseen."""
    node, error2 = nearest(poses, scene.layout.places, scene.usable.rays)
    joint, number = scene.config.joint, np.full(len(poses.R), scene.layout.cells)
    _, inlier = mixture_likelihood(error2, number, scene.sigma, scene.area, joint)
    odds = np.log(joint.inlier_share / (1.0 - joint.inlier_share) * scene.area / (2.0 * np.pi * scene.sigma**2))
    said = np.take_along_axis(np.broadcast_to(evidence, (len(node), *evidence.shape)), node[..., None], axis=2)[..., 0]
    ratio = odds - np.log(scene.layout.cells) - 0.5 * error2 / scene.sigma**2 + said
    # A button is one detection: what else lies on it explains nothing.
    first = _first_of_each(node, ratio)
    nats = np.where(first, np.logaddexp(0.0, ratio), 0.0).sum(axis=1)
    filled = np.zeros((len(node), len(scene.layout.places)), dtype=bool)
    np.logical_or.at(filled, (np.arange(len(node))[:, None], node), first & (inlier > 0.5))
    missed = (in_view(scene, poses) & ~filled).sum(axis=1)
    prior = log_prior(replace(poses, R=scene.R_upright_camera @ poses.R), joint)
    return Matches(poses, node, inlier * first, nats - _MISSED_NATS * missed + prior)


def _first_of_each(node: IntArray, ratio: Array) -> BoolArray:
    """Return (B, N) whether a detection is the likeliest one of its button."""
    better = (node[:, :, None] == node[:, None]) & (ratio[:, None] > ratio[:, :, None])
    return np.asarray(~better.any(axis=-1))


def in_view(scene: Scene, poses: Poses) -> BoolArray:
    """Return (B, K) which buttons lie well within the picture."""
    ring = scene.layout.places + _INSIDE * np.array([[[-1, 0]], [[1, 0]], [[0, -1]], [[0, 1]]])
    points = projected(poses, ring.reshape(1, -1, 2))[1] + poses.t[:, None]
    pixels = scene.camera.project(points.reshape(-1, 3)).reshape(*points.shape[:2], 2)
    with np.errstate(invalid="ignore"):
        inside = ((pixels > 0) & (pixels < [scene.camera.width - 1, scene.camera.height - 1])).all(axis=-1)
    return np.asarray((inside & (points[..., 2] > 0)).reshape(len(poses.R), 4, -1).all(axis=1))


def _together(one: Matches, other: Matches) -> Matches:
    """Return both in one."""
    parts = (np.concatenate([getattr(m, name) for m in (one, other)]) for name in ("node", "inlier", "nats"))
    return Matches(joined(one.poses, other.poses), *parts)


def ranked(matches: Matches) -> Matches:
    """Return the matches, the likeliest first."""
    order = np.argsort(-matches.nats, kind="stable")
    return Matches(matches.poses.take(order), matches.node[order], matches.inlier[order], matches.nats[order])
