"""Configuration: one frozen dataclass per stage; every default, range and meaning stands here once.

The path of a field is its ROS parameter's name: ``Config.em.outlier_share`` is the parameter ``em.outlier_share``.
"""

from __future__ import annotations

import math
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, replace
from typing import Any

METHODS = ("joint", "paper", "paper_as_printed")


def value(
    default: Any,
    meaning: str,
    *,
    low: float = -math.inf,
    high: float = math.inf,
    choices: tuple[str, ...] = (),
) -> Any:
    """Declare a configuration value with its default, meaning and inclusive range (or choices)."""
    return field(default=default, metadata={"meaning": meaning, "low": low, "high": high, "choices": choices})


def check_value(name: str, item: Field[Any], content: object) -> None:
    """Raise ValueError where `content` has another type than the default or lies outside the range."""
    kind = type(item.default)
    if kind is float and isinstance(content, int) and not isinstance(content, bool):
        content = float(content)
    if type(content) is not kind:
        raise ValueError(f"{name} must be {kind.__name__}, not {content!r}")
    meta = item.metadata
    if meta["choices"] and content not in meta["choices"]:
        raise ValueError(f"{name} must be one of {', '.join(meta['choices'])}, not {content!r}")
    if isinstance(content, (int, float)) and not meta["low"] <= content <= meta["high"]:
        raise ValueError(f"{name} must lie in [{meta['low']:g}, {meta['high']:g}], not {content!r}")


@dataclass(frozen=True)
class Checked:
    """Base of the configurations: checks type and range of every value when made."""

    def __post_init__(self) -> None:
        """Raise ValueError at the first value out of its range."""
        for item in fields(self):
            content = getattr(self, item.name)
            if item.default_factory is not MISSING:
                if not isinstance(content, type(item.default_factory())):
                    kind = getattr(item.default_factory, "__name__", "a configuration")
                    raise ValueError(f"{type(self).__name__}.{item.name} must be a {kind}, not {content!r}")
            else:
                check_value(f"{type(self).__name__}.{item.name}", item, content)


@dataclass(frozen=True)
class InputConfig(Checked):
    """Which detections are used."""

    min_detections: int = value(6, "fewest usable detections; with fewer any grid fits", low=5, high=100)
    max_detections: int = value(200, "most detections used; beyond it the best-scored are kept", low=10, high=2000)
    min_score: float = value(0.0, "detections with a lower score are ignored", low=0.0, high=1.0)


@dataclass(frozen=True)
class HypothesesConfig(Checked):
    """Lattice hypotheses of the joint method."""

    neighbours: int = value(5, "neighbours to the right and below that a seed may use", low=1, high=20)
    seeds: int = value(96, "best supported seeds that are grown", low=1, high=1000)
    refined: int = value(8, "best grown hypotheses that are refined", low=1, high=100)
    quick_confidence: float = value(
        0.97, "a first search of an eighth suffices where its fit is at least as sure as this", low=0.0, high=1.0
    )
    last_attempt: int = value(
        8, "times more hypotheses in a last search, where the fit is refused; 1: none", low=1, high=100
    )
    max_axis_angle_rad: float = value(0.9, "largest angle of a row from horizontal in the image", low=0.1, high=1.5)
    max_aspect: float = value(3.5, "largest ratio of a cell's sides in the image", low=1.0, high=20.0)

    def scaled(self, times: float) -> HypothesesConfig:
        """Return a search among so many times as many hypotheses."""
        seeds, refined = round(times * self.seeds), round(times * self.refined)
        return replace(self, seeds=min(1000, max(1, seeds)), refined=min(100, max(2, refined)))


