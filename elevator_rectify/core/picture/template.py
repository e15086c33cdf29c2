"""Alignment of all buttons to their common template, which they make themselves.

The feature is the logarithm of the gradient's size, blind to polarity: a lit button looks like a dark one. The template
is the buttons' median; where they differ, as in their characters, it counts little.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import cv2
import numpy as np

from elevator_rectify.core.compiled import COMPILED
from elevator_rectify.core.picture.kernels import LEAST_GAIN, REWEIGHTINGS, aligned
from elevator_rectify.core.robust import median
from elevator_rectify.core.types import Array

# Grey values per sample: gradients below are noise.
_NOISE_GRADIENT = 6.0
_DERIVATIVE_SIGMA = 0.7
_INNER_WEIGHT = 0.25
_DEVIATION_FLOOR = 0.15
# So few whole patches make a template of their own; so many suffice.
_FEWEST_WHOLE, _ENOUGH = 4, 24
_SYMMETRIC = 0.6
# Of a symmetric matrix of four unknowns.
_FIRST, _SECOND = np.triu_indices(4)


@dataclass(frozen=True)
class Template:
    """The buttons' common look (n, n), the weight of each sample (n, n), and the blur it was made with, in samples."""

    look: Array
    weight: Array
    blur: float

    @cached_property
    def design(self) -> tuple[Array, Array]:
        """Return the columns (n n, 4) of the alignment's linear model, and the products (n n, 10) of each two."""
        gv, gu = np.gradient(self.look)
        A = np.stack([gu.ravel(), gv.ravel(), self.look.ravel(), np.ones(self.look.size, np.float32)], axis=-1)
        return A, A[:, _FIRST] * A[:, _SECOND]


@dataclass(frozen=True)
class Aligned:
    """M patches aligned to the template.

    shift: (M, 2) of each patch's button from the patch's centre, in samples (column, row); covariance: (M, 2, 2) of it;
    correlation: (M,) of patch and template, weighted.
    """

    shift: Array
    covariance: Array
    correlation: Array


@cache
def _kernel(n: int, sigma: float, derivative: bool = False) -> Array:
    """Return the matrix (n, n) that blurs a column of n samples, or takes the blurred one's derivative.

    Beyond the ends the samples repeat.
    """
    reach = int(np.ceil(3.5 * sigma))
    at = np.arange(-reach, reach + 1, dtype=float)
    kernel = np.exp(-0.5 * (at / sigma) ** 2)
    kernel = at * kernel / (at * at * kernel).sum() if derivative else kernel / kernel.sum()
    matrix = np.zeros((n, n))
    for k, value in zip(at.astype(int), kernel, strict=True):
        np.add.at(matrix, (np.arange(n), np.clip(np.arange(n) + k, 0, n - 1)), value)
    return matrix.astype(np.float32)


def feature(patches: Array, blur: float) -> Array:
    """Return half the logarithm of the squared gradient over the noise's (M, n, n), blurred by so many samples."""
    n = patches.shape[-1]
    along, across = _kernel(n, _DERIVATIVE_SIGMA, True), _kernel(n, _DERIVATIVE_SIGMA)
    gu, gv = across @ patches @ along.T, along @ patches @ across.T
    G = _kernel(n, blur)
    return np.asarray(G @ (0.5 * np.log1p((gu * gu + gv * gv) * np.float32(_NOISE_GRADIENT**-2))) @ G.T)


