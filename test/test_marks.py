"""A mark beside every button must not double the grid."""

from __future__ import annotations

import numpy as np
import pytest

from elevator_rectify.benchmark.pictures import pictured
from elevator_rectify.core import Detection, fit_panel, pipeline
from elevator_rectify.core.lattice.marks import second_lines
from elevator_rectify.render.scene import Scene

PANELS = range(6)


def marked(scene: Scene, share: float, rng: np.random.Generator) -> list[Detection]:
    """Return the detections with a box half a pitch beside every button, of a share of its size."""
    real = scene.button >= 0
    places = scene.panel.placed_m[scene.button[real]] + [0.47 * scene.panel.pitch_m[0], 0.0, 0.0]
    seen = scene.camera.project(places @ scene.R_camera_panel.T + scene.t_camera_panel)
    buttons = [d for d, k in zip(scene.detections, real, strict=True) if k]
    beside = [
        Detection(x, y, share * d.width_px, share * d.height_px)
        for (x, y), d in zip((seen + rng.normal(0, 1, seen.shape)).tolist(), buttons, strict=True)
    ]
    return [*scene.detections, *beside]


@pytest.mark.parametrize("number", PANELS)
def test_small_marks_are_no_cells_and_the_pitch_is_the_buttons(number: int) -> None:
    scene = pictured("easy", 9009, number, picture=False).scene
    plain = fit_panel(list(scene.detections), scene.camera)
    fit = fit_panel(marked(scene, 0.5, np.random.default_rng(number)), scene.camera)
    assert plain.ok and fit.ok and fit.columns == plain.columns
    assert (fit.cells[len(scene.detections) :] == -1).all()


@pytest.mark.parametrize("number", PANELS)
def test_marks_of_nearly_the_buttons_size_may_be_the_buttons(number: int) -> None:
    scene = pictured("easy", 9009, number, picture=False).scene
    fit = fit_panel(marked(scene, 0.68, np.random.default_rng(number)), scene.camera)
    assert fit.status == "ambiguous" and "every second line" in fit.reason


def test_marks_stay_marks_while_the_panel_is_tracked(monkeypatch: pytest.MonkeyPatch) -> None:
    for number in PANELS:
        scene, previous = pictured("easy", 9009, number, picture=False).scene, None
        frames = [marked(scene, 0.5, np.random.default_rng(k)) for k in range(4)]
        first = fit_panel(frames[0], scene.camera)
        monkeypatch.setattr(pipeline, "best_attempt", None)
        fits = [previous := fit_panel(frame, scene.camera, previous=previous or first) for frame in frames[1:]]
        monkeypatch.undo()
        assert all(fit.ok and (fit.rows, fit.columns) == (first.rows, first.columns) for fit in fits)
        assert all((fit.cells[len(scene.detections) :] == -1).all() for fit in fits)


def test_buttons_of_one_size_have_no_second_lines() -> None:
    for number in PANELS:
        scene = pictured("easy", 9009, number, picture=False).scene
        fit = fit_panel(list(scene.detections), scene.camera)
        sizes = np.log([np.sqrt(d.width_px * d.height_px) for d in scene.detections])
        assert second_lines(fit, np.arange(len(sizes)), sizes)[1] == 0.0
