"""From frame to frame: what comes into view, what leaves, what is too old, and one state that is smoothed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.pictures import pictured
from elevator_rectify.benchmark.sequences import KINDS, run_sequence, scenes, sequence_table
from elevator_rectify.core import Config, Detection, ScaleConfig, fit_panel
from elevator_rectify.core.attempts import grew
from elevator_rectify.core.config import SmoothingConfig
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.result import sideways_std
from elevator_rectify.core.track import Track, recent, shape_of, shaped, smoothed
from elevator_rectify.core.types import Array
from elevator_rectify.render.levels import LEVELS, random_scene

SECOND = 1_000_000_000


def grid_detections(fit: GridFit, rows: slice, extra: Array | None = None) -> list[Detection]:
    centres = fit.grid_px[rows].reshape(-1, 2)
    centres = centres if extra is None else np.concatenate([centres, extra])
    return [Detection(float(x), float(y), 20.0, 20.0) for x, y in centres]


def full_grid(level: str = "easy") -> tuple[GridFit, Camera]:
    """Return an accepted fit of at least five rows."""
    for number in range(40):
        view = random_scene(LEVELS[level], 3, number)
        fit = fit_panel(view.centres_px, view.camera)
        if fit.ok and fit.rows >= 5 and (level != "gaps" or fit.row_block[-1] > 0):
            return fit, view.camera
    raise AssertionError("no such panel")


def test_rows_that_come_into_view_are_added() -> None:
    fit, camera = full_grid()
    part = fit_panel(grid_detections(fit, slice(1, None)), camera)
    assert part.ok and part.rows == fit.rows - 1
    whole = fit_panel(grid_detections(fit, slice(0, None)), camera, previous=part)
    assert whole.ok and whole.rows == fit.rows and (whole.cells >= 0).all()


def test_a_row_that_was_missed_between_others_is_searched_for() -> None:
    """A track that began badly, with a gap where a row is, would stay so for as long as it explains the other rows."""
    fit, _ = full_grid()
    missed = fit.rows // 2
    of_it = fit.cells[:, 0] == missed
    cells = np.where(of_it[:, None], -1, fit.cells - np.outer(fit.cells[:, 0] > missed, [1, 0]))
    begun = replace(fit, cells=cells, row_positions=np.delete(fit.row_positions, missed), rows=fit.rows - 1)
    begun = replace(begun, inliers=int((~of_it).sum()))
    before = replace(begun, cells=cells[~of_it], rays=fit.rays[~of_it])
    one = ~of_it | (np.arange(len(cells)) == np.flatnonzero(of_it)[0])
    now = replace(begun, cells=cells[one], rays=fit.rays[one])
    # Once is enough.
    assert grew(now, before) and not grew(now, now)


def test_a_stray_detection_is_searched_for_a_row_once() -> None:
    """A search in every frame would take five times a tracked frame's time for as long as the stray stays."""
    fit, camera = full_grid()
    below = 2.0 * fit.grid_px[-1] - fit.grid_px[-2]

    def with_stray(centre_px: Array) -> GridFit:
        ray = camera.rays(centre_px[None])
        return replace(fit, cells=np.vstack([fit.cells, [[-1, -1]]]), rays=np.vstack([fit.rays, ray]))

    first, second = with_stray(below[0]), with_stray(below[1])
    assert grew(first, fit) and grew(second, first)
    assert not grew(first, first) and not grew(fit, first)


def test_a_block_that_is_seen_no_more_is_forgotten() -> None:
    """Its place cannot be known without its buttons; as the origin it would take the whole pose with it."""
    fit, camera = full_grid("gaps")
    first = int(np.flatnonzero(fit.row_block > 0)[0])
    before = fit_panel(grid_detections(fit, slice(0, None)), camera)
    after = fit_panel(grid_detections(fit, slice(0, first)), camera, previous=before)
    assert before.ok and before.rows == fit.rows
    assert after.ok and after.rows == first and sideways_std(after) < 0.1


