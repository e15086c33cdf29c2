"""Command line of the benchmarks: tables, their figures as JSON, and what changed since another run."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2

from elevator_rectify.benchmark.adversarial import adversarial_table
from elevator_rectify.benchmark.approach import approach_table
from elevator_rectify.benchmark.attitude import attitude_table
from elevator_rectify.benchmark.buttons import buttons_table
from elevator_rectify.benchmark.detector import detector_table
from elevator_rectify.benchmark.end_to_end import end_to_end_table
from elevator_rectify.benchmark.few import few_table
from elevator_rectify.benchmark.figures import Figures, comparison, read_figures
from elevator_rectify.benchmark.hands import hands_table
from elevator_rectify.benchmark.inexact import inexact_table
from elevator_rectify.benchmark.known import known_table
from elevator_rectify.benchmark.known_rendered import known_rendered_table
from elevator_rectify.benchmark.lamps import lamps_table
from elevator_rectify.benchmark.lit import lit_table
from elevator_rectify.benchmark.pictures import picture_table, spoilt_table
from elevator_rectify.benchmark.reader import reader_table
from elevator_rectify.benchmark.real import mixed, photographs
from elevator_rectify.benchmark.reliability import reliability_table
from elevator_rectify.benchmark.self_calibration import self_calibration_table
from elevator_rectify.benchmark.sequences import sequence_table
from elevator_rectify.benchmark.shown import shown_table, write_example
from elevator_rectify.benchmark.synthetic import yardstick_ms
from elevator_rectify.benchmark.synthetic_tables import negative_table, synthetic_table
from elevator_rectify.benchmark.timing import measurement_line, timing_table
from elevator_rectify.benchmark.turned import turned_table
from elevator_rectify.benchmark.turned_reading import turned_reading_table
from elevator_rectify.core.config import METHODS
from elevator_rectify.render.levels import LEVELS

# The fixed set's sizes and seed: small enough for every change, with draws that nothing was calibrated on.
_FIXED_TRIALS, _FIXED_PICTURES, _FIXED_FEW, _FIXED_DRAWS, _FIXED_SEED = 100, 24, 8, 100, 7001
_FIXED_PANELS = 40
_LABELLED = {
    "detector": "precision and recall of our own detector",
    "reader": "how much our own reader reads right",
    "turned": "reading turned pictures as they are and rectified",
    "attitude": "whether labels are told to stand upright, turned or mirrored",
    "reliability": "confidence and covariance of fits to parts of panels",
    "end-to-end": "from the picture alone to the button, beside true boxes",
    "known": "panels taught from one picture, sought in other views",
    "lit": "which lamps are told to be lit by a single picture",
    "lamps": "whether a press is confirmed, lamps painted over pictures",
}
_FIXED_LEVELS = ["easy", "medium", "hard"]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="benchmark", description=__doc__)
    parser.add_argument("--trials", type=int, default=400, help="generated panels a level")
    parser.add_argument("--levels", default="easy,medium,hard,gaps", help=f"of {','.join(LEVELS)}")
    parser.add_argument("--methods", default="joint", help=f"of {','.join(METHODS)}")
    parser.add_argument("--seed", type=int, default=1001)
    parser.add_argument("--draws", type=int, default=1000, help="draws a kind of detections without a panel; 0: none")
    parser.add_argument("--data", type=Path, help="folder of real panels; without, they are skipped")
    parser.add_argument(
        "--plot", type=Path, help="folder for the error curves, or an example of missed buttons, as pictures"
    )
    parser.add_argument("--pictures", action="store_true", help="what the picture adds, on rendered and real pictures")
    parser.add_argument("--turns", type=int, default=20, help="virtual rotations of each photograph, with --pictures")
    parser.add_argument(
        "--buttons", action="store_true", help="missing buttons and labels, on real panels and rendered ones"
    )
    parser.add_argument("--repeats", type=int, default=5, help="with --buttons: times that a real panel is corrupted")
    for name, what in _LABELLED.items():
        parser.add_argument(f"--{name}", type=Path, metavar="LABELLED", help=f"{what}, on labelled pictures held out")
    parser.add_argument(
        "--dark", type=int, default=2, metavar="N", help="with --lamps: presses of each kind without a lamp, a panel"
    )
    parser.add_argument(
        "--sequences", type=int, default=0, metavar="N", help="tracking, on N camera paths of each kind"
    )
    parser.add_argument("--adversarial", type=int, default=0, metavar="SETS", help="detections that lie, SETS in all")
    parser.add_argument("--approaches", type=int, default=0, metavar="N", help="the aim while N fingers come and press")
    parser.add_argument("--hands", type=int, default=0, metavar="N", help="a hand before a third of N rendered panels")
    parser.add_argument("--taught", type=int, default=0, metavar="N", help="N rendered panels a level, taught before")
    parser.add_argument("--calibration", type=int, default=0, metavar="N", help="the camera, by each of N panels")
    parser.add_argument(
        "--inexact", type=int, default=0, metavar="N", help="coverage where the camera's calibration is off, N a level"
    )
    parser.add_argument("--times", type=int, default=0, metavar="N", help="time of a fit to N rendered panels a size")
    parser.add_argument("--fixed", action="store_true", help="a small set of everything, the same in every run")
    parser.add_argument("--json", type=Path, help="file to write the figures to, with seeds and versions")
    parser.add_argument(
        "--compare", type=Path, metavar="OLD.json", help="print what changed beyond its sampling error since that run"
    )
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Print the tables that were asked for; 1 where a rate is worse than in the compared run, 2 for wrong arguments."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if unknown := set(options.levels.split(",")) - set(LEVELS):
        parser.error(f"there is no level {', '.join(sorted(unknown))}; there are {', '.join(LEVELS)}")
    if unknown := set(options.methods.split(",")) - set(METHODS):
        parser.error(f"there is no method {', '.join(sorted(unknown))}; there are {', '.join(METHODS)}")
    try:
        before = read_figures(options.compare) if options.compare else {}
    except ValueError as error:
        parser.error(str(error))
    figures = Figures()
    cv2.setNumThreads(1)
    reference_ms = yardstick_ms()
    tables = _fixed if options.fixed else _buttons if options.buttons else _pictures if options.pictures else _boxes
    tables = _labelled if any(getattr(options, name.replace("-", "_")) for name in _LABELLED) else tables
    tables = _sequences if options.sequences else _adversarial if options.adversarial else tables
    tables = _approaches if options.approaches or options.hands else tables
    tables = _times if options.times else tables
    tables = _inexact if options.inexact else tables
    tables = _taught if options.taught or options.calibration else tables
    tables(options, figures, reference_ms)
    if options.json is not None:
        seed = _FIXED_SEED if options.fixed else options.seed
        figures.write(options.json, seed=seed, reference_ms=round(reference_ms, 3), fixed=options.fixed)
        print(f"\nfigures: {options.json}")
    if not before:
        return 0
    text, worse = comparison(before, figures.table)
    print("\n" + text)
    return int(worse)


def _real(options: argparse.Namespace, name: str) -> bool:
    """Tell whether the real panels of that name are there; say so where not."""
    if options.data is not None and (options.data / name).exists():
        return True
    print(f"\nreal panels skipped: {f'there is no {options.data / name}' if options.data else '--data is not given'}")
    return False


def _boxes(options: argparse.Namespace, figures: Figures, reference_ms: float) -> None:
    """Print the tables of the fits to boxes."""
    levels, methods = options.levels.split(","), options.methods.split(",")
    if options.trials:
        print(synthetic_table(levels, methods, options.trials, options.seed, options.plot, figures))
    if options.draws:
        print("\n" + negative_table(options.draws, options.seed, figures))
    if _real(options, "photos/photos.json"):
        print("\n" + photographs(options.data, figures) + "\n\n" + mixed(options.data, figures))


def _buttons(options: argparse.Namespace, figures: Figures, reference_ms: float) -> None:
    """Print the tables of missing buttons and of labels."""
    if _real(options, "panels_mixed.json"):
        print(buttons_table(options.data, options.seed, options.repeats, reference_ms, figures))
    if options.trials:
        print("\n" + shown_table(options.levels.split(","), options.trials, options.seed, figures))
    if options.plot is not None:
        write_example(options.plot / "missed_buttons.jpg", options.levels.split(",")[0], options.seed)
        print(f"an example: {options.plot / 'missed_buttons.jpg'}")


def _pictures(options: argparse.Namespace, figures: Figures, reference_ms: float) -> None:
    """Print the tables of the fits to pictures."""
    if options.trials:
        print(picture_table(options.levels.split(","), options.trials, options.seed, reference_ms, figures))
        print(measurement_line(options.seed, reference_ms))
    if options.draws:
        print("\n" + spoilt_table(options.draws, options.seed, figures))
        print("\n" + few_table(options.draws, options.seed, figures))
    if options.turns and _real(options, "photos/photos.json"):
        print("\n" + turned_table(options.data, options.turns, figures))


def _sequences(options: argparse.Namespace, figures: Figures, reference_ms: float) -> None:
    """Print the table of tracked camera paths."""
    print(sequence_table(options.sequences, options.seed, figures))


def _adversarial(options: argparse.Namespace, figures: Figures, reference_ms: float) -> None:
    """Print the table of detections that lie."""
    print(adversarial_table(options.adversarial, options.seed, figures))


def _times(options: argparse.Namespace, figures: Figures, reference_ms: float) -> None:
    """Print the table of times."""
    print(timing_table(options.methods.split(",")[0], options.times, options.seed))


def _inexact(options: argparse.Namespace, figures: Figures, reference_ms: float) -> None:
    """Print the table of wrong calibrations."""
    print(inexact_table(options.levels.split(","), options.inexact, options.seed, figures))


def _taught(options: argparse.Namespace, figures: Figures, reference_ms: float) -> None:
    """Print the tables of rendered panels that are seen several times."""
    if options.taught:
        print(known_rendered_table(options.levels.split(","), options.taught, options.seed, figures))
    if options.calibration:
        print(self_calibration_table(options.calibration, options.seed, figures))


def _approaches(options: argparse.Namespace, figures: Figures, reference_ms: float) -> None:
    """Print the tables of what comes before the camera."""
    if options.approaches:
        print(approach_table(options.approaches, options.seed, figures))
    if options.hands:
        print("\n" + hands_table(options.hands, options.seed, figures))


def _labelled(options: argparse.Namespace, figures: Figures, reference_ms: float) -> None:
    """Print the tables of our own detector and reader."""
    of_part: dict[str, Callable[[Path, Figures], str]] = {
        "detector": detector_table,
        "reader": reader_table,
        "turned": turned_reading_table,
        "attitude": attitude_table,
        "reliability": reliability_table,
        "end_to_end": end_to_end_table,
        "known": known_table,
        "lit": lit_table,
        "lamps": partial(lamps_table, dark=options.dark),
    }
    for name, table in of_part.items():
        folder = getattr(options, name)
        if folder is None:
            continue
        if not (folder / "panels_labelled.json").exists():
            print(f"\n{name} skipped: there is no {folder / 'panels_labelled.json'}")
            continue
        print("\n" + table(folder, figures))


def _fixed(options: argparse.Namespace, figures: Figures, reference_ms: float) -> None:
    """Print the tables of the fixed set."""
    print(synthetic_table([*_FIXED_LEVELS, "gaps"], ["joint"], _FIXED_TRIALS, _FIXED_SEED, None, figures))
    print("\n" + negative_table(_FIXED_DRAWS, _FIXED_SEED, figures))
    print("\n" + picture_table(_FIXED_LEVELS, _FIXED_PICTURES, _FIXED_SEED, reference_ms, figures))
    print("\n" + few_table(_FIXED_FEW, _FIXED_SEED, figures))
    if _real(options, "photos/photos.json"):
        print("\n" + turned_table(options.data, 0, figures))
    if _real(options, "panels_mixed.json"):
        print("\n" + buttons_table(options.data, _FIXED_SEED, 1, reference_ms, figures))
    if _real(options, "labelled/panels_labelled.json"):
        folder = options.data / "labelled"
        print("\n" + detector_table(folder, figures) + "\n\n" + reader_table(folder, figures))
        print("\n" + end_to_end_table(folder, figures, _FIXED_PANELS))


if __name__ == "__main__":
    raise SystemExit(main())
