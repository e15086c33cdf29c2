"""The program for a photograph."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from elevator_rectify.benchmark.pictures import pictured
from elevator_rectify.core import find_panel
from elevator_rectify.recordings import look

CALIBRATION = """
image_width: 640
image_height: 480
camera_matrix: {rows: 3, cols: 3, data: [320, 0, 320, 0, 320, 240, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
"""


@pytest.fixture(scope="module")
def photograph(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first rendered panel that is found, as a file."""
    folder = tmp_path_factory.mktemp("look")
    given = next(
        g for g in (pictured("easy", 60, k, held_out=True) for k in range(9)) if find_panel(g.image, g.scene.camera).ok
    )
    cv2.imwrite(str(folder / "panel.png"), given.image)
    (folder / "camera.yaml").write_text(CALIBRATION)
    return folder / "panel.png"


def test_a_photograph_is_described_and_shown(
    photograph: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    info = photograph.with_name("camera.yaml")
    assert look.main([str(photograph), "--camera-info", str(info), "--output", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "focal length 320 px" in said and "buttons found, seen from" in said
    assert {p.name for p in tmp_path.iterdir()} == {"panel_overlay.jpg", "panel_rectified.jpg", "panel_read.jpg"}


def test_a_button_is_pointed_out_or_the_reason_given(
    photograph: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [str(photograph), "--focal-px", "320", "--output", str(tmp_path), "--press"]
    assert look.main([*options, "77"]) == 1
    assert "77: unknown_label" in capsys.readouterr().out


def test_the_focal_length_is_a_guess_that_says_so(
    photograph: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    look.main([str(photograph), "--output", str(tmp_path)])
    assert "a guess" in capsys.readouterr().out
    look.main([str(photograph), "--focal-35mm", "18", "--output", str(tmp_path)])
    assert "focal length 320 px, 18 mm" in capsys.readouterr().out


def test_what_cannot_be_looked_at_is_one_line(
    tmp_path: Path, photograph: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "no.jpg").write_text("no picture")
    assert look.main([str(tmp_path / "no.jpg"), "--output", str(tmp_path)]) == 2
    assert "no picture that OpenCV reads" in capsys.readouterr().err
    (tmp_path / "bad.yaml").write_text("image_width: 640")
    assert look.main([str(photograph), "--camera-info", str(tmp_path / "bad.yaml"), "--output", str(tmp_path)]) == 2
    assert "no calibration" in capsys.readouterr().err
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), np.zeros((48, 64, 3), np.uint8))
    info = photograph.with_name("camera.yaml")
    assert look.main([str(small), "--camera-info", str(info), "--output", str(tmp_path)]) == 2
    assert "640 x 480 pictures, this one is 64 x 48" in capsys.readouterr().err
