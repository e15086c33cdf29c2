"""Replays a bag through the node's conversion, pairing and pipeline, offline, without a ROS graph."""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, TextIO

from elevator_rectify.core.config import METHODS, Config, flatten, with_values
from elevator_rectify.core.known.file import known_panel
from elevator_rectify.core.view.text_grid import LEGEND
from elevator_rectify.progress import progress
from elevator_rectify.recordings.answering import Answered, Ended, answers
from elevator_rectify.recordings.page import write_page
from elevator_rectify.recordings.report import write_report
from elevator_rectify.recordings.topics import OUTPUT_PREFIX, STREAM_TYPES, InputTopics, find_topics, recorded_topics
from elevator_rectify.ros.bag import BadBag, bag_topics, bag_writer
from elevator_rectify.ros.output import TOPICS

_TRUE, _FALSE = ("true", "1", "yes", "on"), ("false", "0", "no", "off")
_MOST_WORKERS, _INTERRUPTED = 64, 130


def replay(
    path: Path, output: Path, topics: InputTopics, config: Config, grids: TextIO | None = None, workers: int = 1
) -> Counter[str]:
    """Answer every frame of the bag into a new bag; return the counts of statuses and drops.

    grids: where the accepted panels are written as text, each under its image's stamp in ns.
    Raises BadBag where the input breaks off; all answers until there are written.
    """
    number = sum(count for name, (_, count) in bag_topics(path).items() if name == topics.detections)
    counts = Counter[str]()
    try:
        with bag_writer(output) as bag:
            frames = _frames(answers(path, topics, config, workers), counts)
            for frame in progress(frames, f"replay {config.method}", number):
                for topic, data in frame.messages.items():
                    bag.write_raw(OUTPUT_PREFIX + topic, TOPICS[topic], data, frame.time_ns)
                if grids is not None and frame.grid:
                    print(f"{frame.stamp_ns}\n{frame.grid}\n", file=grids)
    finally:
        print(f"{config.method}: " + ", ".join(f"{n} {name}" for name, n in counts.items()))
    return counts


def _frames(steps: Iterator[Answered | Ended], counts: Counter[str]) -> Iterator[Answered]:
    """Yield the answered frames; count them and what was dropped. Raises BadBag where the bag breaks off."""
    for step in steps:
        if isinstance(step, Answered):
            counts[step.status] += 1
            yield step
            continue
        counts.update(step.dropped)
        if step.broken:
            raise BadBag(step.broken)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="replay", description=__doc__)
    parser.add_argument(
        "bag", type=Path, nargs="+", help="folder of a bag; each of several has its own folder of results"
    )
    parser.add_argument("--output", type=Path, default=Path("out/replay"), help="folder for bags, pictures and table")
    parser.add_argument("--workers", type=_workers, default=1, help="processes that answer, 0: one a core")
    parser.add_argument("--method", default=Config().method, help=f"one or several of {','.join(METHODS)}")
    parser.add_argument(
        "--set", action="append", default=[], metavar="PATH=VALUE", help="a parameter, e.g. scale.column_pitch_m=0.045"
    )
    for stream in STREAM_TYPES:
        parser.add_argument(f"--{stream.replace('_', '-')}", help=f"topic of the {stream}; else found by its type")
    return parser


def _config(assignments: list[str]) -> Config:
    """Return the configuration with PATH=VALUE strings applied. Raises ValueError for what cannot be used."""
    config, values = Config(), {}
    for assignment in assignments:
        path, _, text = assignment.partition("=")
        if path not in flatten(config):
            raise ValueError(f"there is no parameter '{path}'")
        values[path] = _value(path, text, type(flatten(config)[path][1]))
    changed: Config = with_values(config, values)
    # What cannot be read ends the program here, not at the first frame.
    known_panel(changed.panel)
    return changed


def _value(path: str, text: str, kind: Any) -> Any:
    """Return the text as a value of that kind. Raises ValueError naming the parameter."""
    if kind is bool:
        if text.lower() not in _TRUE + _FALSE:
            raise ValueError(f"{path} must be true or false, not '{text}'")
        return text.lower() in _TRUE
    try:
        return kind(text)
    except ValueError as error:
        raise ValueError(f"{path} must be {kind.__name__}, not '{text}'") from error


def _workers(text: str) -> int:
    """Return the number of processes. Raises ArgumentTypeError."""
    if not text.isdigit() or int(text) > _MOST_WORKERS:
        raise argparse.ArgumentTypeError(f"must be a number from 0 to {_MOST_WORKERS}, not '{text}'")
    return int(text) or os.cpu_count() or 1


def main(arguments: list[str] | None = None) -> int:
    """Command line: 0 when all bags were replayed, 1 when one broke off, 2 for what cannot be replayed."""
    options = _parser().parse_args(arguments)
    try:
        configs = {m: replace(_config(options.set), method=m) for m in options.method.split(",")}
    except ValueError as error:
        print(f"replay: {error}", file=sys.stderr)
        return 2
    worst = 0
    for bag in options.bag:
        output = options.output if len(options.bag) == 1 else options.output / bag.resolve().name
        worst = max(worst, _replay_bag(bag, output, configs, options))
        if worst == _INTERRUPTED:
            break
    return worst


def _replay_bag(bag: Path, output: Path, configs: dict[str, Config], options: argparse.Namespace) -> int:
    """Replay one bag by all methods and write its report; return the exit code."""
    try:
        topics = find_topics(bag, {stream: getattr(options, stream) for stream in STREAM_TYPES})
    except ValueError as error:
        print(f"replay: {error}", file=sys.stderr)
        return 2
    print(f"topics:   {topics.image}, {topics.camera_info}, {topics.detections}{_others(bag, topics)}")
    code, outputs = 0, {}
    for method, config in configs.items():
        outputs[method] = _free_folder(output / method)
        output.mkdir(parents=True, exist_ok=True)
        try:
            with (output / f"panels_{method}.txt").open("w") as grids:
                print(LEGEND + "\n", file=grids)
                replay(bag, outputs[method], topics, config, grids, options.workers)
            print(f"panels:   {output / f'panels_{method}.txt'}")
        except BadBag as error:
            print(f"replay: {error}", file=sys.stderr)
            code = 1
        except KeyboardInterrupt:
            print("replay: interrupted, what was answered until then is written", file=sys.stderr)
            code = _INTERRUPTED
            break
    # Nothing is written where nothing could be read.
    written = {method: path for method, path in outputs.items() if (path / "metadata.yaml").exists()}
    settings = {f"--set {assignment.partition('=')[0]}": assignment.partition("=")[2] for assignment in options.set}
    write_page(bag, output, write_report(bag, written, output), settings)
    return code


def _others(bag: Path, chosen: InputTopics) -> str:
    """Return what else of the right types is there."""
    taken = {chosen.image, chosen.camera_info, chosen.detections}
    kinds = {kind for several in STREAM_TYPES.values() for kind in several}
    others = [name for name, kind in sorted(recorded_topics(bag).items()) if kind in kinds and name not in taken]
    return f" (there are {', '.join(others)} too: --image, --camera-info, --detections choose)" if others else ""


def _free_folder(path: Path) -> Path:
    """Return the path, or with the first free number behind it: earlier results are kept."""
    number = 1
    free = path
    while free.exists():
        number += 1
        free = path.with_name(f"{path.name}_{number}")
    return free
