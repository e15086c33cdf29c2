import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elevator_rectify.benchmark import program
from elevator_rectify.benchmark.buttons import run_read
from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.known import OTHERS, run_panel
from elevator_rectify.benchmark.known_rendered import run_scene
from elevator_rectify.benchmark.missing import entries, run_removed
from elevator_rectify.benchmark.negatives import KINDS, run_negative
from elevator_rectify.benchmark.oracle import cramer_rao_rad, oracle_rotation, true_lattice
from elevator_rectify.benchmark.real import photographs
from elevator_rectify.benchmark.synthetic import calibration_error, run_trial
from elevator_rectify.benchmark.turned import run_photograph
from elevator_rectify.calibrate import confidence as calibrate
from elevator_rectify.calibrate import filled as calibrate_filled
from elevator_rectify.calibrate.logistic import logistic_regression
from elevator_rectify.core import confidence
from elevator_rectify.core.outline import result as few_result
from elevator_rectify.core.picture import fit as picture_fit
from elevator_rectify.render.levels import LEVELS, random_scene
from test.scenes import rotation_error_deg

DATA = Path(__file__).parent.parent.parent / "shared" / "data"


@pytest.mark.parametrize("module", [confidence, picture_fit, few_result])
def test_coefficients_belong_to_the_features(module: Any) -> None:
    table = json.loads(module.COEFFICIENTS.read_text())
    number = len(module.FEATURES)
    assert list(table["features"]) == list(module.FEATURES)
    one = confidence.expanded(np.zeros(number), np.zeros(number), np.ones(number))
    assert len(table["coefficients"]) == len(one)


def test_scenes_of_the_levels_are_reproducible_and_within_their_limits() -> None:
    for name, level in LEVELS.items():
        one, again = random_scene(level, 3, 5), random_scene(level, 3, 5)
        np.testing.assert_array_equal(one.centres_px, again.centres_px)
        assert (one.button >= 0).sum() >= 6, name


def test_oracle_reaches_the_cramer_rao_bound() -> None:
    errors, bounds = [], []
    for trial in range(200):
        scene = random_scene(LEVELS["easy"], 9, trial)
        errors.append(rotation_error_deg(oracle_rotation(scene), scene.R_camera_panel))
        bounds.append(np.rad2deg(cramer_rao_rad(scene, LEVELS["easy"].sigma_px)))
        assert true_lattice(scene)[1].shape[1] == 2
    # 200 trials of three degrees of freedom: the ratio of mean squares is known to about 8 %, weak geometry aside.
    assert np.mean(np.square(errors) / np.square(bounds)) == pytest.approx(1.0, abs=0.3)


def test_a_trial_is_judged() -> None:
    trial = run_trial("easy", 1, 0, "joint")
    assert trial.cells == 1.0 and trial.right and trial.accepted
    assert calibration_error([trial]) < 1.0


@pytest.mark.parametrize("kind", KINDS)
def test_few_draws_without_a_panel_are_accepted(kind: str) -> None:
    """60 draws of each kind: the benchmark counts them in thousands."""
    assert sum(run_negative(kind, 5, n).ok for n in range(60)) <= 1


def test_logistic_regression_finds_a_known_model() -> None:
    rng = np.random.default_rng(0)
    X = np.column_stack([np.ones(20000), rng.normal(0, 1, 20000)])
    y = (rng.random(20000) < 1 / (1 + np.exp(-(0.5 - 1.5 * X[:, 1])))).astype(float)
    # 20,000 draws give a coefficient to 0.02; the ridge takes a little.
    np.testing.assert_allclose(logistic_regression(X, y, np.ones(len(y)), ridge=12.0), [0.5, -1.5], atol=0.12)


