"""Pose and lattice from the picture: buttons aligned to their template, the pose fitted to where they really are."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.compiled import COMPILED, plain
from elevator_rectify.core.config import Config, JointConfig
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.lattice.layout import LayoutFit, design, moved, pose_of, posed_layout, shifted
from elevator_rectify.core.lattice.pose_kernels import settings
from elevator_rectify.core.lattice.refinement import jacobians, projected, stepped
from elevator_rectify.core.picture.alignment import Boxes, Places, boxes_of, centred, joined, located, undetected
from elevator_rectify.core.picture.halving import halved
from elevator_rectify.core.picture.kernels import HUBER, in_lattice, placed
from elevator_rectify.core.picture.patches import Picture, Window, half_size_pitch, picture_of, window_of
from elevator_rectify.core.picture.template import Template
from elevator_rectify.core.types import Array, Image

# Blur of the features in samples, how much coarser the samples are, and the pose's steps, stage by stage.
STAGES = ((1.5, 1.6, 2), (1.2, 1.2, 2), (0.6, 1.0, 3))
_FEWEST = 4
# Bounds of the panel's own scatter, in column pitches; the usual one counts as much as so many buttons.
_LEAST_SCATTER, _MOST_SCATTER = 0.001, 0.03
_SCATTER_WORTH = 4.0
# Half a button over the smaller pitch, where boxes have no size.
_USUAL_HALF = 0.31


@dataclass(frozen=True)
class View:
    """What places are found with: the picture, the buttons' common look, the window that is sampled, and half (2,) the
    size of a button in pitches."""

    picture: Picture
    template: Template
    window: Window
    half: Array


@dataclass(frozen=True)
class MeasuredFit:
    """A layout fit to the picture.

    rays: (M, 2) where the places are, information: (M, 2, 2) of them, both in normalised units; scatter: standard
    deviation of the panel's own placement, residual: robust rms of the seen buttons from the lattice, in column
    pitches; view: what they were found with.
    """

    fit: LayoutFit
    places: Places
    rays: Array
    information: Array
    scatter: float
    residual: float
    view: View

    @property
    def half(self) -> Array:
        """Return (2,) half the size of a button in pitches."""
        return self.view.half


def measure(
    fit: LayoutFit,
    rays: Array,
    sizes_px: Array,
    sigma: float,
    image: Image,
    camera: Camera,
    config: Config,
    stages: tuple[tuple[float, float, int], ...] = STAGES,
    halve: bool = True,
) -> MeasuredFit | None:
    """Align the fit's buttons in the image and fit the pose to them; None where there are too few.

    rays (N, 2), sizes_px (N, 2): of the detections; sigma: their standard deviation in normalised units; halve: look
    for buttons between the lattice's lines.
    """
    given, boxes = fit, boxes_of(fit, rays, sigma)
    if len(boxes.node) < _FEWEST:
        return None
    half = _half_size(fit, sizes_px, camera)
    window, reduction = window_of(half, _px_per_pitch(fit, boxes, camera))
    picture = picture_of(image, camera, reduction)
    boxed = np.zeros(fit.layout.nodes.size // 2, dtype=bool)
    boxed[boxes.node] = True
    more = np.flatnonzero(~boxed)
    result, scatter = None, config.measurement.scatter_pitch
    for number, (blur, coarser, steps) in enumerate(stages):
        samples = window.coarser(coarser)
        places, template = located(fit, boxes, picture, samples, half, blur)
        if number and len(more):
            extra = undetected(fit, more, places, template, picture, samples, half)
            more, places = extra.node, joined(places, extra)
        if number == len(stages) - 1:
            places = centred(places, boxes, template, picture, samples, half)
        result = fitted(fit, places, scatter, View(picture, template, samples, half), config, steps)
        fit, scatter = result.fit, result.scatter
    found = replace(given, pose=fit.pose, layout=fit.layout)
    finer = halved(found, places, template, picture, samples, half) if halve else None
    if finer is None:
        return result
    return measure(finer, rays, sizes_px, sigma, image, camera, config, stages[1:], halve=False)


def _px_per_pitch(fit: LayoutFit, boxes: Boxes, camera: Camera) -> Array:
    """Return d(pixel) / d(column, row) (M, 2, 2) at the boxes' nodes."""
    lattice = fit.layout.nodes.reshape(-1, 2)[boxes.node]
    return np.asarray(jacobians(fit.pose, lattice[None])[2][0] * camera.focal_px)


def _half_size(fit: LayoutFit, sizes_px: Array, camera: Camera) -> Array:
    aspect = float(np.exp(fit.pose.log_aspect[0]))
    usual = _USUAL_HALF * min(1.0, aspect) / np.array([1.0, aspect])
    on = fit.inlier > 0.5
    lattice = fit.layout.nodes.reshape(-1, 2)[fit.node[on]]
    d_px = jacobians(fit.pose, lattice[None])[2][0] * camera.focal_px
    return half_size_pitch(sizes_px[on], d_px, usual)


