"""Labels, buttons, and the choice of the one that is to be pressed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elevator_rectify.core import Config, Detection, GridFit, find_button, fit_panel, fit_panels
from elevator_rectify.core.config import LabelsConfig, ScaleConfig, TargetConfig
from elevator_rectify.core.reading.labels import aliases, canonical
from elevator_rectify.core.reading.target import lateral_std
from elevator_rectify.core.types import Array
from elevator_rectify.render.panel import PITCH_M
from test.scenes import scene

METRIC = replace(Config(), scale=ScaleConfig(PITCH_M, 0.001))
VIEW = scene(1, rows=6, columns=3, tilt_deg=20.0, sigma_px=0.3)


def labelled(labels: dict[int, str], scores: dict[int, float] | None = None) -> list[Detection]:
    """The view's detections, with the labels of some buttons of the panel replaced."""
    given = []
    for detection, button in zip(VIEW.detections, VIEW.button, strict=True):
        label = labels.get(int(button), detection.label)
        given.append(replace(detection, label=label, score=(scores or {}).get(int(button), 0.9)))
    return given


def fitted(labels: dict[int, str], scores: dict[int, float] | None = None) -> GridFit:
    return fit_panel(labelled(labels, scores), VIEW.camera, METRIC)


@pytest.mark.parametrize(
    ("text", "label"),
    [
        ("7", "7"),
        (" 07 ", "7"),
        ("*1", "1"),
        ("*", "*"),
        ("-2", "-2"),
        ("-0", "0"),
        ("b1", "B1"),
        ("<|>", "open"),
        ("Door  Open", "open"),
        (">|<", "close"),
        ("\uff17", "7"),
        ("\x00\n", ""),
        ("", ""),
    ],
)
def test_spellings_become_one(text: str, label: str) -> None:
    assert canonical(text) == label


def test_no_spelling_has_two_meanings_and_every_label_spells_itself() -> None:
    table = aliases()
    assert len(table) > 40 and all(canonical(name) == name for name in table.values())


@settings(max_examples=300, deadline=None)
@given(text=st.text(max_size=300))
def test_any_text_has_a_label_that_is_its_own_label(text: str) -> None:
    label = canonical(text)
    assert len(label) <= 96 and label.isprintable() and canonical(label) == label


