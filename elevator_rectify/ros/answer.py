"""One frame's messages through the core: what the live node and the bag replay do with every frame."""

from __future__ import annotations

import time
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from elevator_rectify.core.config import Config, LabelsConfig
from elevator_rectify.core.detector.follow import Found, find_or_follow
from elevator_rectify.core.find import of_own_boxes, with_labels
from elevator_rectify.core.geometry.panel_frame import PanelFrame, began, followed
from elevator_rectify.core.geometry.scale import with_scale
from elevator_rectify.core.lamps.lit import Lit, lit_in, with_lit
from elevator_rectify.core.lamps.patches import Patches, patches_of
from elevator_rectify.core.picture.placement import Placement, placement
from elevator_rectify.core.pipeline import fit_panel
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.reading.hidden import hidden_labels, unless_hidden, unless_respaced
from elevator_rectify.core.reading.target import Choice, find_button
from elevator_rectify.core.track import Track, recent, recently_read, remembered, smoothed, with_read
from elevator_rectify.core.types import Array, Button, Detection, FitResult, Image
from elevator_rectify.core.view.draw import draw_overlay, draw_rectified
from elevator_rectify.core.view.warp import Rectification, rectify_image
from elevator_rectify.ros.config import DEFAULT_NODE, NodeConfig
from elevator_rectify.ros.convert import NUMBER_IDS, has_number_ids, stamp_ns
from elevator_rectify.ros.inputs import Inputs, inputs
from elevator_rectify.ros.pairing import Frame
from elevator_rectify.ros.pictures import BadMessage


@dataclass
class Stopwatch:
    """Milliseconds by stage."""

    milliseconds: dict[str, float] = field(default_factory=dict)
    _last: float = field(default_factory=time.perf_counter)

    def lap(self, stage: str) -> None:
        """Book the time since the last lap on `stage`."""
        now = time.perf_counter()
        self.milliseconds[stage] = self.milliseconds.get(stage, 0.0) + 1e3 * (now - self._last)
        self._last = now


@dataclass(frozen=True)
class Answer:
    """What is published for one frame; `header` is the image's, `scale` says where the metric scale is from."""

    header: Any
    fit: GridFit
    detections: tuple[Detection, ...] = ()
    view: Rectification | None = None
    overlay: Image | None = None
    rectified_overlay: Image | None = None
    scale: str = "unknown"
    detections_from: str = "topic"
    found: Found | None = None
    target: str = ""
    choice: Choice | None = None
    # Labels that were read a little before where nothing is seen now.
    hidden: frozenset[str] = frozenset()
    # Which lamps are lit, in this frame or in the last one whose labels were read.
    lit: Lit | None = None
    # Of an accepted fit.
    panel_frame: PanelFrame | None = None
    standoff_m: float = 0.0
    stopwatch: Stopwatch = field(default_factory=Stopwatch)
    labels: LabelsConfig = field(default_factory=LabelsConfig)
    placement: Placement | None = None
    patches: Patches | None = None
    # What the frames so far say of the camera's calibration, '' while they do not tell.
    calibration: str = ""

    @cached_property
    def buttons(self) -> tuple[Button, ...]:
        """Return the panel's places with their labels and lamps."""
        return with_lit(self.fit.buttons_by(self.labels), self.fit, self.lit)

    @property
    def origin(self) -> Array:
        """Return where on the panel (2,) the published panel frame's origin is."""
        return np.zeros(2) if self.panel_frame is None else self.panel_frame.origin

    @property
    def middle(self) -> Array:
        """Return where on the panel (2,) the middle of the cells is that the panel frame began with."""
        return np.zeros(2) if self.panel_frame is None else self.panel_frame.middle

    def standoff(self, button: Button) -> Array:
        """Return the point (3,) of the approach pose before a button, in the camera frame."""
        return np.asarray(button.point + self.standoff_m * button.normal)