@dataclass(frozen=True)
class JointConfig(Checked):
    """Joint refinement of lattice and pose."""

    inlier_share: float = value(0.8, "prior share of detections that are buttons of the panel", low=0.05, high=0.999)
    log_aspect: float = value(
        0.0, "prior of ln(row pitch / column pitch), where scale.row_pitch_m is 0", low=-1.5, high=1.5
    )
    log_aspect_std: float = value(0.4, "prior spread of ln(row pitch / column pitch)", low=1e-4, high=10.0)
    max_usual_tilt_rad: float = value(
        1.0, "tilt up to which all are equally likely; beyond, the prior falls", low=0.1, high=1.5
    )
    max_roll_rad: float = value(0.785, "largest roll: the camera is upright within this", low=0.01, high=1.5)
    empty_nats: float = value(
        0.5, "log likelihood that an empty cell costs: panels are mostly full", low=0.0, high=10.0
    )
    gap_nats: float = value(4.5, "log likelihood that a gap of no whole pitch must gain", low=0.0, high=100.0)
    stagger_nats: float = value(3.0, "log likelihood that a half-pitch row or column must gain", low=0.0, high=100.0)
    camera_roll_rad: float = value(
        0.0, "roll of the camera about its axis: where the panel's rows point", low=-3.15, high=3.15
    )
    focal_std_share: float = value(0.03, "standard deviation of the focal length over itself", low=0.0, high=0.5)
    radial_std: float = value(
        0.02, "standard deviation of the lens's first radial coefficient, k1 of plumb_bob", low=0.0, high=0.5
    )
    ambiguity_nats: float = value(3.0, "margin below which a second pose makes the fit ambiguous", low=0.0, high=100.0)


@dataclass(frozen=True)
class EmConfig(Checked):
    """Expectation maximisation of the paper's Gaussian mixture."""

    inlier_share: float = value(0.8, "weight of the grid's component, the paper's a", low=0.01, high=0.999)
    initial_sigma_px: float = value(640.0, "first standard deviation of a centre", low=1.0, high=1e5)
    initial_pitch_px: float = value(100.0, "first column and row pitch, the paper's D", low=1.0, high=1e5)
    min_sigma_px: float = value(0.3, "floor of the standard deviation; no detector is better", low=1e-9, high=10.0)
    max_iterations: int = value(300, "EM iterations per fit", low=1, high=10000)
    tolerance: float = value(1e-6, "stop when the log likelihood rises by less", low=0.0, high=1.0)


@dataclass(frozen=True)
class MotionConfig(Checked):
    """Levenberg-Marquardt estimate of the plane's rigid motion."""

    max_iterations: int = value(50, "LM iterations per round", low=1, high=1000)
    tolerance: float = value(1e-12, "stop when the step's squared length is smaller", low=0.0, high=1.0)


@dataclass(frozen=True)
class RoundsConfig(Checked):
    """Alternation of grid fit and motion."""

    max_rounds: int = value(30, "rounds of grid fit and motion", low=1, high=1000)
    tolerance: float = value(1e-5, "settled when the grid's corners move less, in focal lengths", low=0.0, high=1.0)


@dataclass(frozen=True)
class SizeConfig(Checked):
    """Choice of the number of rows and columns by likelihood."""

    rows: int = value(0, "rows of the grid; 0: found by likelihood", low=0, high=60)
    columns: int = value(0, "columns of the grid; 0: found by likelihood", low=0, high=60)
    max_rows: int = value(12, "most rows tried", low=2, high=60)
    max_columns: int = value(8, "most columns tried", low=2, high=60)
    candidates: int = value(4, "best sizes of the first fit that are followed through all rounds", low=1, high=100)


@dataclass(frozen=True)
class AcceptConfig(Checked):
    """When a fit may be used."""

    min_confidence: float = value(
        0.8, "a fit to the detections or outlines alone with a lower confidence is refused", low=0.0, high=1.0
    )
    min_inlier_share: float = value(0.6, "paper methods: fewest inliers over detections", low=0.0, high=1.0)
    min_occupancy: float = value(0.5, "paper methods: fewest filled cells over cells", low=0.0, high=1.0)
    max_rms_pitch: float = value(0.12, "paper methods: largest rms residual, in pitches", low=1e-3, high=0.5)
    covariance_scale: float = value(1.25, "factor on the covariance, from calibration", low=0.01, high=100.0)
    max_rotation_std_rad: float = value(0.1, "largest standard deviation of the rotation", low=1e-3, high=3.0)


@dataclass(frozen=True)
class ScaleConfig(Checked):
    """The metric scale, which one picture of a grid cannot give."""

    column_pitch_m: float = value(
        0.0, "distance of two neighbouring buttons in a row; 0: unknown, then lengths are in it", low=0.0, high=1.0
    )
    column_pitch_std_m: float = value(0.002, "its standard deviation", low=0.0, high=1.0)
    row_pitch_m: float = value(
        0.0, "distance of two rows; with the columns' one, their ratio sharpens the pose; 0: unknown", low=0.0, high=1.0
    )
    row_pitch_std_m: float = value(0.0005, "its standard deviation", low=0.0, high=1.0)


