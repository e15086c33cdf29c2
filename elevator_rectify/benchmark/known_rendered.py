"""What a taught panel adds to the pose: rendered panels, taught from several pictures, beside the free fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.pictures import pictured
from elevator_rectify.core import Config, GridFit, KnownPanel, fit_panel
from elevator_rectify.core.config import with_values
from elevator_rectify.core.geometry.rotations import rotation_angle_rad
from elevator_rectify.core.known.teach import View, joined, taught
from elevator_rectify.core.types import Array
from elevator_rectify.render.looks import random_taking
from elevator_rectify.render.panel import PITCH_M, Panel
from elevator_rectify.render.photograph import photograph
from elevator_rectify.render.scene import DetectorModel, Scene, Viewpoint, make_scene, paper_camera

_CONFIG = with_values(Config(), {"scale.column_pitch_m": PITCH_M, "scale.column_pitch_std_m": 0.0002})
_VIEWS, _AWAY_M = 6, 0.5
# A true button this near to a taught one, in pitches, is the same.
_SAME = 0.3
_CHI2_6 = 12.592


@dataclass(frozen=True)
class Fitted:
    """One fit: accepted, degrees off, (M,) lateral errors in mm 0.5 m away, in the 95 % region, wrong button."""

    accepted: bool
    error_deg: float
    lateral_mm: Array
    covered: bool
    wrong: bool


def run_scene(task: tuple[str, int, int]) -> list[Fitted]:
    """Teach the panel of one scene and fit it with and without: (level, seed, number); [] where it is not taught."""
    level, seed, number = task
    given = pictured(level, seed, number, held_out=True)
    known = _taught(given.scene.panel, np.random.default_rng([seed, number, 31]))
    if known is None:
        return []
    scene, true = given.scene, _true_button(known, given.scene.panel)
    fits = [fit_panel(list(scene.detections), scene.camera, _CONFIG, image=given.image, known=k) for k in (None, known)]
    return [_judged(fit, scene, true) for fit in fits]


def _taught(panel: Panel, rng: np.random.Generator) -> KnownPanel | None:
    """Return the panel as several pictures teach it, None where none is accepted."""
    views: list[tuple[Scene, GridFit, Array]] = []
    for _ in range(_VIEWS):
        view = Viewpoint(rng.uniform(0.0, 0.7), rng.uniform(0.0, 6.28), rng.normal(0.0, 0.03), 0.85)
        scene = make_scene(panel, paper_camera(), view, DetectorModel(1.0, 0.03), rng)
        image = photograph(scene, rng, random_taking(rng))
        views.append((scene, fit_panel(list(scene.detections), scene.camera, _CONFIG, image=image), image))
    accepted = sorted((v for v in views if v[1].ok), key=lambda v: -v[1].inliers)
    if not accepted:
        return None
    first = taught(View(accepted[0][1], accepted[0][0].camera), "rendered")
    again = [
        View(fit_panel(list(scene.detections), scene.camera, _CONFIG, image=image, known=first), scene.camera)
        for scene, _, image in accepted[1:]
    ]
    return joined(first, [view for view in again if view.fit.ok])


def _true_button(known: KnownPanel, panel: Panel) -> Array:
    """Return the true button (K,) of each taught one by its label, -1 for none."""
    labels = [b.label for b in panel.buttons]
    return np.array([labels.index(label) if label in labels else -1 for label in known.labels])


def _judged(fit: GridFit, scene: Scene, true: Array) -> Fitted:
    if not fit.ok:
        return Fitted(False, np.inf, np.zeros(0), False, False)
    turn = rotation_angle_rad(fit.R_camera_panel.T @ scene.R_camera_panel)
    place = {b.detection: b.point for b in fit.buttons if b.detection >= 0}
    mine = [k for k in place if scene.button[k] >= 0]
    at = scene.panel.placed_m[scene.button[mine]] @ scene.R_camera_panel.T + scene.t_camera_panel
    across = (np.array([place[k] for k in mine]).reshape(-1, 3) - at) @ scene.R_camera_panel[:, :2]
    lateral = 1e3 * np.linalg.norm(across, axis=1) * _AWAY_M / at[:, 2]
    wrong = False
    if fit.known is not None:
        on = (fit.matched >= 0) & (scene.button >= 0)
        named = true[fit.matched[on]]
        wrong = bool(((named >= 0) & (named != scene.button[on])).any())
    return Fitted(True, float(np.rad2deg(turn)), lateral, bool(mine) and _within(fit, scene, mine), wrong)


def _within(fit: GridFit, scene: Scene, mine: list[int]) -> bool:
    """Tell whether the middle button's place across the normal lies in its 95 % region."""
    button = next(b for b in fit.buttons if b.detection == mine[len(mine) // 2])
    axes = fit.R_camera_panel[:, :2]
    at = scene.panel.placed_m[scene.button[button.detection]] @ scene.R_camera_panel.T + scene.t_camera_panel
    off = (at - button.point) @ axes
    return bool(off @ np.linalg.solve(axes.T @ button.covariance @ axes, off) < 5.991)


def known_rendered_table(levels: list[str], trials: int, seed: int, figures: Figures) -> str:
    """Return the table of held-out looks."""
    lines = [
        f"rendered panels, taught from {_VIEWS} pictures each",
        f"{'level':<8}{'':<8}{'panels':>7}{'accepted':>9}{'med deg':>8}{'p95':>7}{'lateral mm':>11}{'p95':>7}"
        f"{'cover':>7}{'wrong':>6}",
    ]
    for level in levels:
        results = [r for r in parallel(run_scene, [(level, seed, n) for n in range(trials)], f"{level} taught") if r]
        for k, name in enumerate(("free", "taught")):
            fits = [r[k] for r in results]
            accepted = [f for f in fits if f.accepted]
            lateral = np.concatenate([f.lateral_mm for f in accepted])
            error = np.array([f.error_deg for f in accepted])
            figures.rate(f"{level} {name} panel accepted+", [f.accepted for f in fits])
            figures.median(f"{level} {name} panel lateral mm-", lateral)
            lines.append(
                f"{level:<8}{name:<8}{len(fits):>7}{len(accepted) / max(1, len(fits)):>9.3f}{np.median(error):>8.2f}"
                f"{np.percentile(error, 95):>7.2f}{np.median(lateral):>11.2f}{np.percentile(lateral, 95):>7.2f}"
                f"{np.mean([f.covered for f in accepted]):>7.3f}{sum(f.wrong for f in fits):>6}"
            )
    return "\n".join(lines)