def answer_frame(
    frame: Frame,
    config: Config,
    wanted: Collection[str] = ("rectified", "overlay", "rectified_overlay"),
    node: NodeConfig = DEFAULT_NODE,
    track: Track | None = None,
    target: str = "",
    found: Found | None = None,
) -> tuple[Answer, Track | None]:
    """Convert, fit, scale, smooth, draw. A bad message gives the status 'bad_input' and the reason; nothing is raised.

    wanted: which pictures to make, of 'rectified', 'overlay' and 'rectified_overlay', 'placement' for where boxes that
    the picture contradicts would belong, 'patches' for what the buttons look like, and 'reading' for labels that are
    read in this very frame, where those of frames just before would do; without any, and with nothing to measure in it,
    the image is checked but not converted.
    track: of the frames before, where `node.track` is on; the new one is returned. target: label of the button that is
    to be pressed, '' for none. found: what our own detector found in the frame before (`Answer.found`); it looks where
    the frame has no detections.
    """
    watch = Stopwatch()
    try:
        reads = node.read and _labels_wanted(wanted, target)
        given = inputs(frame, node, bool(wanted) or node.measure or frame.detections is None or reads)
        given = given if frame.detections is not None else _with_found(given, frame, found, config)
    except BadMessage as error:
        bad = GridFit(status="bad_input", reason=str(error), method=config.method)
        return Answer(frame.image.header, bad, stopwatch=watch), track
    watch.lap("convert")
    return _answered(frame, given, config, wanted, node, track, target, watch)


def _answered(
    frame: Frame,
    given: Inputs,
    config: Config,
    wanted: Collection[str],
    node: NodeConfig,
    track: Track | None,
    target: str,
    watch: Stopwatch,
) -> tuple[Answer, Track | None]:
    """Fit, scale, smooth, read, choose and draw; the arguments are those of `answer_frame`."""
    stamp = stamp_ns(frame.image.header)
    fit, scale = _fit(given, config, recent(track, stamp, config.smoothing), node.measure)
    fit = of_own_boxes(fit, config) if given.found is not None else fit
    before, panel_frame = track, began(fit, stamp) if fit.ok else None
    if node.track:
        track, fit = smoothed(track, fit, given.camera, stamp, config.smoothing)
        track, panel_frame = _followed(before, track, fit, stamp, config)
    watch.lap("fit")
    labels_wanted, lit, patches = fit.ok and _labels_wanted(wanted, target), None, None
    if labels_wanted:
        last = None if "reading" in wanted else recently_read(before, stamp, config.network.keyframe_s)
        fit = with_labels(fit, given.image, given.camera, last) if node.read and given.image is not None else fit
        fit = unless_respaced(fit, remembered(before, stamp))
        # What is refused now leaves the track as it was.
        track, panel_frame = (track, panel_frame) if fit.ok else (before, None)
    if labels_wanted and fit.ok:
        if "patches" in wanted or (node.lamps and last is None):
            patches = _patches(fit, given, config)
        lit = before.lit if before is not None else None
        lit = lit_in(fit, patches) if node.lamps and patches is not None else lit
        track = with_read(track, fit, stamp, before, last is None, lit) if track is not None else None
    watch.lap("read")
    seen = track.seen if track is not None and labels_wanted and fit.ok else None
    hidden = hidden_labels(seen, fit, given.camera) if seen is not None else frozenset()
    choice = chosen(fit, target, config, node, frame.detections, hidden, lit) if target else None
    view = None
    if given.image is not None and fit.ok and {"rectified", "rectified_overlay"} & set(wanted):
        view = rectify_image(given.image, given.camera, fit, config.view)
    watch.lap("warp")
    answer = Answer(
        frame.image.header,
        fit,
        tuple(given.detections),
        view=view,
        scale=scale,
        detections_from="topic" if frame.detections is not None else "own",
        found=given.found,
        target=target,
        choice=choice,
        hidden=hidden,
        lit=lit,
        patches=patches,
        panel_frame=panel_frame,
        standoff_m=config.target.standoff_m,
        stopwatch=watch,
        labels=config.labels,
    )
    if "placement" in wanted and given.image is not None and fit.status == "contradicted":
        answer = replace(answer, placement=placement(given.image, given.detections, config.network))
    answer = _with_drawings(answer, given, wanted)
    watch.lap("overlay")
    return answer, track


def _followed(
    before: Track | None, track: Track | None, fit: GridFit, stamp: int, config: Config
) -> tuple[Track | None, PanelFrame | None]:
    """Return the new track, and where the panel frame is on an accepted fit's panel, that of the track before."""
    if not fit.ok or track is None:
        return track, None
    young = recent(before, stamp, config.smoothing) is not None
    last = before.panel_frame if before is not None and young else None
    panel_frame = followed(last, fit, stamp)
    return replace(track, panel_frame=panel_frame), panel_frame


