"""Benchmarks on the labelled real pictures: one picture each."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elevator_rectify.benchmark import attitude, lit, rapidocr, reliability, turned_reading
from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.calibrate.lit import examples
from elevator_rectify.core import Detection
from elevator_rectify.core.lamps.lit import lit_probability
from elevator_rectify.core.reading.attitude import put
from elevator_rectify.core.types import Image
from elevator_rectify.train.labelled import read_labelled
from elevator_rectify.train.lit_marks import read_marks

LABELLED = Path(__file__).parent.parent.parent / "shared" / "data" / "labelled"
CORNERS = np.array([[10.0, 10], [50, 10], [50, 50], [10, 50]])


class Recogniser:
    """Reads 7 in what it is shown, the more surely the smaller that is; nothing in what is black."""

    def __init__(self) -> None:
        self.sides: list[int] = []

    def __call__(self, image: Image, **stages: bool) -> Any:
        assert stages == {"use_det": False, "use_cls": False, "use_rec": True} and image.shape[2] == 3
        self.sides.append(image.shape[0])
        if not image.any():
            return SimpleNamespace(txts=None, scores=None)
        return SimpleNamespace(txts=(" 7 ",), scores=(1.0 - image.shape[0] / 200,))


@pytest.fixture
def recogniser(monkeypatch: pytest.MonkeyPatch) -> Recogniser:
    engine = Recogniser()
    monkeypatch.setattr(rapidocr, "_engine", lambda: engine)
    monkeypatch.setattr(rapidocr, "installed", lambda: True)
    return engine


def test_another_reader_has_two_views_and_the_surer_counts(recogniser: Recogniser) -> None:
    nowhere = np.full((4, 2), np.nan)
    said = rapidocr.read_by_rapidocr(np.full((64, 64), 200, np.uint8), [CORNERS, nowhere])
    assert len(recogniser.sides) == 2 and recogniser.sides[1] < 0.7 * recogniser.sides[0]
    assert said == [("7", 1.0 - recogniser.sides[1] / 200), ("", 0.0)]
    assert rapidocr.read_by_rapidocr(np.zeros((64, 64, 3), np.uint8), [CORNERS]) == [("", 0.0)]


@pytest.mark.skipif(not LABELLED.exists(), reason="the real panels' folder is not beside the checkout")
def test_turned_pictures_are_read_by_both_readers(recogniser: Recogniser) -> None:
    counts = turned_reading.run_picture((str(LABELLED), "75"))
    assert len(counts) == len(turned_reading.ANGLES_DEG)
    assert counts[0].accepted and counts[0].own[0] > 0.5 * counts[0].texts
    # It reads every button as 7: there is one, and the floors' order does not believe the others.
    assert all(c.rapidocr[0] <= 1 and c.rapidocr[1] <= 1 for c in counts)


@pytest.mark.skipif(not LABELLED.exists(), reason="the real panels' folder is not beside the checkout")
def test_parts_of_a_real_panel_agree_with_the_whole() -> None:
    found = reliability.run_panel((str(LABELLED), "75"))
    assert found == reliability.run_panel((str(LABELLED), "75"))
    pictured = [f for f in found if f.with_picture and f.accepted]
    assert len(pictured) >= 3 and all(f.right and f.error_deg < 4.0 for f in pictured)
    # The camera's calibration only widens the region.
    assert all(f.mahalanobis2 <= f.of_residuals + 1e-9 for f in found)


def test_the_reliability_of_what_was_found_is_told_by_bins() -> None:
    good, bad = (reliability.PartFit(True, p, r, r, 1.0, 2.0, 9.0) for p, r in ((0.98, True), (0.1, False)))
    figures = Figures()
    text = "\n".join(reliability._lines("with picture", [good, good, good, bad], figures))
    assert "accepted 3 of 4, right 1.000" in text
    assert "region 1.000, by the residuals alone 0.000" in text
    # Three are less sure by .02 than they are right, one is surer by .1.
    assert "calibration error 0.040" in text and "accepted 0 of 1" in reliability._accepted_line([], 1)


@pytest.mark.parametrize("way", range(8))
def test_a_box_is_put_as_its_picture_is(way: int) -> None:
    picture = np.zeros((60, 60), np.uint8)
    picture[10:14, 20:30] = 255
    box = attitude._put(Detection(24.5, 11.5, 10.0, 4.0), way, 60)
    y, x = np.nonzero(put(picture, way))
    shown = [x.mean(), y.mean(), np.ptp(x) + 1, np.ptp(y) + 1]
    assert [box.x_px, box.y_px, box.width_px, box.height_px] == [float(v) for v in shown]


@pytest.mark.skipif(not LABELLED.exists(), reason="the real panels' folder is not beside the checkout")
def test_a_real_panel_is_told_to_stand_upright_only_as_it_is() -> None:
    said = attitude.run_panel((str(LABELLED), "1075"))
    assert said.pop("as it is") == "upright" and "upright" not in said.values()


@pytest.mark.skipif(not LABELLED.exists(), reason="the real panels' folder is not beside the checkout")
def test_the_lit_lamp_of_a_real_panel_is_the_likeliest() -> None:
    told = lit.told((str(LABELLED), "1355"))
    assert told is not None and told.lit.sum() == 1
    assert int(np.nanargmax(lit_probability(told.odds, told.labels))) == int(np.argmax(told.lit))


@pytest.mark.skipif(not LABELLED.exists(), reason="the real panels' folder is not beside the checkout")
def test_lamps_are_marked_on_buttons_that_are_there() -> None:
    marks = read_marks()
    for picture in read_labelled(LABELLED, names=tuple(marks)):
        marked = marks[picture.name].lit | marks[picture.name].unsure
        assert max(marked, default=-1) < picture.is_button.sum()
        assert not marks[picture.name].lit & marks[picture.name].unsure


@pytest.mark.skipif(not LABELLED.exists(), reason="the real panels' folder is not beside the checkout")
def test_examples_of_lit_lamps_are_the_marked_and_the_painted_ones() -> None:
    asis, *painted = examples((str(LABELLED), "848"))
    assert not asis.painted and asis.lit.sum() == 1 and asis.seen.shape[1:] == (9, 24, 24)
    assert painted and all(e.painted and 1 <= e.lit.sum() <= 3 for e in painted)