@dataclass(frozen=True)
class SmoothingConfig(Checked):
    """Smoothing from frame to frame."""

    speed_m_per_s: float = value(0.3, "usual speed of the camera: how much the pose may change", low=0.0, high=100.0)
    turn_rad_per_s: float = value(0.5, "usual turning speed of the camera", low=0.0, high=100.0)
    max_gap_s: float = value(1.0, "a last fit older than this is forgotten", low=0.0, high=100.0)
    usual_pitch_m: float = value(0.045, "column pitch assumed for the speed where it is unknown", low=0.001, high=1.0)


@dataclass(frozen=True)
class NoiseConfig(Checked):
    """Noise of the detections."""

    sigma_px: float = value(
        1.5, "standard deviation of a detected centre, for an image 640 px long", low=0.01, high=100.0
    )
    sigma_per_size: float = value(
        0.06, "standard deviation over the size of a box, where boxes have one", low=1e-3, high=1.0
    )
    min_sigma_px: float = value(1.0, "smallest standard deviation, where boxes have a size", low=0.01, high=100.0)


@dataclass(frozen=True)
class MeasurementConfig(Checked):
    """Measurement of the buttons in the picture."""

    scatter_pitch: float = value(
        0.003, "usual standard deviation of the buttons' places on a panel, in column pitches", low=1e-4, high=0.1
    )
    min_seen_share: float = value(
        0.5, "smallest share of the detected buttons that the picture must show to be used", low=0.0, high=1.0
    )
    witness: bool = value(
        True,
        "where the picture does not confirm the boxes, our own detector is asked whether it contradicts them; and our "
        "own reader whether the labels stand upright",
    )
    min_confidence: float = value(0.75, "a fit to the picture with a lower confidence is refused", low=0.0, high=1.0)
    edges: bool = value(False, "straight edges that run along the panel's directions sharpen the rotation")
    covariance_scale: float = value(2.5, "factor on the covariance, from calibration", low=0.01, high=100.0)


@dataclass(frozen=True)
class OutlineConfig(Checked):
    """Panels of few buttons, single rows and columns: the pose from the buttons' outlines in the picture."""

    button_size_m: float = value(
        0.0, "height of a button; 0: unknown, then lengths are in pitches or in heights", low=0.0, high=1.0
    )
    button_size_std_m: float = value(0.001, "its standard deviation", low=0.0, high=1.0)
    edges: bool = value(True, "straight edges of plates and frames help to settle the pose")
    up_x: float = value(0.0, "direction against gravity in the camera's frame, x; all 0: unknown", low=-1.0, high=1.0)
    up_y: float = value(0.0, "y of it; -1 for an upright camera", low=-1.0, high=1.0)
    up_z: float = value(0.0, "z of it", low=-1.0, high=1.0)
    ambiguity_nats: float = value(6.0, "margin below which a second pose makes the fit ambiguous", low=0.0, high=100.0)


@dataclass(frozen=True)
class PanelConfig(Checked):
    """The panel that hangs there, where it was taught."""

    file: str = value("", "panel file of `teach`: only its pose is sought, and another panel is refused")


@dataclass(frozen=True)
class LabelsConfig(Checked):
    """What the buttons' labels and the panel's order say of each other."""

    min_button: float = value(
        0.9, "probability from which on a cell without detection is an inferred button", low=0.0, high=1.0
    )
    min_correction: float = value(
        0.9, "probability from which on a floor replaces another label that was read", low=0.5, high=1.0
    )
    min_inference: float = value(
        0.5, "probability from which on a button without a read label gets one", low=0.0, high=1.0
    )
    plates_on_left: bool = value(
        False, "prints to the left of buttons without print are their labels; else neither of the two is pressed"
    )