def test_an_old_fit_and_one_of_the_future_start_nothing() -> None:
    fit, _ = full_grid()
    track = Track(fit, fit.R_camera_panel, fit.t_camera_panel, shape_of(fit), fit.shape_covariance, 100 * SECOND)
    config = SmoothingConfig(max_gap_s=1.0)
    assert recent(track, 101 * SECOND, config) is fit
    assert recent(track, 101 * SECOND + 1, config) is None
    assert recent(track, 99 * SECOND, config) is None and recent(None, 0, config) is None


def test_a_frame_from_before_a_clock_jump_does_not_freeze_the_track() -> None:
    fit, camera = full_grid()
    track, _ = smoothed(None, fit, camera, 5000 * SECOND, SmoothingConfig())
    late, _ = smoothed(track, fit, camera, 10 * SECOND, SmoothingConfig())
    assert late is not None and late.stamp_ns == 10 * SECOND


@pytest.mark.parametrize("level", ["easy", "gaps"])
def test_aspect_and_gaps_are_put_back_as_they_were_taken(level: str) -> None:
    fit, _ = full_grid(level)
    shape = shape_of(fit)
    same = shaped(fit, shape)
    np.testing.assert_allclose(same.grid_panel, fit.grid_panel, atol=1e-12)
    other = shaped(fit, shape + 0.03)
    np.testing.assert_allclose(shape_of(other), shape + 0.03, atol=1e-9)
    assert len(shape) == 1 + int(fit.row_block[-1]) + int(fit.column_block[-1])


def test_smoothing_makes_the_buttons_places_better_not_worse() -> None:
    """Pose and aspect belong together: smoothed apart, buttons far from the origin move sideways."""
    alone, tracked = [], []
    for number in range(3):
        one, other = run_sequence(("steady", 17, number))
        alone += [f.lateral_pitch for f in one if f.accepted]
        tracked += [f.lateral_pitch for f in other if f.accepted]
    assert np.percentile(tracked, 95) < np.percentile(alone, 95)


@pytest.mark.parametrize("kind", ["rows come into view", "another panel", "clock goes back"])
def test_tracking_publishes_no_more_wrong_poses_than_single_frames(kind: str) -> None:
    alone, tracked = run_sequence((kind, 23, 1))
    assert sum(f.wrong for f in tracked) <= sum(f.wrong for f in alone)
    assert sum(f.accepted for f in tracked) >= 0.9 * sum(f.accepted for f in alone)


def test_camera_paths_are_deterministic_and_tabulated() -> None:
    one, other = (list(scenes("jump", 5, 2)) for _ in range(2))
    assert [s for s, _ in one] == [s for s, _ in other]
    np.testing.assert_array_equal(one[-1][1].centres_px, other[-1][1].centres_px)
    figures = Figures()
    table = sequence_table(1, 5, figures, ["jump"])
    assert "jump" in table and "camera paths, jump, tracked wrong-" in figures.table
    assert all(len(list(KINDS[kind](np.random.default_rng(0)))) == 60 for kind in KINDS)


def test_the_place_of_every_button_is_known_as_well_as_it_says() -> None:
    """In three dimensions, with picture, on draws that nothing was fitted on; 95 % regions of some 400 buttons that
    share their panels' errors."""
    inside = []
    for number in range(12):
        given = pictured("medium", 9001, number, held_out=True)
        pitch = float(given.scene.panel.pitch_m[0])
        config = replace(Config(), scale=ScaleConfig(pitch, 0.0))
        fit = fit_panel(given.scene.detections, given.scene.camera, config, image=given.image)
        points = given.scene.panel.points_m @ given.scene.R_camera_panel.T + given.scene.t_camera_panel
        for button in fit.buttons if fit.ok else ():
            if button.detection >= 0 and given.scene.button[button.detection] >= 0 and button.row >= 0:
                error = points[given.scene.button[button.detection]] - button.point
                inside.append(error @ np.linalg.solve(button.covariance, error) < 7.815)
    assert len(inside) > 100 and np.mean(inside) > 0.85
