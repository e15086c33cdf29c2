import json
from pathlib import Path

import numpy as np
import pytest

from elevator_rectify.benchmark.figures import Figures, comparison, read_figures


def rates(share: float, number: int = 200) -> Figures:
    figures = Figures()
    figures.rate("success+", np.arange(number) < share * number)
    figures.rate("wrong-", np.arange(number) < (1.0 - share) * number)
    figures.median("error deg-", np.linspace(0.0, 2.0 - share, number))
    return figures


def test_a_run_is_read_as_it_was_written(tmp_path: Path) -> None:
    figures = rates(0.9)
    figures.write(tmp_path / "one.json", seed=3)
    again = read_figures(tmp_path / "one.json")
    assert again.keys() == figures.table.keys()
    assert json.loads((tmp_path / "one.json").read_text())["settings"]["seed"] == 3
    assert not comparison(again, figures.table)[1] and " 0 changed" in comparison(again, figures.table)[0]


def test_a_rate_that_fell_beyond_its_error_is_worse() -> None:
    # The standard error of each share is some .03: .9 to .7 is far beyond that of the difference, .9 to .87 within it.
    assert comparison(rates(0.9).table, rates(0.7).table)[1]
    assert not comparison(rates(0.9).table, rates(0.87).table)[1]
    assert not comparison(rates(0.7).table, rates(0.9).table)[1]


def test_less_is_better_where_the_name_says_so() -> None:
    text, worse = comparison({"wrong-": rates(0.9).table["wrong-"]}, {"wrong-": rates(0.6).table["wrong-"]})
    assert worse and "wrong-" in text


def test_the_error_of_a_share_is_never_zero_and_that_of_a_median_shrinks_with_the_draws() -> None:
    figures = Figures()
    figures.rate("all", np.ones(50, dtype=bool))
    figures.median("few", np.random.default_rng(1).normal(size=50))
    figures.median("many", np.random.default_rng(1).normal(size=5000))
    assert figures.table["all"].error > 0.01
    # The median's error falls as one over the root of the draws: a tenth, to the bootstrap's own noise.
    assert 0.05 < figures.table["many"].error / figures.table["few"].error < 0.2


def test_a_file_without_figures_is_named(tmp_path: Path) -> None:
    (tmp_path / "bad.json").write_text("{}")
    with pytest.raises(ValueError, match=r"bad\.json holds no figures"):
        read_figures(tmp_path / "bad.json")
