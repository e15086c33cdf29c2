"""Our own reader: what the vocabulary can say, distributions, patches in the panel's plane."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given as examples
from hypothesis import strategies as st

from elevator_rectify.benchmark.pictures import pictured
from elevator_rectify.core import (
    Camera,
    Config,
    Detection,
    MeasurementConfig,
    TargetConfig,
    find_button,
    find_panel,
    fit_panel,
    pipeline,
)
from elevator_rectify.core.find import with_labels
from elevator_rectify.core.reading import reader
from elevator_rectify.core.reading.reader import (
    PATCH_PX,
    Read,
    is_small,
    labelled,
    no_buttons,
    quadrangle_logits,
    read_boxes,
    read_in_plane,
    read_patches,
)
from elevator_rectify.core.reading.vocabulary import BLANK, CHARACTERS, SLOTS, SYMBOLS, encoded
from elevator_rectify.core.types import FitResult, Image
from test.scenes import patches_read


@examples(st.text(CHARACTERS, min_size=1, max_size=SLOTS))
def test_a_text_is_said_character_by_character(text: str) -> None:
    said = encoded(text)
    assert said is not None and said[0] == "text"
    assert "".join(CHARACTERS[c] for c in said[1] if c != BLANK) == text


@pytest.mark.parametrize(
    ("label", "kind"),
    [("open", "open"), ("empty", "empty"), ("blur", "unreadable"), ("unknown", "unreadable"), ("s1", "text")],
)
def test_annotations_have_their_kind(label: str, kind: str) -> None:
    said = encoded(label)
    assert said is not None and said[0] == kind


def test_what_it_cannot_say_is_none() -> None:
    assert encoded("12345") is None and encoded("") is None and encoded("ä") is None and encoded("led") is None


def patch(text: str) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    canvas = np.full((96, 96), 60, np.uint8)
    cv2.circle(canvas, (48, 48), 38, 200, -1, cv2.LINE_AA)
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, 1.4, 3)
    cv2.putText(canvas, text, (48 - width // 2, 48 + height // 2), cv2.FONT_HERSHEY_DUPLEX, 1.4, 20, 3, cv2.LINE_AA)
    return cv2.resize(canvas, (PATCH_PX, PATCH_PX), interpolation=cv2.INTER_AREA).astype(np.uint8)


def test_clear_numbers_are_read() -> None:
    texts = [str(n) for n in range(1, 31)]
    reads = read_patches([patch(text) for text in texts])
    # In a font of strokes that it never saw.
    assert np.mean([r.label == text for r, text in zip(reads, texts, strict=True)]) > 0.7


def test_what_is_read_is_a_distribution_and_polarity_does_not_matter_to_its_form() -> None:
    for read in read_patches([patch("7"), 255 - patch("7"), np.zeros((PATCH_PX, PATCH_PX), np.uint8)]):
        probabilities = [p for _, p in read.labels]
        assert probabilities == sorted(probabilities, reverse=True)
        assert 0.0 <= read.certainty <= 1.0 + 1e-6 and 0.0 <= read.other <= 1.0


def test_one_batch_reads_what_single_ones_read() -> None:
    patches = [patch(text) for text in ("3", "12", "G")]
    together = read_patches(patches)
    for p, read in zip(patches, together, strict=True):
        reader._last_logits.clear()
        (alone,) = read_patches([p])
        assert alone.label == read.label
        assert alone.certainty == pytest.approx(read.certainty, abs=1e-4)
    assert read_patches([]) == []


def test_the_last_patches_are_remembered_each_by_its_own_bytes() -> None:
    reader._last_logits.clear()
    patches = [patch(text) for text in ("3", "12", "3")]
    logits = reader.logits_of(patches)
    assert len(reader._last_logits) == 2 and (logits[0] == logits[2]).all() and (logits[0] != logits[1]).any()
    known = dict(reader._last_logits)
    np.testing.assert_array_equal(reader.logits_of(patches[::-1]), logits[::-1])
    assert all(reader._last_logits[key] is row for key, row in known.items())
    reader.logits_of([patch(str(n)) for n in range(reader._KEPT + 5)])
    assert len(reader._last_logits) == reader._KEPT


def test_the_plane_and_the_box_agree_where_the_camera_faces_the_panel() -> None:
    given = pictured("easy", 60, 0, held_out=True)
    fit = fit_panel(given.scene.detections, given.scene.camera, Config(), image=given.image)
    assert fit.ok
    plane = read_in_plane(given.image, given.scene.camera, fit)
    boxes = read_boxes(given.image, given.scene.detections)
    true = [given.scene.panel.buttons[b].label for b in given.scene.button]
    right = [np.mean([r.label == t for r, t in zip(reads, true, strict=True)]) for reads in (plane, boxes)]
    assert min(right) > 0.5 and right[0] >= right[1] - 0.15


def test_labels_of_the_detector_are_kept() -> None:
    detections = [Detection(0, 0, 9, 9, "open", 0.4), Detection(0, 0, 9, 9)]
    read = Read((("7", 0.9),), 0.0)
    assert [d.label for d in labelled(detections, [read, read])] == ["open", "7"]
    assert labelled(detections, [Read((), 1.0)] * 2) == tuple(detections)


def test_centres_without_sizes_are_read_by_the_size_that_the_picture_shows() -> None:
    given = pictured("easy", 60, 0, held_out=True)
    bare = [Detection(d.x_px, d.y_px) for d in given.scene.detections]
    unseen = fit_panel(bare, given.scene.camera, Config())
    assert with_labels(unseen, given.image, given.scene.camera) is unseen
    fit = with_labels(fit_panel(bare, given.scene.camera, Config(), image=given.image), given.image, given.scene.camera)
    true = [given.scene.panel.buttons[b].label for b in given.scene.button]
    assert np.mean([d.label == t for d, t in zip(fit.detections, true, strict=True)]) > 0.7


def test_a_panel_is_found_and_read_in_the_picture_alone() -> None:
    found = [pictured("easy", 60, k, held_out=True) for k in range(6)]
    fits = [find_panel(g.image, g.scene.camera) for g in found]
    assert sum(f.ok for f in fits) >= 3
    # Twice the pixels of a symbol are not a reason for two symbols: no label is given to two of one panel's buttons.
    for fit in (f for f in fits if f.ok):
        sure = [b.label for b in fit.buttons if b.label and b.label_probability > 0.95 and b.label not in SYMBOLS]
        assert len(sure) - len(set(sure)) <= 1


def test_a_picture_without_a_panel_gives_a_reason() -> None:
    rng = np.random.default_rng(1)
    camera = pictured("easy", 60, 0, picture=False).scene.camera
    for picture in (np.zeros((480, 640, 3), np.uint8), rng.integers(0, 255, (480, 640, 3), dtype=np.uint8)):
        fit = find_panel(picture, camera)
        assert not fit.ok and fit.reason


def test_missing_places_are_allowed_and_small_buttons_told_from_large_ones() -> None:
    image = np.full((200, 200, 3), 120, np.uint8)
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    corners = [square * 40.0 + 20.0, square * 15.0 + 90.0, np.full((4, 2), np.nan)]
    assert [is_small(c) for c in corners] == [False, True, True]
    assert np.isfinite(quadrangle_logits(image, corners)).all()
    assert len(quadrangle_logits(image, [])) == 0 and read_boxes(image, []) == []


def test_buttons_that_nobody_detected_are_read_where_the_picture_shows_them() -> None:
    given = pictured("easy", 60, 4, held_out=True)
    scene = given.scene
    unread = [replace(d, label="") for d in scene.detections]
    camera = scene.camera
    full = with_labels(fit_panel(unread, camera, image=given.image), given.image, camera)
    kept = [d for k, d in enumerate(unread) if k % 5 != 2]
    fit = with_labels(fit_panel(kept, camera, image=given.image), given.image, camera)
    known = {(b.row, b.column): b.label for b in full.buttons if b.row >= 0}
    assert full.ok and fit.ok and not full.undetected
    assert len(fit.undetected) == len(unread) - len(kept) > 0
    for cell, button in fit.undetected.items():
        assert button is not None and button.label == known[cell] and button.width_px > 0
    inferred = [b for b in fit.buttons if b.state == "inferred"]
    assert {(b.row, b.column): (b.label, b.label_source) for b in inferred} == {
        cell: (known[cell], "read") for cell in fit.undetected
    }
    metric = replace(fit, metric=True)
    pressed = find_button(metric, known[next(iter(fit.undetected))], TargetConfig(max_lateral_std_m=1.0))
    assert pressed.status == "found" and pressed.button is not None and pressed.button.detection == -1


def test_buttons_that_stayed_where_they_were_are_not_read_again(monkeypatch: pytest.MonkeyPatch) -> None:
    given = pictured("easy", 60, 4, held_out=True)
    camera, unread = given.scene.camera, [replace(d, label="") for d in given.scene.detections]
    kept = [d for k, d in enumerate(unread) if k % 5 != 2]
    first = with_labels(fit_panel(kept, camera, image=given.image), given.image, camera)
    again = fit_panel(kept[::-1], camera, previous=first, image=given.image)
    counts = patches_read(monkeypatch)
    second = with_labels(again, given.image, camera, first)
    assert sum(counts) == 0 and second.detections == first.detections[::-1]
    labels = [{cell: d.label for cell, d in f.undetected.items() if d is not None} for f in (first, second)]
    assert labels[0] == labels[1] and labels[0]
    # One more button is read alone; a panel that is seen from another row on is read as a whole.
    more = fit_panel([*kept, unread[2]], camera, image=given.image)
    counts.clear()
    third = with_labels(more, given.image, camera, first)
    assert third.detections[:-1] == first.detections and third.detections[-1].label and sum(counts) == 1
    moved = replace(first, t_camera_panel=first.t_camera_panel + first.pitch[1] * first.R_camera_panel[:, 1])
    counts.clear()
    assert with_labels(more, given.image, camera, moved).ok and sum(counts) >= len(kept)


def test_what_reads_as_no_button_is_an_empty_cell() -> None:
    given = pictured("easy", 60, 4, held_out=True)
    camera = given.scene.camera
    kept = [replace(d, label="") for k, d in enumerate(given.scene.detections) if k % 5 != 2]
    fit = with_labels(fit_panel(kept, camera, image=given.image), given.image, camera)
    cell = next(iter(fit.undetected))
    other = replace(fit, undetected={**fit.undetected, cell: None})
    states = [{(b.row, b.column): b.state for b in f.buttons}[cell] for f in (fit, other)]
    assert states == ["inferred", "empty"]


def test_no_button_is_said_only_where_the_panels_buttons_read_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    given = pictured("easy", 60, 4, held_out=True)
    camera = given.scene.camera
    kept = [replace(d, label="") for k, d in enumerate(given.scene.detections) if k % 5 != 2]
    fit = fit_panel(kept, camera, image=given.image)
    assert not fit.undetected and not no_buttons(given.image, camera, fit)
    assert fit.measurement is not None
    empty = int(np.isfinite(fit.measurement.correlation).sum()) - len(kept)
    printed, blank = Read((("1", 0.99),), 0.0), Read((), 0.99)
    for usual, found in ((printed, empty), (blank, 0)):
        said = [blank] * empty + [usual] * len(kept)
        monkeypatch.setattr(reader, "read_quadrangles", lambda image, corners, r=said: r[: len(corners)])
        assert len(no_buttons(given.image, camera, fit)) == found


def test_what_is_no_button_is_asked_once_while_the_grid_is_tracked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Labels of the detector's own do not spare the empty cells the question."""
    given = pictured("easy", 60, 4, held_out=True)
    kept = [replace(d, label="1") for k, d in enumerate(given.scene.detections) if k % 5 != 2]
    asked: list[FitResult] = []

    def none(image: Image, camera: Camera, fit: FitResult) -> set[tuple[int, int]]:
        asked.append(fit)
        assert fit.measurement is not None
        return {(int(r), int(c)) for r, c in np.argwhere(np.isfinite(fit.measurement.correlation))} - {
            (int(r), int(c)) for r, c in fit.cells
        }

    monkeypatch.setattr(pipeline, "no_buttons", none)
    first = fit_panel(kept, given.scene.camera, image=given.image)
    second = fit_panel(kept, given.scene.camera, previous=first, image=given.image)
    assert len(asked) == 1 and first.undetected and second.undetected == first.undetected
    assert not [b for b in second.buttons if b.state == "inferred" and (b.row, b.column) in first.undetected]
    alone = fit_panel(kept, given.scene.camera, Config(measurement=MeasurementConfig(witness=False)), image=given.image)
    assert len(asked) == 1 and not alone.undetected
