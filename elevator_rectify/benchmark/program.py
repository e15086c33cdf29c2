"""Command line of the benchmarks: three tables and their pictures."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path

import cv2

from elevator_rectify.benchmark.buttons import buttons_table
from elevator_rectify.benchmark.few import few_table
from elevator_rectify.benchmark.negatives import KINDS, run_negative, run_overlapping
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.pictures import picture_table, spoilt_table
from elevator_rectify.benchmark.plot import write_curves
from elevator_rectify.benchmark.real import mixed, photographs
from elevator_rectify.benchmark.shown import shown_table, write_example
from elevator_rectify.benchmark.synthetic import HEADER, Trial, oracle_row, run_trial, table_row, yardstick_ms
from elevator_rectify.benchmark.timing import measurement_line, timing_table
from elevator_rectify.benchmark.turned import turned_table
from elevator_rectify.core.config import METHODS
from elevator_rectify.render.levels import LEVELS


def _trial(task: tuple[str, str, int, int]) -> Trial:
    method, level, seed, number = task
    return run_trial(level, seed, number, method)


def _negative(task: tuple[str, int, int]) -> bool:
    return run_negative(*task).ok


def _overlapping(task: tuple[int, int]) -> bool:
    return run_overlapping(*task)


def synthetic_table(levels: list[str], methods: list[str], trials: int, seed: int, plot: Path | None) -> str:
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
            errors[method] = [t.error_deg for t in results]
        lines.append(oracle_row(level, results))
        errors["oracle"] = [t.oracle_deg for t in results]
        if plot is not None:
            print(f"curves: {write_curves(plot, level, errors)}")
    lines.append(f"yardstick: one cv2.warpPerspective of a 640 x 480 colour image, {yardstick:.2f} ms on one thread")
    return "\n".join(lines)


def negative_table(draws: int, seed: int) -> str:
    """Return the table of false acceptance."""
    lines = [f"{'without a panel':<17}{'draws':>7}{'accepted':>10}{'%':>8}"]
    for kind in KINDS:
        results = Counter(parallel(_negative, [(kind, seed, n) for n in range(draws)], kind))
        lines.append(f"{kind:<17}{draws:>7}{results[True]:>10}{100.0 * results[True] / draws:>8.3f}")
    results = Counter(parallel(_overlapping, [(seed, n) for n in range(draws)], "overlapping"))
    lines.append(
        f"{'two lattices':<17}{draws:>7}{results[True]:>10}{100.0 * results[True] / draws:>8.3f}  (with neither's pose)"
    )
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Print the tables that were asked for."""
    parser = argparse.ArgumentParser(prog="benchmark", description=__doc__)
    parser.add_argument("--trials", type=int, default=400, help="generated panels a level")
    parser.add_argument("--levels", default="easy,medium,hard,gaps", help=f"of {','.join(LEVELS)}")
    parser.add_argument("--methods", default="joint", help=f"of {','.join(METHODS)}")
    parser.add_argument("--seed", type=int, default=1001)
    parser.add_argument("--draws", type=int, default=1000, help="draws a kind of detections without a panel; 0: none")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of real panels")
    parser.add_argument(
        "--plot", type=Path, help="folder for the error curves, or an example of missed buttons, as pictures"
    )
    parser.add_argument("--pictures", action="store_true", help="what the picture adds, on rendered and real pictures")
    parser.add_argument("--turns", type=int, default=20, help="virtual rotations of each photograph, with --pictures")
    parser.add_argument(
        "--buttons", action="store_true", help="missing buttons and labels, on real panels and rendered ones"
    )
    parser.add_argument("--repeats", type=int, default=5, help="times that each real panel is spoilt, with --buttons")
    options = parser.parse_args(arguments)
    if options.buttons:
        return _buttons(options)
    if options.pictures:
        return _pictures(options)
    if options.trials:
        print(
            synthetic_table(
                options.levels.split(","), options.methods.split(","), options.trials, options.seed, options.plot
            )
        )
        print(
            "\n" + timing_table(options.methods.split(",")[0], min(100, options.trials), options.seed, yardstick_ms())
        )
    if options.draws:
        print("\n" + negative_table(options.draws, options.seed))
    if (options.data / "photos" / "photos.json").exists():
        print("\n" + photographs(options.data) + "\n\n" + mixed(options.data))
    else:
        print(f"\nreal panels skipped: there is no {options.data}/photos")
    return 0


def _buttons(options: argparse.Namespace) -> int:
    """Print the tables of missing buttons and of labels."""
    cv2.setNumThreads(1)
    if (options.data / "panels_mixed.json").exists():
        print(buttons_table(options.data, options.seed, options.repeats, yardstick_ms()))
    else:
        print(f"real panels skipped: there is no {options.data}/panels_mixed.json")
    if options.trials:
        print("\n" + shown_table(options.levels.split(","), options.trials, options.seed))
    if options.plot is not None:
        write_example(options.plot / "missed_buttons.jpg", options.levels.split(",")[0], options.seed)
        print(f"an example: {options.plot / 'missed_buttons.jpg'}")
    return 0


def _pictures(options: argparse.Namespace) -> int:
    """Print the tables of the fits to pictures."""
    cv2.setNumThreads(1)
    yardstick = yardstick_ms()
    if options.trials:
        print(picture_table(options.levels.split(","), options.trials, options.seed, yardstick))
        print(measurement_line(options.seed, yardstick))
    if options.draws:
        print("\n" + spoilt_table(options.draws, options.seed))
        print("\n" + few_table(options.draws, options.seed))
    if options.turns and (options.data / "photos" / "photos.json").exists():
        print("\n" + turned_table(options.data, options.turns))
    else:
        print(f"\nphotographs skipped: there is no {options.data}/photos, or no turns are asked for")
    return 0
