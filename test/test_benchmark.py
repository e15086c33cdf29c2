import json
from pathlib import Path

import numpy as np
import pytest

from elevator_rectify.benchmark import program
from elevator_rectify.benchmark.negatives import KINDS, run_negative
from elevator_rectify.benchmark.oracle import cramer_rao_rad, oracle_rotation, true_lattice
from elevator_rectify.benchmark.real import photographs
from elevator_rectify.benchmark.synthetic import calibration_error, run_trial
from elevator_rectify.calibrate import logistic_regression
from elevator_rectify.core.confidence import COEFFICIENTS, FEATURES, expanded
from elevator_rectify.render.levels import LEVELS, random_scene
from test.scenes import rotation_error_deg

DATA = Path(__file__).parent.parent.parent / "shared" / "data"


def test_coefficients_belong_to_the_features() -> None:
    table = json.loads(COEFFICIENTS.read_text())
    assert list(table["features"]) == list(FEATURES)
    one = expanded(np.zeros(len(FEATURES)), np.zeros(len(FEATURES)), np.ones(len(FEATURES)))
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
    np.testing.assert_allclose(logistic_regression(X, y, np.ones(len(y))), [0.5, -1.5], atol=0.12)


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


@pytest.mark.skipif(not DATA.exists(), reason="the real panels' folder is not beside the checkout")
def test_photographs_come_out_straight() -> None:
    table = photographs(DATA)
    summary = table.splitlines()[-1]
    accepted, after = int(summary.split()[1]), float(summary.split(" after ")[1].split()[0])
    assert accepted >= 10 and after < 1.0, table
