"""Where the picture shows the buttons of a fitted lattice."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from elevator_rectify.core.lattice.layout import LayoutFit
from elevator_rectify.core.lattice.refinement import jacobians
from elevator_rectify.core.picture.patches import Picture, Window, sample
from elevator_rectify.core.picture.template import Template, align, feature, make_template, symmetry_centre
from elevator_rectify.core.types import Array, BoolArray, IntArray

# No button is known better, in pixels.
_FLOOR_PX = 0.05
# A detected button further from its place, in half sizes, or less like the template keeps its box.
_WORST_OFFSET, _WORST_CORRELATION, _LEAST_INSIDE = 0.55, 0.35, 0.6
# A cell without detection is a button only if it is near its place and as much like the template as the others: the
# farthest, in half sizes, the least correlation, as such and over the usual one, and the least share in the picture.
# One exactly at its place may be less like them, where it shines; one like the others may be cut by the border.
_UNDETECTED = (np.array([0.3, 0.45, 0.6, 0.95]), np.array([0.1, 0.45, 0.5, 0.95]), np.array([0.1, 0.45, 0.85, 0.7]))
_FARTHEST_CENTRE = 0.3
# What all boxes are off alike, and what the centre of symmetry is off by shadows and lights, in pixels.
_BOX_BIAS_PX, _SYMMETRY_STD_PX = 0.3, 0.5


@dataclass(frozen=True)
class Boxes:
    """The filled nodes (M,), the mean ray (M, 2) of the detections of each, and their standard deviation."""

    node: IntArray
    rays: Array
    sigma: float


@dataclass(frozen=True)
class Places:
    """Where M buttons are.

    node: (M,) indices of the layout's nodes; offset: (M, 2) from the node, in pitches; covariance: (M, 2, 2) of it;
    correlation: (M,) with the template; seen: (M,) by the picture, else by the box; detected: (M,) by the detector.
    """

    node: IntArray
    offset: Array
    covariance: Array
    correlation: Array
    seen: BoolArray
    detected: BoolArray


def joined(one: Places, other: Places) -> Places:
    """Return both in one."""
    return Places(*(np.concatenate([getattr(one, f.name), getattr(other, f.name)]) for f in fields(Places)))


def chosen(places: Places, on: BoolArray) -> Places:
    """Return those of the places (M,) that are `on`."""
    return Places(*(getattr(places, f.name)[on] for f in fields(Places)))


def boxes_of(fit: LayoutFit, rays: Array, sigma: float) -> Boxes:
    """Return the filled nodes of a fit to detections at rays (N, 2)."""
    on = fit.inlier > 0.5
    count = np.bincount(fit.node[on])
    node = np.flatnonzero(count)
    mean = np.column_stack([np.bincount(fit.node[on], rays[on, k])[node] / count[node] for k in (0, 1)])
    return Boxes(node, mean, sigma)


def located(
    fit: LayoutFit, boxes: Boxes, picture: Picture, window: Window, half: Array, blur: float
) -> tuple[Places, Template]:
    """Return where the detected buttons are, by the picture or else by their boxes, and their template."""
    nodes = fit.layout.nodes.reshape(-1, 2)[boxes.node]
    patches, inside = sample(picture, fit.pose.maps[0], nodes, window)
    features = feature(patches, blur)
    template = make_template(features, inside, float((half / window.half).max()), blur)
    found = align(template, features, inside)
    offset = found.shift * window.step
    predicted, _, d_uv = jacobians(fit.pose, nodes[None])
    per_ray = np.linalg.inv(d_uv[0])
    unit = per_ray @ np.swapaxes(per_ray, 1, 2)
    seen = (
        (np.hypot(*(offset / half).T) < _WORST_OFFSET)
        & (found.correlation > _WORST_CORRELATION)
        & (inside.mean(axis=(1, 2)) > _LEAST_INSIDE)
    )
    by_picture = _in_pitches(found.covariance, window) + _floor(picture) * unit
    by_box = (per_ray @ (boxes.rays - predicted[0])[..., None])[..., 0]
    places = Places(
        boxes.node,
        np.where(seen[:, None], offset, by_box),
        np.where(seen[:, None, None], by_picture, boxes.sigma**2 * unit),
        found.correlation,
        seen,
        np.ones(len(nodes), dtype=bool),
    )
    return places, template


def undetected(
    fit: LayoutFit, nodes: IntArray, places: Places, template: Template, picture: Picture, window: Window, half: Array
) -> Places:
    """Return the buttons that the detector missed: cells that look like the template, where the lattice has them."""
    return seen_at(fit, fit.layout.nodes.reshape(-1, 2)[nodes], nodes, places, template, picture, window, half)


def seen_at(
    fit: LayoutFit,
    lattice: Array,
    names: IntArray,
    places: Places,
    template: Template,
    picture: Picture,
    window: Window,
    half: Array,
) -> Places:
    """Return the buttons that look like the template at lattice points (M, 2), which are named by `names` (M,)."""
    patches, inside = sample(picture, fit.pose.maps[0], lattice, window)
    found = align(template, feature(patches, template.blur), inside)
    offset = found.shift * window.step
    usual, off = float(np.median(places.correlation)), np.hypot(*(offset / half).T)
    seen = np.zeros(len(names), dtype=bool)
    for farthest, least, share, least_inside in _UNDETECTED:
        alike = found.correlation > max(least, share * usual)
        seen |= (off < farthest) & alike & (inside.mean(axis=(1, 2)) > least_inside)
    per_ray = np.linalg.inv(jacobians(fit.pose, lattice[seen][None])[2][0])
    covariance = _in_pitches(found.covariance[seen], window) + _floor(picture) * (per_ray @ np.swapaxes(per_ray, 1, 2))
    return Places(names[seen], offset[seen], covariance, found.correlation[seen], seen[seen], ~seen[seen])


def centred(places: Places, boxes: Boxes, template: Template, picture: Picture, window: Window, half: Array) -> Places:
    """Return the places referred to the buttons' centre of symmetry, as far as it is known better than by the boxes.

    Alignment finds where the buttons are relative to each other only.
    """
    centre = symmetry_centre(template) * window.step
    if not np.hypot(*(centre / half)) < _FARTHEST_CENTRE:
        return places
    boxes_px2 = (boxes.sigma * picture.camera.focal_px) ** 2 / len(boxes.node) + _BOX_BIAS_PX**2
    centre = centre * boxes_px2 / (boxes_px2 + _SYMMETRY_STD_PX**2)
    return replace(places, offset=places.offset + places.seen[:, None] * centre)


def _in_pitches(covariance: Array, window: Window) -> Array:
    return np.asarray(covariance * window.step[:, None] * window.step)


def _floor(picture: Picture) -> float:
    return (_FLOOR_PX / picture.camera.focal_px) ** 2
