"""The aim while an arm goes the last centimetres: its finger comes before the camera and hides the button.

Rendered: the camera rests, or goes with the arm, straight towards the button; fitted with tracking as the node does it.
The aim is the button's place in the panel frame as the first frame shows it, followed by the later frames' poses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.core import Config, GridFit, ScaleConfig, fit_panel
from elevator_rectify.core.geometry.panel_frame import PanelFrame, followed
from elevator_rectify.core.track import Track, recent, smoothed
from elevator_rectify.core.types import Array, BoolArray, Image
from elevator_rectify.render.levels import LEVELS, random_panel
from elevator_rectify.render.looks import SCATTER_SHARE, dressed, random_taking
from elevator_rectify.render.overpaint import with_finger
from elevator_rectify.render.photograph import photograph
from elevator_rectify.render.scene import (
    DetectorModel,
    Scene,
    Viewpoint,
    box_sizes_px,
    camera_pose,
    detected,
    paper_camera,
)

# The way to go, in frames 5 mm and 1 / 15 s apart, the first three at rest without a finger.
_WAY_M, _RESTING, _MOVING, _PERIOD_S = 0.05, 3, 10, 1.0 / 15.0
# How far the finger's tip is off the button at first, in the button's sizes; a box that it changes so much is hidden.
_COMES_FROM, _HIDDEN_GREY = 3.0, 30.0
_SIGMA_PX, _LEVEL = 1.2, "easy"


@dataclass(frozen=True)
class Step:
    """One frame: accepted; how far the aim is off across the pressing direction, and how far from where it was at
    first, in millimetres (NaN where there is no pose); hidden: the button has no detection."""

    accepted: bool
    off_mm: float
    drift_mm: float
    hidden: bool


def frames(seed: int, number: int, moves: bool) -> Iterator[tuple[Scene, Image, Array]]:
    """Yield scenes, pictures and the place (3,) of the button in the panel; the same arguments give the same.

    moves: whether the camera goes with the arm.
    """
    rng = np.random.default_rng([seed, number, 11])
    camera, panel = paper_camera(), dressed(random_panel(LEVELS[_LEVEL], rng), rng, True, SCATTER_SHARE)
    tilt, axis = float(np.deg2rad(rng.uniform(0.0, 30.0))), float(rng.uniform(0, 2 * np.pi))
    R, t = camera_pose(panel, camera, Viewpoint(tilt, axis, float(rng.normal(0, 0.05)), float(rng.uniform(0.5, 0.7))))
    target, taking = int(rng.integers(len(panel.buttons))), replace(random_taking(rng), motion_px=0.0)
    for k in range(_RESTING + _MOVING):
        gone = max(0, k - _RESTING + 1) / _MOVING
        at = t - gone * _WAY_M * R[:, 2] if moves else t
        scene = detected(panel, camera, R, at, DetectorModel(_SIGMA_PX, missed=0.03), rng)
        # What is drawn of panel and wall is the same in all frames.
        image = photograph(scene, np.random.default_rng([seed, number]), taking)
        if k >= _RESTING:
            size = box_sizes_px(panel, camera, R, at)[target]
            box = np.concatenate([scene.pixels[target] - size / 2, scene.pixels[target] + size / 2])
            covered = with_finger(image, box, np.random.default_rng([seed, number]), _COMES_FROM * (1.0 - gone))
            scene, image = _without(scene, _hidden(scene, image, covered)), covered
        noise = rng.normal(0.0, taking.noise, image.shape)
        yield scene, np.clip(image + noise, 0, 255).astype(np.uint8), panel.placed_m[target]


def _hidden(scene: Scene, image: Image, covered: Image) -> BoolArray:
    """Return which detections (N,) the finger hides: their middle looks different."""
    changed = np.abs(covered.astype(float) - image).max(axis=-1)
    at = scene.centres_px.round().astype(int).clip(0, [image.shape[1] - 1, image.shape[0] - 1])
    return np.asarray(changed[at[:, 1], at[:, 0]] > _HIDDEN_GREY)


def _without(scene: Scene, hidden: BoolArray) -> Scene:
    kept = tuple(d for d, h in zip(scene.detections, hidden, strict=True) if not h)
    return replace(scene, detections=kept, button=scene.button[~hidden])


def run_approach(task: tuple[int, int, bool]) -> list[Step]:
    """Follow one approach: (seed, number, whether the camera moves); empty where the first frames are refused."""
    track: Track | None = None
    held: PanelFrame | None = None
    aim, first, steps = None, np.zeros(3), list[Step]()
    for k, (scene, image, place) in enumerate(frames(*task)):
        config = Config(scale=ScaleConfig(column_pitch_m=float(scene.panel.pitch_m[0])))
        stamp = round(1e9 * (1.0 + k * _PERIOD_S))
        fit = fit_panel(scene.detections, scene.camera, config, recent(track, stamp, config.smoothing), image)
        track, fit = smoothed(track, fit, scene.camera, stamp, config.smoothing)
        held = followed(held, fit, stamp) if fit.ok else held
        true = scene.R_camera_panel @ place + scene.t_camera_panel
        if k < _RESTING:
            aim = _nearest(fit, true) - held.origin if fit.ok and held is not None else None
            if aim is not None and held is not None:
                first = _off_mm(scene, fit, held.origin + aim, true)
            continue
        if aim is None or held is None:
            return []
        off = _off_mm(scene, fit, held.origin + aim, true) if fit.ok else np.full(2, np.nan)
        hidden = not (np.linalg.norm(scene.centres_px - scene.camera.project(true[None]), axis=1) < 10).any()
        steps.append(Step(fit.ok, float(np.linalg.norm(off)), float(np.linalg.norm(off - first)), hidden))
    return steps


def _nearest(fit: GridFit, point: Array) -> Array:
    """Return the place (2,) on the panel of the button that is nearest to a point (3,)."""
    return min(fit.buttons, key=lambda b: float(np.linalg.norm(b.point - point))).panel


def _off_mm(scene: Scene, fit: GridFit, aim: Array, true: Array) -> Array:
    """Return (2,) by how much the aim is off across the pressing direction, along the panel's true axes."""
    return np.asarray(1e3 * (fit.point_at(aim) - true) @ scene.R_camera_panel[:, :2])