def test_the_program_prints_its_tables(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert (
        program.main(
            ["--trials", "2", "--levels", "easy", "--draws", "2", "--data", str(tmp_path), "--plot", str(tmp_path)]
        )
        == 0
    )
    assert (tmp_path / "errors_easy.png").stat().st_size > 1000
    said = capsys.readouterr().out
    assert "oracle" in said and "uniform" in said and "skipped" in said


def test_the_program_prints_what_the_picture_adds(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    options = [
        "--pictures",
        "--trials",
        "2",
        "--levels",
        "easy",
        "--draws",
        "1",
        "--turns",
        "1",
        "--data",
        str(tmp_path),
    ]
    assert program.main(options) == 0
    said = capsys.readouterr().out
    assert all(word in said for word in ("oracle", "lateral", "yardsticks", "made wrong", "3 square", "skipped")), said
    plot = ["--plot", str(tmp_path)]
    assert program.main(["--buttons", "--trials", "2", "--levels", "easy", "--data", str(tmp_path), *plot]) == 0
    assert (tmp_path / "missed_buttons.jpg").exists()
    said = capsys.readouterr().out
    assert "skipped" in said and "with picture" in said and "easy" in said


def test_the_program_prints_the_coverage_of_wrong_calibrations(capsys: pytest.CaptureFixture[str]) -> None:
    assert program.main(["--inexact", "2", "--levels", "easy"]) == 0
    said = capsys.readouterr().out
    assert "exact" in said and "f 5 % too long" in said and "k1 too low" in said


def test_taught_panels_are_fitted_beside_the_free_fit() -> None:
    (free, known) = run_scene(("easy", 5001, 0))
    assert free.accepted and known.accepted and not known.wrong and len(known.lateral_mm) == len(free.lateral_mm)


@pytest.mark.skipif(not DATA.exists(), reason="the real panels' folder is not beside the checkout")
def test_a_real_panel_is_taught_and_another_one_is_not_taken_for_it() -> None:
    looks = run_panel((str(DATA / "labelled"), "75", ("11",), 3001))
    assert {look.kind for look in looks} >= {OTHERS, "whole, 0 to 25 degrees"} and not any(look.wrong for look in looks)


@pytest.mark.skipif(not DATA.exists(), reason="the real panels' folder is not beside the checkout")
def test_a_photograph_turned_virtually_turns_the_estimate() -> None:
    line = run_photograph((str(DATA / "photos"), "t4", 5))
    assert line["picture turns"] >= 3 and line["picture spread"] < 0.5 * line["boxes spread"]


@pytest.mark.skipif(not DATA.exists(), reason="the real panels' folder is not beside the checkout")
def test_labels_of_a_real_panel_are_corrected_and_missing_buttons_inferred() -> None:
    panels = {entry.name: entry for entry in entries(DATA)}
    assert len(panels) > 60
    some = [panels[name] for name in sorted(panels)[:12]]
    readings = [r for r in (run_read((p, 3, True)) for p in some) if r is not None]
    assert sum(r.after for r in readings) > sum(r.before for r in readings)
    assert sum(r.spoilt for r in readings) == 0 and sum(r.right for r in readings) == sum(r.answered for r in readings)
    removed = [run_removed((p, 0.1, 3)) for p in some]
    assert sum(r.right for r in removed) > sum(r.wrong for r in removed)


@pytest.mark.skipif(not DATA.exists(), reason="the real panels' folder is not beside the checkout")
def test_photographs_come_out_straight() -> None:
    table = photographs(DATA, Figures())
    summary = table.splitlines()[-1]
    accepted, after = int(summary.split()[1]), float(summary.split(" after ")[1].split()[0])
    assert accepted >= 10 and after < 1.0, table


def test_the_model_of_missed_buttons_is_fitted_only_with_real_panels(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert calibrate.main(["--buttons", "--data", str(tmp_path)]) == 1
    assert "only with" in capsys.readouterr().out


@pytest.mark.skipif(not DATA.exists(), reason="the real panels' folder is not beside the checkout")
def test_cells_of_removed_buttons_are_the_examples_of_the_model() -> None:
    panels = [e for e in entries(DATA) if len(e.detections) > 25][:4]
    tasks = [(e, share, 7, labels) for e in panels for share in (0.0, 0.1) for labels in ("printed", "none", "spoilt")]
    cells = [c for c in (calibrate_filled.draw(task) for task in tasks) if c is not None]
    assert {c.labels for c in cells} == {"printed", "none", "spoilt"}
    assert all(not c.held.any() for c in cells if c.share == 0.0)
    assert 0 < sum(c.held.sum() for c in cells) <= sum(c.removed for c in cells)
    constant, coefficients = calibrate_filled.fitted(cells)
    assert np.isfinite(constant) and np.isfinite(coefficients).all()
    table = calibrate_filled.cross_validated([e.name for e in panels], cells)
    assert "printed" in table and "spoilt" in table


def test_the_times_of_fits_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert program.main(["--times", "1"]) == 0
    said = capsys.readouterr().out
    assert all(f"{name:<20}{number:>4}" in said for name in ("boxes", "boxes and picture") for number in (10, 60, 200))