def make_template(features: Array, inside: Array, outline_share: float, blur: float) -> Template:
    """Return the template of features (M, n, n); whole patches make it where there are enough.

    outline_share: the button's half size over the patch's.
    """
    whole = np.flatnonzero(inside.all(axis=(1, 2)))
    chosen = features[whole] if len(whole) >= _FEWEST_WHOLE else features
    chosen = chosen[:: -(-len(chosen) // _ENOUGH)]
    look = median(chosen)
    deviation = np.float32(1.4826) * median(np.abs(chosen - look))
    weight = _fading(features.shape[-1], round(outline_share, 2)) / (deviation**2 + np.float32(_DEVIATION_FLOOR**2))
    return Template(look, weight, blur)


@cache
def _fading(n: int, outline_share: float) -> Array:
    """Return the weight (n, n) by place: less inside the button, where its character is, none at the patch's border."""
    at = np.abs(np.linspace(-1.0, 1.0, n))
    u, v = np.meshgrid(at, at)
    radius, side = np.hypot(u, v), np.maximum(u, v)
    inner = _INNER_WEIGHT + (1.0 - _INNER_WEIGHT) / (1.0 + np.exp(-(radius - 0.72 * outline_share) / 0.04))
    outer = np.clip((1.42 - radius) / 0.25, 0.0, 1.0) * np.clip((1.0 - side) / 0.1, 0.0, 1.0)
    return np.asarray(inner * outer, dtype=np.float32)


def align(template: Template, features: Array, inside: Array) -> Aligned:
    """Fit gain * template(x - shift) + offset to features (M, n, n): least squares, reweighted for what is in the way.

    One linear step from no shift, in which gain * shift is the coefficient of the template's gradient.
    """
    F = features.reshape(len(features), -1)
    x, normal, variance, total, correlation = _solutions(template, F, inside.reshape(F.shape))
    gain = np.maximum(x[:, 2], LEAST_GAIN)
    # Blurred samples are not independent of each other.
    correlated = 4.0 * np.pi * (template.blur**2 + _DERIVATIVE_SIGMA**2)
    counted = inside.reshape(F.shape) @ (template.weight.ravel() > 0).astype(np.float32)
    mean_weight = total / np.maximum(counted, 1.0)
    spread = (correlated * variance * mean_weight / gain**2)[:, None, None]
    covariance = np.linalg.inv(normal)[:, :2, :2] * spread
    return Aligned(-x[:, :2] / gain[:, None], covariance, correlation)


def _solutions(template: Template, F: Array, inside: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Return the coefficients (M, 4) of rows of features (M, n n), normal matrices (M, 4, 4), variances (M,), total
    weights (M,) and correlations (M,)."""
    if COMPILED:
        return _by_kernel(template, F, inside)
    A, products = template.design
    ones = np.ones(template.look.size, np.float32)
    base = inside * template.weight.ravel()
    total = base @ ones + np.float32(1e-6)
    weight = base
    for _ in range(REWEIGHTINGS):
        normal = np.empty((len(F), 4, 4))
        normal[:, _FIRST, _SECOND] = normal[:, _SECOND, _FIRST] = weight @ products
        normal += 1e-6 * np.eye(4)
        x = np.linalg.solve(normal, ((weight * F) @ A).astype(float)[..., None])[..., 0]
        residual2 = (F - x.astype(np.float32) @ A.T) ** 2
        variance = (base * residual2) @ ones / total
        # Cauchy's weights.
        weight = base / (1.0 + residual2 / (2.0 * variance + np.float32(1e-9))[:, None])
    return x, normal, variance, total, _correlation(template, F, base, total)


def _by_kernel(template: Template, F: Array, inside: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Do the work of `_solutions` by the compiled kernel."""
    A, look, weight, patches = (
        np.ascontiguousarray(part, dtype=np.float32)
        for part in (template.design[0], template.look.ravel(), template.weight.ravel(), F)
    )
    return aligned(A, look, weight, patches, np.ascontiguousarray(inside))


def _correlation(template: Template, F: Array, weight: Array, total: Array) -> Array:
    """Return the weighted correlation (M,) of the template with each row of F."""
    look = template.look.ravel()
    moments = weight @ np.stack([look, look * look], axis=-1)
    weighted = weight * F
    mean_f, mean_t = weighted.sum(axis=1) / total, moments[:, 0] / total
    covariance = weighted @ look / total - mean_f * mean_t
    variance_f, variance_t = (weighted * F).sum(axis=1) / total - mean_f**2, moments[:, 1] / total - mean_t**2
    return np.asarray(covariance / np.sqrt(np.maximum(variance_f * variance_t, 1e-12)), dtype=float)


def symmetry_centre(template: Template) -> Array:
    """Return where the template's centre of symmetry is (2,), in samples from its middle; NaN where it has none.

    Buttons look the same when they are turned by half a turn, but for their characters: aligning the template with
    itself, turned, finds the centre, which the boxes know no better than to a pixel.
    """
    weight = np.minimum(template.weight, template.weight[::-1, ::-1])
    turned = Template(template.look[::-1, ::-1], weight, template.blur)
    n = len(weight)
    whole, between = np.ones((1, n, n), dtype=bool), np.zeros(2)
    for _ in range(3):
        move = np.array([[1.0, 0.0, -between[0]], [0.0, 1.0, -between[1]]])
        back = cv2.warpAffine(template.look, move, (n, n), borderMode=cv2.BORDER_REPLICATE)
        found = align(turned, back[None], whole)
        between = between + np.clip(found.shift[0], -0.2 * n, 0.2 * n)
    # The look is centred at c, the turned one at -c.
    return between / 2.0 if found.correlation[0] > _SYMMETRIC else np.full(2, np.nan)
