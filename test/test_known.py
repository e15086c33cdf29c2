"""Panels that were taught: their pose, which button is which, and that another panel is noticed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from rclpy.parameter import Parameter

from elevator_rectify.benchmark.pictures import pictured
from elevator_rectify.core import Config, Detection, GridFit, PanelConfig, find_button, fit_panel
from elevator_rectify.core.config import with_values
from elevator_rectify.core.find import with_labels
from elevator_rectify.core.geometry.rotations import rotation, rotation_angle_rad
from elevator_rectify.core.known.file import panel_text, read_panel_file
from elevator_rectify.core.known.hypotheses import corners_of
from elevator_rectify.core.known.teach import View, joined, taught
from elevator_rectify.recordings import teach
from elevator_rectify.render.looks import random_taking
from elevator_rectify.render.panel import Panel, regular_panel, with_gap
from elevator_rectify.render.photograph import photograph
from elevator_rectify.render.scene import DetectorModel, Scene, Viewpoint, make_scene, paper_camera
from elevator_rectify.ros.answer import answer_frame
from elevator_rectify.ros.messages import make_ros
from elevator_rectify.ros.output import output_messages
from elevator_rectify.ros.pairing import Frame
from elevator_rectify.ros.parameters import changed
from test.messages import camera_info, detections, image
from test.scenes import known_of, rotation_error_deg

PANEL = regular_panel(6, 3, 0.05)
IRREGULAR = with_gap(regular_panel(5, 3, 0.05), 0.4, ("open", "close"))


def seen(panel: Panel, seed: int, fill: float = 0.7, sigma_px: float = 1.0, **faults: float) -> Scene:
    rng = np.random.default_rng(seed)
    view = Viewpoint(rng.uniform(0.0, 0.8), rng.uniform(0.0, 6.28), rng.uniform(-0.1, 0.1), fill)
    return make_scene(panel, paper_camera(), view, DetectorModel(sigma_px, **faults), rng)


def bare(found: tuple[Detection, ...]) -> list[Detection]:
    return [replace(d, label="") for d in found]


def right(fit: GridFit, scene: Scene) -> bool:
    """Whether every detection is taken for the button that it is; panels of `known_of` have the scene's order."""
    on = (fit.matched >= 0) & (scene.button >= 0)
    return bool(on.any() and (fit.matched[on] == scene.button[on]).all())


@pytest.mark.parametrize("panel", [PANEL, IRREGULAR], ids=["regular", "irregular"])
@pytest.mark.parametrize("seed", range(4))
def test_without_noise_the_pose_is_exact_and_metric(panel: Panel, seed: int) -> None:
    scene = seen(panel, seed, sigma_px=0.0)
    fit = fit_panel(list(scene.detections), scene.camera, known=known_of(panel))
    assert fit.ok and fit.metric and right(fit, scene), fit.reason
    # A thousandth of a pixel over the panel's width; the pose's prior on the tilt is not 0.
    assert rotation_error_deg(fit.R_camera_panel, scene.R_camera_panel) < 1e-3
    assert np.linalg.norm(fit.t_camera_panel - scene.t_camera_panel) < 1e-5 * np.linalg.norm(scene.t_camera_panel)