@pytest.mark.parametrize(
    ("text", "words"),
    [('{"open": ["a"],\n "close": [}', "line 2"), ("[]", "an object"), ('{"open": "a"}', "an object")],
)
def test_a_broken_file_of_spellings_is_told_with_its_line(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "labels.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=words):
        aliases(path)


def test_buttons_lie_where_they_are_on_the_panel() -> None:
    fit = fitted({})
    assert len(fit.buttons) == len(VIEW.detections)
    for button in fit.buttons:
        true = int(VIEW.button[button.detection])
        place = VIEW.R_camera_panel @ VIEW.panel.points_m[true] + VIEW.t_camera_panel
        # Scale known to 1 mm of 45, and 0.3 px of noise.
        assert np.linalg.norm(button.point - place) < 0.03 * np.linalg.norm(place)
        assert button.label == VIEW.panel.buttons[true].label and button.normal @ button.point < 0
        assert np.linalg.eigvalsh(button.covariance)[0] > 0
        assert 0.2 * PITCH_M < button.size[0] < 1.2 * PITCH_M


def test_a_label_that_is_read_once_is_found() -> None:
    fit = fitted({})
    choice = find_button(fit, " 07 ")
    assert choice.status == "found" and choice.button is not None and choice.button.label == "7"
    assert lateral_std(fit, choice.button) < 0.01


def refusals() -> Sequence[tuple[str, GridFit, str]]:
    plain = fitted({})
    return [
        ("", plain, "empty_target"),
        ("\x01\x02", plain, "empty_target"),
        ("99", plain, "unknown_label"),
        ("open", plain, "unknown_label"),
        ("X", fitted({k: "X" if k < 2 else chr(65 + k) for k in range(18)}), "two_candidates"),
        ("7", fitted({}, {int(k): 0.3 for k in range(18)}), "low_score"),
        ("7", fitted({}, {int(k): float("nan") for k in range(18)}), "no_panel"),
        ("7", fit_panel(labelled({}), VIEW.camera), "unknown_scale"),
        ("7", replace(plain, status="ambiguous"), "no_panel"),
    ]


@pytest.mark.parametrize("number", range(9))
def test_what_is_not_certain_is_refused_with_its_reason(number: int) -> None:
    target, fit, status = refusals()[number]
    choice = find_button(fit, target)
    assert choice.button is None and choice.status == status and choice.reason


def test_a_place_that_is_not_known_well_enough_is_refused() -> None:
    choice = find_button(fitted({}), "7", TargetConfig(max_lateral_std_m=1e-5))
    assert choice.status == "uncertain" and "sideways" in choice.reason


def plated(swapped: int = 0, readings: bool = False) -> list[Detection]:
    """A panel of two columns of plates, each with its buttons to the right: both are read; of so many the button as
    another one."""
    view, given = scene(1, rows=6, columns=4, tilt_deg=20.0, sigma_px=0.3), []
    for detection, button in zip(view.detections, view.button, strict=True):
        row, column = divmod(int(button), 4)
        floor = 12 - 2 * row + column // 2
        read = str(floor + 1 if column % 2 and floor <= swapped else floor)
        soft = ((read, 0.9),) if read == str(floor) else ((read, 0.6), (str(floor), 0.2))
        given.append(replace(detection, label=read, score=0.9, readings=soft if readings else ()))
    return given


@pytest.mark.parametrize("readings", [False, True])
def test_of_a_plate_and_its_button_the_button_is_pressed(readings: bool) -> None:
    view = scene(1, rows=6, columns=4, tilt_deg=20.0, sigma_px=0.3)
    fit = fit_panel(plated(readings=readings), view.camera, METRIC)
    for floor in range(2, 14):
        choice = find_button(fit, str(floor))
        assert choice.button is not None and choice.button.column % 2 == 1, (floor, choice.reason)
        assert choice.button.row == (12 - floor + floor % 2) // 2
    assert {b.label for b in fit.buttons if b.column % 2 == 0} == {"plate"}


def test_a_misread_button_is_named_by_its_plate_too() -> None:
    view = scene(1, rows=6, columns=4, tilt_deg=20.0, sigma_px=0.3)
    fit = fit_panel(plated(swapped=2, readings=True), view.camera, METRIC)
    choice = find_button(fit, "2")
    assert choice.button is not None and (choice.button.row, choice.button.column) == (5, 1)


def printed_left(blank: Sequence[int], score: float = 0.97, config: Config = METRIC, readings: bool = True) -> GridFit:
    """The fit to a panel of two columns of plates, each with its buttons to the right, of which those in the given rows
    show no print."""
    view, given = scene(1, rows=6, columns=4, tilt_deg=20.0, sigma_px=0.3), []
    for detection, button in zip(view.detections, view.button, strict=True):
        row, column = divmod(int(button), 4)
        floor = str(12 - 2 * row + column // 2 if column % 2 == 0 else 40 - 2 * row + column // 2)
        soft = (("8", 0.2), ("open", 0.1)) if column % 2 and row in blank else ((floor, score),)
        label = soft[0][0] if soft[0][1] > 0.5 else ""
        given.append(replace(detection, label=label, score=soft[0][1], readings=soft if readings else ()))
    return fit_panel(given, view.camera, config)


def test_what_may_be_the_plate_of_a_blank_button_is_pressed_only_where_plates_are_said_to_be_left_of_theirs() -> None:
    fit = printed_left(range(6))
    choice = find_button(fit, "7")
    assert choice.button is None and choice.status == "two_candidates" and "plate" in choice.reason
    said = printed_left(range(6), config=replace(METRIC, labels=LabelsConfig(plates_on_left=True)))
    button = find_button(said, "7").button
    assert button is not None and (button.row, button.column) == (3, 3) and button.read == ""
    assert button.label == "7" and {b.label for b in said.buttons if b.column % 2 == 0} == {"plate"}


def test_buttons_beside_some_that_cannot_be_read_are_no_plates() -> None:
    """Nor are those of a detector that leaves labels out."""
    for fit in (printed_left([0, 3]), printed_left(range(6), score=0.85), printed_left(range(6), readings=False)):
        choice = find_button(fit, "7")
        assert choice.button is not None and (choice.button.row, choice.button.column) == (3, 2)


def test_floors_that_are_misread_as_their_neighbours_are_no_plates() -> None:
    """Three rows of six read alike, the others surely not."""
    view, given = scene(1, rows=6, columns=4, tilt_deg=20.0, sigma_px=0.3), []
    for detection, button in zip(view.detections, view.button, strict=True):
        row, column = divmod(int(button), 4)
        floor = 24 - 4 * row + column
        misread = row < 3 and column < 2
        soft = ((str(24 - 4 * row), 0.6), (str(floor + 9), 0.2)) if misread else ((str(floor), 0.97),)
        given.append(replace(detection, label=soft[0][0], score=soft[0][1], readings=soft))
    fit = fit_panel(given, view.camera, METRIC)
    assert fit.ok and "plate" not in {b.label for b in fit.buttons}


def test_two_pairs_are_no_plates() -> None:
    fit = fitted({0: "30", 1: "30", 3: "31", 4: "31"})
    assert "plate" not in {b.label for b in fit.buttons} and find_button(fit, "30").button is None


def test_what_may_be_the_rear_doors_button_is_no_buttons_plate() -> None:
    view = scene(1, rows=6, columns=4, tilt_deg=20.0, sigma_px=0.3)
    rear = [replace(d, readings=((d.label, 0.6), (d.label + "R", 0.3))) for d in plated()]
    assert "plate" not in {b.label for b in fit_panel(rear, view.camera, METRIC).buttons}


def test_a_second_reading_of_the_same_button_is_a_contradiction() -> None:
    """Two detectors on one button: the cell is the same, the labels are not."""
    given = labelled({})
    seven = next(d for d in given if d.label == "7")
    again = replace(seven, x_px=seven.x_px + 0.5, label="1")
    fit = fit_panel([*given, again], VIEW.camera, METRIC)
    assert find_button(fit, "7").status == "two_candidates"
    same = fit_panel([*given, replace(again, label="7")], VIEW.camera, METRIC)
    assert find_button(same, "7").status == "found"


def test_points_without_labels_have_buttons_without_labels() -> None:
    fit = fit_panel(VIEW.centres_px, VIEW.camera, METRIC)
    assert len(fit.buttons) == len(VIEW.detections) and {b.label for b in fit.buttons} == {""}
    assert find_button(fit, "7").status == "unknown_label"


@settings(max_examples=60, deadline=None)
@given(texts=st.lists(st.text(max_size=40), min_size=18, max_size=18), target=st.text(max_size=40))
def test_any_labels_and_targets_give_a_choice(texts: list[str], target: str) -> None:
    fit = replace(FITTED, detections=tuple(replace(d, label=t) for d, t in zip(FITTED.detections, texts, strict=False)))
    choice = find_button(fit, target)
    assert (choice.button is not None) == (choice.status == "found")


FITTED = fitted({})


def at_pitches(x_pitch: float, y_pitch: float) -> Array:
    """Return the point (3,) in the camera frame at a place in pitches from the view's first button."""
    place = VIEW.panel.points_m[0] + np.array([x_pitch, y_pitch, 0.0]) * np.append(VIEW.panel.pitch_m, 0.0)
    return np.asarray(VIEW.R_camera_panel @ place + VIEW.t_camera_panel)


def beside(x_pitch: float, y_pitch: float, label: str, size: float = 1.0) -> Detection:
    """Return a detection on the view's panel at a place in pitches from its first button, of a size over the usual."""
    x, y = VIEW.camera.project(at_pitches(x_pitch, y_pitch)[None])[0]
    width, height = np.median([[d.width_px, d.height_px] for d in VIEW.detections], axis=0)
    return Detection(float(x), float(y), size * float(width), size * float(height), label, 0.95)


def test_a_button_beside_the_grid_has_its_place_and_can_be_pressed() -> None:
    fit = fit_panel([*labelled({}), beside(0.55, -1.3, "open")], VIEW.camera, METRIC)
    button = fit.buttons[-1]
    assert (button.row, button.column, button.state, button.detection) == (-1, -1, "observed", 18)
    truth = at_pitches(0.55, -1.3)
    assert np.linalg.norm(button.point - truth) < 0.03 * np.linalg.norm(truth)
    # Its detection's own error counts, which the grid averages.
    other = fit.buttons[-2]
    assert np.trace(button.covariance) > np.trace(other.covariance)
    choice = find_button(fit, "door open")
    assert choice.status == "found" and choice.button is not None and choice.button.detection == 18


@pytest.mark.parametrize(("place", "size"), [((5.6, 2.0), 1.0), ((0.55, -1.3), 4.0)])
def test_what_is_far_off_or_of_another_size_is_no_button_of_the_panel(place: tuple[float, float], size: float) -> None:
    fit = fit_panel([*labelled({}), beside(*place, "open", size)], VIEW.camera, METRIC)
    assert fit.ok and all(button.row >= 0 for button in fit.buttons)
    assert find_button(fit, "open").status == "unknown_label"


def test_no_button_is_inferred_across_a_detection() -> None:
    """The cell of 8 is empty, but a detection lies between it and its neighbour's."""
    eight = next(k for k in range(18) if VIEW.panel.buttons[k].label == "8")
    row, column = VIEW.panel.cells[eight]
    left = [d for d, b in zip(labelled({}), VIEW.button, strict=True) if b != eight]
    plain = fit_panel(left, VIEW.camera, METRIC)
    assert next(b for b in plain.buttons if (b.row, b.column) == (row, column)).state == "inferred"
    fit = fit_panel([*left, beside(column + 0.3, row - 0.35, "")], VIEW.camera, METRIC)
    assert next(b for b in fit.buttons if (b.row, b.column) == (row, column)).state == "empty"


def test_buttons_of_two_panels_are_each_panels_own() -> None:
    fit = fitted({})
    far = [replace(d, x_px=d.x_px + 2000.0) for d in fit.detections]
    camera = type(VIEW.camera).from_matrix(VIEW.camera.matrix, 4000, VIEW.camera.height)
    for one in fit_panels([*fit.detections, *far], camera, METRIC):
        assert all(b.row >= 0 for b in one.buttons)
