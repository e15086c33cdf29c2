"""The tables of generated panels, and of detections without a panel."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import cv2

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.negatives import KINDS, run_negative, run_overlapping
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.plot import write_curves
from elevator_rectify.benchmark.synthetic import HEADER, Trial, oracle_row, record, run_trial, table_row, yardstick_ms


def _trial(task: tuple[str, str, int, int]) -> Trial:
    method, level, seed, number = task
    return run_trial(level, seed, number, method)


def _negative(task: tuple[str, int, int]) -> bool:
    return run_negative(*task).ok


def _overlapping(task: tuple[int, int]) -> bool:
    return run_overlapping(*task)


def synthetic_table(
    levels: list[str], methods: list[str], trials: int, seed: int, plot: Path | None, figures: Figures
) -> str:
    """Return the table of generated panels; write the error curves where asked."""
    cv2.setNumThreads(1)
    yardstick = yardstick_ms()
    lines = [HEADER]
    for level in levels:
        errors: dict[str, list[float]] = {}
        for method in methods:
            tasks = [(method, level, seed, n) for n in range(trials)]
            results = parallel(_trial, tasks, f"{level} {method}")
            lines.append(table_row(level, method, results, yardstick))
            record(figures, f"{level} {method}", results)
            errors[method] = [t.error_deg for t in results]
        lines.append(oracle_row(level, results))
        errors["oracle"] = [t.oracle_deg for t in results]
        if plot is not None:
            print(f"curves: {write_curves(plot, level, errors)}")
    lines.append(f"yardstick: one cv2.warpPerspective of a 640 x 480 colour image, {yardstick:.2f} ms on one thread")
    return "\n".join(lines)


def negative_table(draws: int, seed: int, figures: Figures) -> str:
    """Return the table of false acceptance."""
    lines = [f"{'without a panel':<17}{'draws':>7}{'accepted':>10}{'%':>8}"]
    for kind in KINDS:
        results = Counter(parallel(_negative, [(kind, seed, n) for n in range(draws)], kind))
        figures.share(f"no panel, {kind}, accepted-", results[True], draws)
        lines.append(f"{kind:<17}{draws:>7}{results[True]:>10}{100.0 * results[True] / draws:>8.3f}")
    results = Counter(parallel(_overlapping, [(seed, n) for n in range(draws)], "overlapping"))
    figures.share("two lattices, neither's pose accepted-", results[True], draws)
    lines.append(
        f"{'two lattices':<17}{draws:>7}{results[True]:>10}{100.0 * results[True] / draws:>8.3f}  (with neither's pose)"
    )
    return "\n".join(lines)
