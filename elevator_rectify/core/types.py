"""The values that pass between the stages."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Image = NDArray[Any]


@dataclass(frozen=True)
class Detection:
    """One detected button: box centre and size in pixels, reading and score as far as known.

    readings: all that may be printed there with its probability, likeliest first, where the reader says more than one
    label; what is missing to 1 is that nothing can be read.
    """

    x_px: float
    y_px: float
    width_px: float = 0.0
    height_px: float = 0.0
    label: str = ""
    score: float = 1.0
    readings: tuple[tuple[str, float], ...] = ()


def _nan(*shape: int) -> Any:
    return field(default_factory=lambda: np.full(shape, np.nan))


@dataclass(frozen=True)
class Button:
    """One place of a fitted panel that holds a button, or may hold one.

    state: 'observed' where a detection is, 'inferred' where the picture or the panel's order says that there is one,
    'empty' else; probability: that there is a button. image_px: (2,) its centre in the (distorted) image; panel: (2,)
    its place in the panel frame, the cell's, or the detection's where it lies beside the grid (row, column and block
    are -1 then); point: (3,) in the camera frame, with covariance (3, 3); normal: (3,) unit vector out of the panel,
    towards the camera; size: its width and height. Lengths are in the fit's unit. label: what it means (`canonical`),
    label_source: 'read', 'corrected' (another one was read), 'inferred' (none was), 'taught' or '' (no label);
    label_probability: that it is right; read: as the detector wrote it, score: the detector's, detection: index into
    the input, -1 for none. lit: whether its lamp is lit, 'yes', 'no' or 'unseen' (`lamps.lit`); lit_probability: that
    it is, NaN where nothing can be said.
    """

    block: tuple[int, int]
    row: int
    column: int
    image_px: Array
    panel: Array
    point: Array
    covariance: Array
    normal: Array
    size: tuple[float, float]
    label: str
    read: str
    score: float
    detection: int
    state: str = "observed"
    probability: float = 1.0
    label_source: str = ""
    label_probability: float = 0.0
    lit: str = "unseen"
    lit_probability: float = float("nan")


@dataclass(frozen=True)
class Measurement:
    """What the picture shows of the grid's cells; NaN where it shows no button.

    centre_px: (rows, columns, 2) the button's centre in the (distorted) image, covariance_px2: (rows, columns, 2, 2) of
    it; correlation: (rows, columns) with the buttons' common look, up to 1. half_size: (2,) of a button, in the fit's
    unit. residual, scatter: rms distance of the buttons from the lattice, and the part of it that is the panel's own,
    in column pitches. uprightness: (3,) what the picture's straight edges say of the pose (`straight_edges`).
    """

    centre_px: Array
    covariance_px2: Array
    correlation: Array
    half_size: Array
    residual: float
    scatter: float
    uprightness: Array = _nan(3)


@dataclass(frozen=True)
class KnownPanel:
    """A panel that was taught: K buttons in its panel frame, and the lattice that most of them belong to.

    labels: (K,) canonical, '' where there is none; places, sizes: (K, 2), in metres where `metric`, else in column
    pitches; cells: (K, 2) row and column, -1 beside the lattice. pitch, row_positions, column_positions and the rest of
    the lattice: as in FitResult. place_std: of a button's place, in the same unit; log_aspect_std: of ln(height /
    width) of the whole; scale_std_share: of the scale, over itself.
    """

    name: str
    labels: tuple[str, ...]
    places: Array
    sizes: Array
    cells: IntArray
    metric: bool
    pitch: Array
    row_positions: Array
    column_positions: Array
    row_staggered: BoolArray
    column_staggered: BoolArray
    row_block: IntArray
    column_block: IntArray
    place_std: float = 0.0
    log_aspect_std: float = 0.0
    scale_std_share: float = 0.0


@dataclass(frozen=True)
class FitResult:
    """The fitted grid and the panel's pose, or the reason why there is none.

    Lengths are in metres where the column pitch is known, else in column pitches (`metric` tells): the distance of two
    neighbouring buttons in a row. They are `apart` columns of the lattice apart: 2 where one column of floors stands
    above the middle of a pair.

    The panel frame has x along a row to the right, y down a column, z into the panel; its origin is the centre of cell
    (0, 0).
    Where no pose was found, the geometry is NaN; where one was found but refused, it is the refused one.

    row_positions, column_positions: in pitches; a staggered row is half a pitch to the right, a staggered column half
    a pitch down; row_block, column_block: number of the regular block, counted from 0, divided by gaps that are no
    whole pitch. alternatives: with status 'ambiguous', the other poses that explain the detections almost as well;
    margin_nats: the log likelihood between the best and the next one. detections: as given, where they were given as
    a list; `cells` has the same order, and so have rays (N, 2), the detections in undistorted normalised coordinates,
    NaN where not usable. measurement: of the buttons in the picture, where one was given and showed them. undetected:
    by cell, the buttons that it shows and nobody detected, as they were read; None for what is no button.
    labels_upright: whether its labels are clearly read better upright than on their head. known: the taught panel that
    this is; matched: (N,) which of its buttons each detection is, -1 for none; shown: (K,) which of
    its buttons a detection or the picture shows; known_px: (K, 2) where they are in the (distorted) image.

    covariance: (6, 6) of t and rotation (about the camera's axes), with the errors of the scale, of the camera's
    calibration and of being mistaken. shape_covariance: (6 + S, 6 + S) of t, rotation and what shapes the panel,
    without those: ln(row pitch / column pitch), then the row breaks and column breaks in pitches, as far as the method
    has them; scale_std_share: of the scale, over itself; common_response: (6 + S, 5) by how much one standard deviation
    of the focal length, of the lens's radial coefficient, and of a mistaken fit's turn about each axis moves them;
    (0, 5) before it is known.
    """

    status: str
    reason: str = ""
    method: str = ""
    confidence: float = 0.0
    metric: bool = False
    R_camera_panel: Array = _nan(3, 3)
    t_camera_panel: Array = _nan(3)
    pitch: Array = _nan(2)
    apart: float = 1.0
    covariance: Array = _nan(6, 6)
    shape_covariance: Array = _nan(6, 6)
    scale_std_share: float = 0.0
    common_response: Array = field(default_factory=lambda: np.zeros((0, 5)))
    cells: IntArray = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    rows: int = 0
    columns: int = 0
    row_positions: Array = field(default_factory=lambda: np.zeros(0))
    column_positions: Array = field(default_factory=lambda: np.zeros(0))
    row_staggered: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    column_staggered: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    row_block: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    column_block: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    grid_panel: Array = field(default_factory=lambda: np.zeros((0, 0, 2)))
    grid_points: Array = field(default_factory=lambda: np.zeros((0, 0, 3)))
    grid_px: Array = field(default_factory=lambda: np.zeros((0, 0, 2)))
    rms_px: float = float("nan")
    inliers: int = 0
    iterations: int = 0
    converged: bool = False
    cost_x1000: float = float("nan")
    margin_nats: float = float("inf")
    alternatives: tuple[FitResult, ...] = ()
    detections: tuple[Detection, ...] = ()
    rays: Array = field(default_factory=lambda: np.zeros((0, 2)))
    measurement: Measurement | None = None
    undetected: dict[tuple[int, int], Detection | None] = field(default_factory=dict)
    labels_upright: bool = False
    known: KnownPanel | None = None
    matched: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    shown: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    known_px: Array = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def ok(self) -> bool:
        """Tell whether the pose may be used."""
        return self.status == "ok"

    @property
    def filled(self) -> BoolArray:
        """Return (rows, columns) which cells have a detection."""
        filled = np.zeros((self.rows, self.columns), dtype=bool)
        filled[tuple(self.cells[self.cells[:, 0] >= 0].T)] = True
        return filled

    @property
    def column_pitch(self) -> float:
        """Return the distance of two neighbouring buttons in a row, in the fit's unit."""
        return float(self.pitch[0]) * self.apart

    def point_at(self, place: Array) -> Array:
        """Return the point (3,) in the camera frame of a place (2,) on the panel, in the fit's unit."""
        return np.asarray(self.R_camera_panel[:, :2] @ place + self.t_camera_panel)


# What a stage makes of a result is a result of the same class.
FitT = TypeVar("FitT", bound=FitResult)
