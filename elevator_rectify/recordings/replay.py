"""Replays a bag through the node's conversion, pairing and pipeline, offline, without a ROS graph."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, TextIO

from elevator_rectify.core.config import METHODS, Config, flatten, with_values
from elevator_rectify.core.view.text_grid import LEGEND, text_grid
from elevator_rectify.progress import progress
from elevator_rectify.recordings.report import write_report
from elevator_rectify.recordings.topics import OUTPUT_PREFIX, STREAM_TYPES, InputTopics, find_topics, recorded_topics
from elevator_rectify.ros.answer import Answer, answer_frame
from elevator_rectify.ros.bag import (
    BadBag,
    BagWriter,
    Record,
    Unreadable,
    bag_topics,
    bag_writer,
    make_bag_message,
    read_bag,
)
from elevator_rectify.ros.config import NodeConfig, PairingConfig
from elevator_rectify.ros.convert import stamp_ns
from elevator_rectify.ros.output import TOPICS, output_messages
from elevator_rectify.ros.pairing import Frame, Pairing

_TRUE, _FALSE = ("true", "1", "yes", "on"), ("false", "0", "no", "off")
_SINGLE_IMAGES = NodeConfig(track=False)


def paired_frames(records: Iterator[Record], topics: InputTopics, pairing: Pairing) -> Iterator[tuple[Frame, int]]:
    """Feed the records to the pairing as the live node would; yield complete frames and the log time."""
    streams = {
        topics.image: ("image", pairing.add_image),
        topics.camera_info: ("camera_info", pairing.add_camera_info),
        topics.detections: ("detections", pairing.add_detections),
    }
    for record in records:
        stream, add = streams[record.topic]
        try:
            message = record.message
        except Unreadable:
            pairing.add_unreadable(stream)
            continue
        for frame in add(message):
            yield frame, record.time_ns


def replay(path: Path, output: Path, topics: InputTopics, config: Config, grids: TextIO | None = None) -> Counter[str]:
    """Answer every frame of the bag into a new bag; return the counts of statuses and drops.

    grids: where the accepted panels are written as text, each under its image's stamp in ns.

    Raises BadBag where the input breaks off; all answers until there are written.
    """
    wanted = {topics.image, topics.camera_info, topics.detections}
    number = sum(count for name, (_, count) in bag_topics(path).items() if name == topics.detections)
    pairing, counts = Pairing(PairingConfig()), Counter[str]()
    try:
        with bag_writer(output) as bag:
            frames = paired_frames(read_bag(path, wanted), topics, pairing)
            for frame, time_ns in progress(frames, f"replay {config.method}", number):
                answer = _answer_into(bag, frame, config, time_ns)
                counts[answer.fit.status] += 1
                if grids is not None and answer.fit.ok:
                    print(f"{stamp_ns(answer.header)}\n{text_grid(answer.buttons)}\n", file=grids)
    finally:
        counts += pairing.dropped + pairing.waiting()
        print(f"{config.method}: " + ", ".join(f"{n} {name}" for name, n in counts.items()))
    return counts


def _answer_into(bag: BagWriter, frame: Frame, config: Config, time_ns: int) -> Answer:
    """Write everything that the node would publish for the frame; return the answer."""
    answer, _ = answer_frame(frame, config, node=_SINGLE_IMAGES)
    for topic, message in output_messages(answer, make_bag_message, TOPICS.__contains__):
        bag.write(OUTPUT_PREFIX + topic, TOPICS[topic], message, time_ns)
    return answer


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="replay", description=__doc__)
    parser.add_argument("bag", type=Path, help="folder of the bag")
    parser.add_argument("--output", type=Path, default=Path("out/replay"), help="folder for bags, pictures and table")
    parser.add_argument("--method", default=Config().method, help=f"one or several of {','.join(METHODS)}")
    parser.add_argument(
        "--set", action="append", default=[], metavar="PATH=VALUE", help="a parameter, e.g. scale.column_pitch_m=0.045"
    )
    for stream in STREAM_TYPES:
        parser.add_argument(f"--{stream.replace('_', '-')}", help=f"topic of the {stream}; else found by its type")
    return parser


def _config(assignments: list[str]) -> Config:
    """Return the configuration with PATH=VALUE strings applied."""
    config, values = Config(), {}
    for assignment in assignments:
        path, _, text = assignment.partition("=")
        if path not in flatten(config):
            raise ValueError(f"there is no parameter '{path}'")
        values[path] = _value(path, text, type(flatten(config)[path][1]))
    changed: Config = with_values(config, values)
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


def main(arguments: list[str] | None = None) -> int:
    """Command line: 0 when the whole bag was replayed, 1 when it broke off, 2 for what cannot be replayed."""
    options = _parser().parse_args(arguments)
    try:
        methods = options.method.split(",")
        configs = {method: replace(_config(options.set), method=method) for method in methods}
        topics = find_topics(options.bag, {stream: getattr(options, stream) for stream in STREAM_TYPES})
    except ValueError as error:
        print(f"replay: {error}", file=sys.stderr)
        return 2
    print(f"topics:   {topics.image}, {topics.camera_info}, {topics.detections}{_others(options.bag, topics)}")
    code, outputs = 0, {}
    for method, config in configs.items():
        outputs[method] = _free_folder(options.output / method)
        options.output.mkdir(parents=True, exist_ok=True)
        try:
            with (options.output / f"panels_{method}.txt").open("w") as grids:
                print(LEGEND + "\n", file=grids)
                replay(options.bag, outputs[method], topics, config, grids)
            print(f"panels:   {options.output / f'panels_{method}.txt'}")
        except BadBag as error:
            print(f"replay: {error}", file=sys.stderr)
            code = 1
        except KeyboardInterrupt:
            print("replay: interrupted, what was answered until then is written", file=sys.stderr)
            code = 130
            break
    # Nothing is written where nothing could be read.
    write_report(
        options.bag,
        {method: path for method, path in outputs.items() if (path / "metadata.yaml").exists()},
        options.output,
    )
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