@dataclass(frozen=True)
class TargetConfig(Checked):
    """The button that is to be pressed."""

    min_score: float = value(
        0.5,
        "a label that was read with a lower score is not pressed, unless our own reader's alternatives leave no other",
        low=0.0,
        high=1.0,
    )
    min_probability: float = value(
        0.9, "a button is pressed if its label is right, and no other's, with this probability", low=0.0, high=1.0
    )
    min_inferred_probability: float = value(
        0.98, "the same for a label that the others' order tells, and hardly our own reader", low=0.0, high=1.0
    )
    allow_inferred: bool = value(
        False, "buttons that were neither detected nor read may be pressed, with min_probability alone"
    )
    camera_is_upright: bool = value(
        False, "pictures never stand on their head: 6 is no 9 and up no down, though few labels tell which way is up"
    )
    max_lateral_std_m: float = value(
        0.01,
        "largest standard deviation of a button's place across the pressing direction, the camera's calibration aside",
        low=0.0,
        high=1.0,
    )
    standoff_m: float = value(0.1, "distance of the approach pose from the button", low=0.0, high=2.0)
    refuse_lit: bool = value(False, "a button whose lamp is surely lit is not given: it was pressed before")


@dataclass(frozen=True)
class NetworkConfig(Checked):
    """Our own detector and reader."""

    detector_side_px: int = value(
        640,
        "the picture's longer side as the detector sees it; larger ones get a second look if they show hardly a button",
        low=128,
        high=4096,
    )
    min_score: float = value(0.4, "buttons that are less probable are left out", low=0.0, high=1.0)
    min_score_few: float = value(
        0.65, "the same where fewer than six are found: no lattice tells them from other things then", low=0.0, high=1.0
    )
    keyframe_s: float = value(
        0.5,
        "the detector looks, and the reader reads, this often; between, boxes and labels follow; 0: every frame",
        low=0.0,
        high=100.0,
    )


@dataclass(frozen=True)
class ViewConfig(Checked):
    """The rectified view."""

    margin_pitch: float = value(1.0, "margin around the outer buttons' centres, in pitches", low=0.0, high=20.0)
    max_size_px: int = value(1280, "largest width or height of the rectified image", low=16, high=16384)
    max_share: float = value(1.0, "most pixels of the rectified image, over the input's", low=0.01, high=100.0)


@dataclass(frozen=True)
class Config(Checked):
    """All that a fit depends on, besides its input."""

    method: str = value("joint", "estimator", choices=METHODS)
    input: InputConfig = field(default_factory=InputConfig)
    smoothing: SmoothingConfig = field(default_factory=SmoothingConfig)
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    hypotheses: HypothesesConfig = field(default_factory=HypothesesConfig)
    joint: JointConfig = field(default_factory=JointConfig)
    em: EmConfig = field(default_factory=EmConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    rounds: RoundsConfig = field(default_factory=RoundsConfig)
    size: SizeConfig = field(default_factory=SizeConfig)
    accept: AcceptConfig = field(default_factory=AcceptConfig)
    scale: ScaleConfig = field(default_factory=ScaleConfig)
    measurement: MeasurementConfig = field(default_factory=MeasurementConfig)
    outline: OutlineConfig = field(default_factory=OutlineConfig)
    panel: PanelConfig = field(default_factory=PanelConfig)
    labels: LabelsConfig = field(default_factory=LabelsConfig)
    target: TargetConfig = field(default_factory=TargetConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    view: ViewConfig = field(default_factory=ViewConfig)


def flatten(config: Any, prefix: str = "") -> dict[str, tuple[Field[Any], Any]]:
    """Return {path: (field, value)} of a configuration and all that it contains."""
    flat: dict[str, tuple[Field[Any], Any]] = {}
    for item in fields(config):
        content = getattr(config, item.name)
        if is_dataclass(content):
            flat.update(flatten(content, f"{prefix}{item.name}."))
        else:
            flat[prefix + item.name] = (item, content)
    return flat


def with_values(config: Any, values: dict[str, Any], prefix: str = "") -> Any:
    """Return the configuration with the values at the given paths; ValueError for an unknown path or bad value."""
    names = {item.name for item in fields(config)}
    changes: dict[str, Any] = {}
    nested: dict[str, dict[str, Any]] = {}
    for path, content in values.items():
        head, _, rest = path.partition(".")
        if head not in names or bool(rest) != is_dataclass(getattr(config, head)):
            raise ValueError(f"there is no parameter '{prefix}{path}'")
        if rest:
            nested.setdefault(head, {})[rest] = content
        else:
            # `column_pitch_m:=1` is an integer to ROS and YAML.
            whole = isinstance(getattr(config, head), float) and type(content) is int
            changes[head] = float(content) if whole else content
    for head, inner in nested.items():
        changes[head] = with_values(getattr(config, head), inner, f"{prefix}{head}.")
    return replace(config, **changes)