def test_the_order_of_the_detections_does_not_matter() -> None:
    scene = seen(IRREGULAR, 3, missed=0.1, false=0.1)
    known, order = known_of(IRREGULAR), np.random.default_rng(1).permutation(len(scene.detections))
    one = fit_panel(list(scene.detections), scene.camera, known=known)
    other = fit_panel([scene.detections[k] for k in order], scene.camera, known=known)
    assert one.ok and other.ok
    np.testing.assert_array_equal(one.matched[order], other.matched)
    np.testing.assert_allclose(one.t_camera_panel, other.t_camera_panel, atol=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_a_part_of_the_panel_is_right_or_refused_and_four_labelled_buttons_are_enough(seed: int) -> None:
    scene = seen(PANEL, 40 + seed)
    rng = np.random.default_rng(seed)
    row, column = rng.integers(0, 5), rng.integers(0, 2)
    near = [
        k
        for k, b in enumerate(scene.button)
        if 0 <= PANEL.cells[b][0] - row < 2 and 0 <= PANEL.cells[b][1] - column < 2
    ]
    four = [scene.detections[k] for k in near]
    # The camera stands so near that nothing else is in its picture.
    low = np.min([(d.x_px - 0.7 * d.width_px, d.y_px - 0.7 * d.height_px) for d in four], axis=0).astype(int)
    high = np.max([(d.x_px + 0.7 * d.width_px, d.y_px + 0.7 * d.height_px) for d in four], axis=0).astype(int)
    K = scene.camera.matrix - np.array([[0, 0, low[0]], [0, 0, low[1]], [0, 0, 0]])
    camera = type(scene.camera).from_matrix(K, int(high[0] - low[0]), int(high[1] - low[1]))
    moved = [replace(d, x_px=d.x_px - low[0], y_px=d.y_px - low[1]) for d in four]
    wide = with_values(Config(), {"accept.max_rotation_std_rad": 3.0})
    fit = fit_panel(moved, camera, wide, known=known_of(PANEL))
    assert fit.status in ("ok", "uncertain"), fit.reason
    np.testing.assert_array_equal(fit.matched, scene.button[near])
    assert fit_panel(bare(tuple(moved)), camera, wide, known=known_of(PANEL)).status in ("ambiguous", "unknown_panel")


def test_another_panel_is_noticed() -> None:
    other = replace(PANEL, buttons=tuple(replace(b, label=str(int(b.label) + 40)) for b in PANEL.buttons))
    for panel in (other, regular_panel(3, 4, 0.04)):
        scene = seen(panel, 5)
        fit = fit_panel(list(scene.detections), scene.camera, known=known_of(PANEL))
        assert fit.status == "unknown_panel" and "'lobby'" in fit.reason


def test_a_shifted_label_is_outvoted_and_a_shifted_panel_is_not() -> None:
    scene = seen(PANEL, 6)
    wrong = [replace(d, label="9") if k == 0 else d for k, d in enumerate(scene.detections)]
    fit = fit_panel(wrong, scene.camera, known=known_of(PANEL))
    assert fit.ok and right(fit, scene)
    # All labels one row off: the places and the readings contradict each other.
    shifted = [replace(d, label=str(int(d.label) + 3)) for d in scene.detections]
    assert not fit_panel(shifted, scene.camera, known=known_of(PANEL)).ok


def test_the_covariance_says_how_far_the_pose_is_off() -> None:
    distance2 = []
    for seed in range(60):
        scene = seen(PANEL, 100 + seed, missed=0.1)
        fit = fit_panel(list(scene.detections), scene.camera, known=known_of(PANEL))
        assert fit.ok and right(fit, scene)
        turn = cv2.Rodrigues(scene.R_camera_panel @ fit.R_camera_panel.T)[0].ravel()
        error = np.concatenate([scene.t_camera_panel - fit.t_camera_panel, turn])
        distance2.append(error @ np.linalg.solve(fit.covariance, error))
    # 95 % of a chi-squared variable of six are below 12.59; of 60 draws 51 to 60 are so in 999 of 1,000 cases.
    assert (np.array(distance2) < 12.59).sum() >= 51
    # Boxes are taken to be known to 1 px or 6 % of their size at best: these are better, not ten times so.
    assert np.median(distance2) > 0.5


def test_a_turned_camera_is_known_by_its_parameter() -> None:
    scene = seen(PANEL, 8)
    turn = rotation(np.array([0.0, 0.0, np.pi / 2]))
    width, height = scene.camera.width, scene.camera.height
    camera = type(scene.camera).from_matrix([[320, 0, height - 1 - 240], [0, 320, 320], [0, 0, 1]], height, width)
    moved = [
        replace(d, x_px=height - 1 - d.y_px, y_px=d.x_px, width_px=d.height_px, height_px=d.width_px)
        for d in scene.detections
    ]
    config = with_values(Config(), {"joint.camera_roll_rad": np.pi / 2})
    fit = fit_panel(moved, camera, config, known=known_of(PANEL))
    assert fit.ok and right(fit, scene)
    assert rotation_angle_rad(fit.R_camera_panel.T @ turn @ scene.R_camera_panel) < np.deg2rad(3.0)


def test_a_button_is_pressed_by_its_taught_label_and_refused_where_it_is_hidden() -> None:
    scene = seen(IRREGULAR, 9)
    known = known_of(IRREGULAR)
    fit = fit_panel(bare(scene.detections), scene.camera, known=known)
    choice = find_button(fit, "open")
    assert choice.status == "found" and choice.button is not None and choice.button.label_source == "taught"
    at = scene.panel.points_m[15] @ scene.R_camera_panel.T + scene.t_camera_panel
    assert np.linalg.norm(choice.button.point - at) < 0.01
    assert find_button(fit, "77").status == "unknown_label"
    hidden = [d for d, b in zip(bare(scene.detections), scene.button, strict=True) if b not in (15, 7)]
    for name in ("open", IRREGULAR.buttons[7].label):
        choice = find_button(fit_panel(hidden, scene.camera, known=known), name)
        assert choice.status == "occluded" and name in choice.reason
    pairs = zip(scene.detections, scene.button, strict=True)
    read = [replace(d, label="close", score=0.99) if b == 15 else d for d, b in pairs]
    assert find_button(fit_panel(read, scene.camera, known=known), "open").status == "unsure_label"


def test_cells_without_a_button_stay_empty() -> None:
    known = known_of(PANEL)
    kept = [k for k in range(18) if k not in (4, 10)]
    fewer = replace(
        known,
        labels=tuple(known.labels[k] for k in kept),
        places=known.places[kept],
        sizes=known.sizes[kept],
        cells=known.cells[kept],
    )
    scene = seen(replace(PANEL, buttons=tuple(PANEL.buttons[k] for k in kept)), 10)
    fit = fit_panel(list(scene.detections), scene.camera, known=fewer)
    assert fit.ok and [b.state for b in fit.buttons].count("empty") == 2
    assert {b.label for b in fit.buttons} - {""} == set(fewer.labels)


def test_a_panel_is_taught_by_a_picture_and_better_by_several() -> None:
    rng = np.random.default_rng(21)
    offsets = tuple((float(x), float(y)) for x, y in rng.normal(0.0, 0.0004, (18, 2)))
    panel, config = replace(PANEL, offsets_m=offsets), with_values(Config(), {"scale.column_pitch_m": 0.045})
    pictures = []
    for k in range(6):
        scene = make_scene(panel, paper_camera(), Viewpoint(0.1 * k, float(k), 0.0, 0.9), DetectorModel(1.0), rng)
        pictures.append((scene, photograph(scene, rng, random_taking(rng))))
    scene, picture = pictures[0]
    first = taught(View(fit_panel(list(scene.detections), scene.camera, config, image=picture), scene.camera), "it")
    views = []
    for scene, picture in pictures[1:]:
        fit = fit_panel(list(scene.detections), scene.camera, config, image=picture, known=first)
        assert fit.ok, fit.reason
        views.append(View(fit, scene.camera))
    several = joined(first, views)
    true = panel.placed_m[:, :2]
    errors = []
    for known in (first, several):
        lines = np.column_stack([known.places, np.ones(18)])
        errors.append(float(np.abs(lines @ np.linalg.lstsq(lines, true, rcond=None)[0] - true).mean()))
    assert errors[1] < 0.8 * errors[0] and several.labels == first.labels
    assert several.place_std > 0.0 and several.log_aspect_std < first.log_aspect_std


def test_label_plates_are_taught_without_a_name() -> None:
    """Four columns, the first and the third of them plates that are read as the buttons to their right."""
    views = []
    for seed in (1, 2):
        scene = seen(regular_panel(6, 4, 0.05), seed, sigma_px=0.3)
        read = [str(2 + b // 4 * 2 + b % 4 // 2) for b in scene.button.tolist()]
        given = [replace(d, label=label, score=0.9) for d, label in zip(scene.detections, read, strict=True)]
        views.append((given, scene.camera))
    known = taught(View(fit_panel(views[0][0], views[0][1]), views[0][1]), "plates")
    fits = [View(fit_panel(given, camera, known=known), camera) for given, camera in views]
    assert all(view.fit.ok for view in fits)
    labels = dict(zip(map(tuple, known.cells.tolist()), joined(known, fits).labels, strict=True))
    assert all((labels[row, column] == "") == (column % 2 == 0) for row, column in labels)


def test_a_single_column_teaches_nothing() -> None:
    scene = seen(PANEL, 3)
    fit = fit_panel(scene.detections, scene.camera)
    with pytest.raises(ValueError, match="one row or one column"):
        taught(View(replace(fit, columns=1), scene.camera), "column")


def test_a_refused_fit_teaches_nothing() -> None:
    with pytest.raises(ValueError, match="accepted fit"):
        taught(View(GridFit(status="no_lattice", reason="none"), paper_camera()), "x")


def test_the_file_holds_the_panel(tmp_path: Path) -> None:
    known = replace(known_of(IRREGULAR, "it's"), place_std=0.0002, log_aspect_std=0.001, scale_std_share=0.01)
    path = tmp_path / "panel.yaml"
    path.write_text(panel_text(known), encoding="utf-8")
    again = read_panel_file(path)
    assert (again.name, again.labels, again.metric) == (known.name, known.labels, known.metric)
    for name in ("places", "sizes", "cells", "pitch", "row_positions", "row_block", "place_std", "scale_std_share"):
        np.testing.assert_allclose(getattr(again, name), getattr(known, name), rtol=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("unit: m", "unit: inch", "'unit' must be one of m, column pitch, not 'inch'"),
        ("pitch: [0.045", "pitch: [-0.045", "'pitch' must be above 0"),
        ("at: [0,", "at: [nan,", "'at' must be numbers"),
        ("row: 0", "row: 90", "outside of the 6 rows"),
        ("row: 0, column: 0", "row: -1, column: 0", "must both be -1"),
        ("buttons:", "knobs:", "'buttons' is missing"),
        ("place_std: 0", "place_std: -1", "'place_std' must be 0 or more"),
        ("panel: 'lobby'", "panel: [", "cannot be read"),
    ],
)
def test_a_wrong_file_is_refused_with_its_name_and_field(tmp_path: Path, old: str, new: str, said: str) -> None:
    text = panel_text(known_of(PANEL))
    assert old in text
    path = tmp_path / "wrong.yaml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ValueError, match=r"wrong\.yaml") as error:
        read_panel_file(path)
    assert said in str(error.value)


def test_a_file_that_cannot_be_read_is_refused_while_the_node_runs() -> None:
    config, result = changed(Config(), [Parameter("panel.file", value="/nowhere.yaml")])
    assert not result.successful and "cannot be read" in result.reason and config == Config()


def test_a_missing_file_is_refused() -> None:
    with pytest.raises(ValueError, match="cannot be read"):
        fit_panel(np.zeros((0, 2)), paper_camera(), Config(panel=PanelConfig(file="/nowhere/panel.yaml")))


def test_frames_follow_the_taught_panel_and_say_so(tmp_path: Path) -> None:
    path = tmp_path / "lobby.yaml"
    path.write_text(panel_text(known_of(PANEL)))
    config, track = Config(panel=PanelConfig(file=str(path))), None
    for stamp in range(1, 4):
        scene = seen(PANEL, 301)
        given = Frame(image(stamp), camera_info(stamp), detections(stamp, scene.centres_px))
        answer, track = answer_frame(given, config, track=track)
        assert answer.fit.ok and answer.scale == "taught panel", answer.fit.reason
        assert np.linalg.norm(answer.fit.t_camera_panel - scene.t_camera_panel) < 0.02
    message = dict(output_messages(answer, make_ros, lambda topic: topic == "status"))["status"]
    assert {v.key: v.value for v in message.values}["panel"] == "lobby"


def test_the_picture_makes_the_pose_more_exact_and_reads_what_is_needed() -> None:
    errors = []
    for number in range(4):
        given = pictured("easy", 71, number, held_out=True)
        config = with_values(Config(), {"scale.column_pitch_m": given.scene.panel.pitch_m[0]})
        first = fit_panel(list(given.scene.detections), given.scene.camera, config, image=given.image)
        if not first.ok:
            continue
        known = taught(View(first, given.scene.camera), "it")
        rng = np.random.default_rng(number)
        scene = make_scene(
            given.scene.panel, paper_camera(), Viewpoint(0.5, 1.0, 0.0, 0.8), DetectorModel(1.5, 0.1), rng
        )
        picture = photograph(scene, rng, random_taking(rng))
        fits = [fit_panel(list(scene.detections), scene.camera, config, image=i, known=known) for i in (None, picture)]
        assert all(f.ok for f in fits) and fits[1].measurement is not None
        errors.append([rotation_error_deg(f.R_camera_panel, scene.R_camera_panel) for f in fits])
        unread = fit_panel(bare(scene.detections), scene.camera, config, image=picture, known=known)
        assert unread.ok and with_labels(unread, picture, scene.camera) is unread
    boxes, both = np.array(errors).T
    assert len(errors) >= 2 and both.mean() < 0.5 * boxes.mean()


def test_corners_do_not_depend_on_the_order_of_points() -> None:
    points = np.random.default_rng(3).uniform(0, 5, (12, 2))
    order = np.random.default_rng(4).permutation(12)
    one = {tuple(sorted(map(tuple, points[c]))) for c in corners_of(points, 5).index}
    other = {tuple(sorted(map(tuple, points[order][c]))) for c in corners_of(points[order], 5).index}
    assert one == other and len(one) > 20


def test_photographs_teach_a_panel_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(11)
    paths = []
    for k in range(2):
        scene = make_scene(PANEL, paper_camera(), Viewpoint(0.2 * k, 0.5, 0.0, 0.9), DetectorModel(), rng)
        paths.append(str(tmp_path / f"{k}.png"))
        cv2.imwrite(paths[-1], photograph(scene, rng))
    output = tmp_path / "hall.yaml"
    options = ["--focal-px", "320", "--pitch-m", "0.045", "-o", str(output)]
    assert teach.main([*paths, *options]) == 0
    assert f"panel.file:={output}" in capsys.readouterr().out
    known = read_panel_file(output)
    assert known.name == "hall" and known.metric and len(known.labels) == 18
    # 1 mm of 250 mm; the pitch's own error is not the picture's.
    assert np.abs(known.places - known.places[0] - (PANEL.points_m - PANEL.points_m[0])[:, :2]).max() < 2e-3
    grey = tmp_path / "grey.png"
    cv2.imwrite(str(grey), np.full((480, 640), 128, np.uint8))
    assert teach.main([str(grey), "--focal-px", "320", "-o", str(tmp_path / "no.yaml")]) == 1
    assert teach.main([str(output), "--focal-px", "320"]) == 2
    assert not (tmp_path / "no.yaml").exists()