def _patches(fit: GridFit, given: Inputs, config: Config) -> Patches | None:
    """Return what an accepted fit's buttons look like in this frame, None without its picture."""
    if given.image is None or not fit.ok:
        return None
    return patches_of(given.image, given.camera, fit, fit.buttons_by(config.labels))


def _labels_wanted(wanted: Collection[str], target: str) -> bool:
    return bool(target or {"labels", "overlay", "rectified_overlay", "patches"} & set(wanted))


def _with_found(given: Inputs, frame: Frame, last: Found | None, config: Config) -> Inputs:
    """Return the inputs with the buttons that our own detector finds in the image."""
    assert given.image is not None
    found = find_or_follow(given.image, stamp_ns(frame.image.header), last, config.network)
    return replace(given, detections=list(found.detections), found=found)


def chosen(
    fit: GridFit,
    target: str,
    config: Config,
    node: NodeConfig,
    detections: Any,
    hidden: frozenset[str] = frozenset(),
    lit: Lit | None = None,
) -> Choice:
    """Return the button that is asked for; where no label is known, the reason names the parameter that may be it.

    hidden: labels of buttons that were seen a little before. lit: which lamps are lit.
    """
    choice = unless_hidden(find_button(fit, target, config.target), target, hidden)
    choice = _unless_lit(choice, fit, lit, config.target.refuse_lit)
    settled = node.detections.numbers_are_labels or node.detections.labels
    if choice.status != "unknown_label" or settled or not has_number_ids(detections):
        return choice
    return replace(choice, reason=f"{choice.reason}; {NUMBER_IDS}")


def _unless_lit(choice: Choice, fit: GridFit, lit: Lit | None, refuse: bool) -> Choice:
    """Return the choice with its button's lamp; as 'lit' where a lit one is refused."""
    if choice.button is None:
        return choice
    (button,) = with_lit((choice.button,), fit, lit)
    if not refuse or button.lit != "yes":
        return replace(choice, button=button)
    reason = f"the lamp of {button.label} is lit with probability {button.lit_probability:.3f}"
    return Choice(None, "lit", f"{reason}, and target.refuse_lit is on")


def _with_drawings(answer: Answer, given: Inputs, wanted: Collection[str]) -> Answer:
    """Return the answer with the pictures for people that are wanted."""
    if given.image is None or not {"overlay", "rectified_overlay"} & set(wanted):
        return answer
    buttons, drawings = answer.buttons, dict[str, Any]()
    target = answer.choice.button if answer.choice is not None else None
    if "overlay" in wanted:
        drawings["overlay"] = draw_overlay(given.image, _finite_centres(given.detections), answer.fit, target, buttons)
    if answer.view is not None and "rectified_overlay" in wanted:
        drawings["rectified_overlay"] = draw_rectified(answer.view, buttons, target)
    return replace(answer, **drawings)


def _fit(given: Inputs, config: Config, previous: FitResult | None, measure: bool) -> tuple[GridFit, str]:
    """Return the fit, and where its metric scale is from."""
    image = given.image if measure else None
    if given.depth is None or isinstance(given.depth, str):
        fit = fit_panel(given.detections, given.camera, config, previous, image)
        known = fit.known is not None and fit.known.metric
        scale = "taught panel" if known else "column pitch" if fit.metric else "unknown"
        return fit, scale + (f": {given.depth}" if given.depth else "")
    in_pitches = replace(config, scale=replace(config.scale, column_pitch_m=0.0))
    fit = fit_panel(given.detections, given.camera, in_pitches, previous, image)
    if fit.metric or not fit.ok:
        return fit, "unknown" if not fit.metric else "button size" if fit.known is None else "taught panel"
    # The pitch of a single column is not that of the columns.
    pitch_m = config.scale.column_pitch_m if fit.columns > 1 else 0.0
    return with_scale(fit, given.camera, given.depth, replace(config.scale, column_pitch_m=pitch_m))


def _finite_centres(detections: list[Detection]) -> Array:
    points = np.array([[d.x_px, d.y_px] for d in detections]).reshape(-1, 2)
    return points[np.isfinite(points).all(axis=1)]
