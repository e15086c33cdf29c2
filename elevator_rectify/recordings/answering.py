"""Every frame of a bag through the node's conversion, pairing and pipeline, on one core or on several.

A bag's frames are answered each by itself, so that the answers do not depend on how many cores there are. Every worker
reads the whole bag, which costs little, and answers every n-th frame.
"""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
import traceback
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2

from elevator_rectify.core.config import Config
from elevator_rectify.core.view.text_grid import text_grid
from elevator_rectify.recordings.topics import InputTopics
from elevator_rectify.ros.answer import answer_frame
from elevator_rectify.ros.bag import TYPESTORE, BadBag, Record, Unreadable, make_bag_message, read_bag
from elevator_rectify.ros.config import NodeConfig, PairingConfig
from elevator_rectify.ros.convert import stamp_ns
from elevator_rectify.ros.output import TOPICS, output_messages
from elevator_rectify.ros.pairing import Frame, Pairing
from elevator_rectify.threads import ONE_THREAD

_SINGLE_IMAGES = NodeConfig(track=False)
# Answers that a worker may be ahead by; looked after a worker so often.
_AHEAD, _PATIENCE_SECONDS = 4, 2.0


@dataclass(frozen=True)
class Answered:
    """One frame: what the node would publish for it, as {topic: serialised message}, and the panel as text."""

    status: str
    stamp_ns: int
    time_ns: int
    grid: str
    messages: dict[str, bytes]


@dataclass(frozen=True)
class Ended:
    """The end of a bag: what was dropped by the pairing, and why it broke off, '' where it did not."""

    dropped: Counter[str] = field(default_factory=Counter)
    broken: str = ""


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


def answers(path: Path, topics: InputTopics, config: Config, workers: int = 1) -> Iterator[Answered | Ended]:
    """Yield the answers to the bag's frames in their order, then its end; the same for any number of workers."""
    return _answers(path, topics, config, 0, 1) if workers == 1 else _by_workers(path, topics, config, workers)


def _answers(path: Path, topics: InputTopics, config: Config, which: int, of: int) -> Iterator[Answered | Ended]:
    """Yield the answers to frames which, which + of ... of the bag, and its end."""
    pairing, broken = Pairing(PairingConfig()), ""
    records = read_bag(path, {topics.image, topics.camera_info, topics.detections})
    frames = paired_frames(records, topics, pairing)
    for number in range(2**63):
        try:
            item = next(frames, None)
        except BadBag as error:
            item, broken = None, str(error)
        if item is None:
            break
        if number % of == which:
            yield _answer(*item, config)
    yield Ended(pairing.dropped + pairing.waiting(), broken)


def _answer(frame: Frame, time_ns: int, config: Config) -> Answered:
    answer, _ = answer_frame(frame, config, node=_SINGLE_IMAGES)
    messages = {
        topic: bytes(TYPESTORE.serialize_cdr(message, TOPICS[topic]))
        for topic, message in output_messages(answer, make_bag_message, TOPICS.__contains__)
    }
    grid = text_grid(answer.buttons) if answer.fit.ok else ""
    return Answered(answer.fit.status, stamp_ns(answer.header), time_ns, grid, messages)


def _by_workers(path: Path, topics: InputTopics, config: Config, workers: int) -> Iterator[Answered | Ended]:
    """Yield what `_answers` does, each frame from the process whose turn it is."""
    context = multiprocessing.get_context("spawn")
    queues = [context.Queue(_AHEAD) for _ in range(workers)]
    # BLAS reads it when it is loaded: the workers are fresh interpreters.
    os.environ.update(ONE_THREAD)
    processes = [
        context.Process(target=_work, args=(path, topics, config, k, workers, queues[k]), daemon=True)
        for k in range(workers)
    ]
    for process in processes:
        process.start()
    try:
        for number in range(2**63):
            step = _next(queues[number % workers], processes[number % workers])
            yield step
            if isinstance(step, Ended):
                return
    finally:
        for process in processes:
            process.terminate()
            process.join()


def _next(steps: Any, process: Any) -> Answered | Ended:
    """Return the worker's next step. Raises RuntimeError where it died, or has a defect."""
    while True:
        try:
            step = steps.get(timeout=_PATIENCE_SECONDS)
        except queue.Empty:
            if process.is_alive():
                continue
            raise RuntimeError(f"a worker ended with code {process.exitcode}") from None
        if isinstance(step, Answered | Ended):
            return step
        raise RuntimeError(f"a worker failed:\n{step}")


def _work(path: Path, topics: InputTopics, config: Config, which: int, of: int, steps: Any) -> None:
    """Answer a share of the frames in a process of its own; Ctrl-C is the parent's."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
    try:
        for step in _answers(path, topics, config, which, of):
            steps.put(step)
    except Exception:
        steps.put(traceback.format_exc())