def approach_table(number: int, seed: int, figures: Figures) -> str:
    """Return the table over a number of approaches."""
    lines = [
        f"{f'approaches {number}':<32}{'frames':>8}{'accepted':>10}{'off mm':>8}{'p95':>7}"
        f"{'drift mm':>10}{'p95':>7}{'largest':>9}{'within 1 mm':>13}"
    ]
    for moves in (False, True):
        several = parallel(run_approach, [(seed, n, moves) for n in range(number)], "approaches")
        camera = "camera moves" if moves else "camera rests"
        for hidden in (False, True):
            steps = [step for one in several for step in one if step.hidden == hidden]
            lines.append(_line(f"{camera}, button {'hidden' if hidden else 'seen'}", steps, figures))
    return "\n".join(lines)


def _line(name: str, steps: list[Step], figures: Figures) -> str:
    off, drift = (np.array([getattr(s, field) for s in steps if s.accepted]) for field in ("off_mm", "drift_mm"))
    if not len(drift):
        return f"{name:<32}{len(steps):>8}{0.0:>10.3f}"
    figures.rate(f"approach, {name}, drift of the aim within 1 mm+", drift <= 1.0)
    return (
        f"{name:<32}{len(steps):>8}{len(drift) / len(steps):>10.3f}{np.median(off):>8.2f}{np.quantile(off, 0.95):>7.2f}"
        f"{np.median(drift):>10.2f}{np.quantile(drift, 0.95):>7.2f}{drift.max():>9.2f}{(drift <= 1.0).mean():>13.3f}"
    )