def fitted(fit: LayoutFit, places: Places, scatter: float, view: View, config: Config, steps: int) -> MeasuredFit:
    """Fit pose and gaps to the places, each with the weight that its covariance and the panel's own scatter give it."""
    nodes = fit.layout.nodes.reshape(-1, 2)[places.node]
    rays = projected(fit.pose, (nodes + places.offset)[None])[0][0]
    fit = replace(fit, node=places.node, inlier=np.ones(len(nodes)))
    metric = np.array([1.0, float(np.exp(fit.pose.log_aspect[0]))])
    weight = np.asarray(np.linalg.inv(places.covariance + np.diag((scatter / metric) ** 2)), dtype=float)
    fit = _moved_to(fit, rays, weight, config.joint, steps)
    off, J, d_uv = _in_lattice(fit, rays)
    per_ray = np.linalg.inv(d_uv)
    information = np.swapaxes(per_ray, 1, 2) @ (_huber(off, weight)[:, None, None] * weight) @ per_ray
    own, residual = _scatter(off * metric, places, J.shape[-1], config.measurement.scatter_pitch)
    return MeasuredFit(fit, places, rays, information, own, residual, view)


def _moved_to(fit: LayoutFit, rays: Array, weight: Array, config: JointConfig, steps: int) -> LayoutFit:
    """Return the fit after so many Gauss-Newton steps towards places (M, 2) of weights (M, 2, 2), in pitches."""
    if COMPILED:
        return _by_kernel(fit, rays, weight, config, steps)
    for _ in range(steps):
        off, J, _ = _in_lattice(fit, rays)
        robust = _huber(off, weight)
        half_normal = np.swapaxes(J, 1, 2) @ (robust[:, None, None] * weight)
        normal, gradient = (half_normal @ J).sum(axis=0), (half_normal @ off[..., None]).sum(axis=0)[:, 0]
        normal[6, 6] += 1.0 / config.log_aspect_std**2
        gradient[6] -= (fit.pose.log_aspect[0] - config.log_aspect) / config.log_aspect_std**2
        step = np.linalg.solve(normal + np.diag(1e-6 + 1e-5 * np.diag(normal)), gradient)
        fit = replace(fit, pose=stepped(fit.pose, step[None, :7]), layout=moved(fit.layout, step[7:]))
    return fit


def _by_kernel(fit: LayoutFit, rays: Array, weight: Array, config: JointConfig, steps: int) -> LayoutFit:
    """Do the work of `_moved_to` by the compiled kernel."""
    given = posed_layout(fit.pose, fit.layout)
    posed, moves = placed(given, fit.node, plain(rays), plain(weight), settings(config), steps)
    return replace(fit, pose=pose_of(posed, fit.pose), layout=shifted(fit.layout, moves))


def _in_lattice(fit: LayoutFit, rays: Array) -> tuple[Array, Array, Array]:
    """Return error (M, 2) and Jacobian (M, 2, P) of the places in pitches, and d(ray) / d(column, row) (M, 2, 2)."""
    if COMPILED:
        return in_lattice(posed_layout(fit.pose, fit.layout), fit.node, plain(rays))
    error, J, d_uv = design(fit, rays)
    both = np.linalg.solve(d_uv, np.concatenate([error[..., None], J], axis=-1))
    return both[..., 0], both[..., 1:], d_uv


def _huber(off: Array, weight: Array) -> Array:
    """Return Huber's weights (M,) of errors (M, 2) by their Mahalanobis distance."""
    d2 = (off * (weight @ off[..., None])[..., 0]).sum(axis=1)
    return np.asarray(np.minimum(1.0, HUBER / np.sqrt(np.maximum(d2, 1e-12))))


def _scatter(off: Array, places: Places, parameters: int, usual: float) -> tuple[float, float]:
    """Return scatter and residual of the seen places' errors (M, 2), in column pitches; infinite where none is seen."""
    seen = places.seen
    if not seen.any():
        return usual, float("inf")
    # Fitting takes its share of the errors.
    free = max(0.2, 1.0 - parameters / (2.0 * len(off)))
    variance = (1.4826 * float(np.median(np.abs(off[seen])))) ** 2 / free
    measured = float(np.median(places.covariance[seen].trace(axis1=1, axis2=2))) / 2.0
    number = float(seen.sum())
    own = (_SCATTER_WORTH * usual**2 + number * max(0.0, variance - measured)) / (_SCATTER_WORTH + number)
    return float(np.clip(np.sqrt(own), _LEAST_SCATTER, _MOST_SCATTER)), float(np.sqrt(variance))
