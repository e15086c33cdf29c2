"""The live node over many frames: resident memory, rates and latencies over time. Memory must stay flat."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from elevator_rectify.arguments import add_domain, add_load, bag_or_sample
from elevator_rectify.live.driver import Driver, driven, resident_megabytes
from elevator_rectify.live.frames import Frames
from elevator_rectify.live.latency import RUNS
from elevator_rectify.progress import progress

_ROWS = 10
_STATUS, _POSE = "/elevator_rectify/status", "/elevator_rectify/panel_pose"
# Growth after the first tenth is answered, not only sent: the first answers fill buffers and caches.
_FLAT_MEGABYTES = 20.0
HEADER = f"{'frames':>8}{'memory MB':>11}{'answered':>10}{'Hz':>7}{'med ms':>8}{'p95 ms':>8}"


def main(arguments: list[str] | None = None) -> int:
    """Print a row for every tenth; 1 where memory grew or a frame was left without an answer."""
    parser = argparse.ArgumentParser(prog="soak", description=__doc__)
    add_load(parser, 20000)
    add_domain(parser, 82)
    options = parser.parse_args(arguments)
    try:
        frames = Frames(Path(bag_or_sample(options.bag)), *options.size)
    except (ValueError, FileNotFoundError) as error:
        print(f"soak: {error}", file=sys.stderr)
        return 2
    command, listen, _ = RUNS["node"]
    driver, memory, sent = Driver(options.domain, listen), list[float](), dict[int, float]()
    print(HEADER, flush=True)
    try:
        with driven(command, driver, options.domain) as pid:
            begin, at = time.perf_counter(), time.perf_counter()
            for k in progress(range(options.frames), "soak"):
                stamp = time.time_ns()
                sent[stamp] = driver.send(frames.messages(k, stamp))
                driver.spin(begin + (k + 1) / options.rate - time.perf_counter())
                if (k + 1) % max(1, options.frames // _ROWS) == 0:
                    if not memory:
                        driver.catch_up(_STATUS, sent)
                    memory.append(resident_megabytes(pid))
                    tenth = dict(list(sent.items())[-(options.frames // _ROWS) :])
                    print(_row(k + 1, memory[-1], driver, tenth, time.perf_counter() - at), flush=True)
                    at = time.perf_counter()
            driver.catch_up(_STATUS, sent)
    finally:
        driver.close()
    answered = sum(stamp in driver.answers.arrived[_STATUS] for stamp in sent)
    grown = max(memory) - memory[0]
    print(f"{answered} of {len(sent)} frames answered; memory grew by {grown:.1f} MB after the first tenth")
    return 0 if answered == len(sent) and grown < _FLAT_MEGABYTES else 1


def _row(frames: int, megabytes: float, driver: Driver, sent: dict[int, float], seconds: float) -> str:
    """Return the line of one tenth, in which `sent` was sent."""
    poses = driver.answers.arrived[_POSE]
    latency = [1e3 * (poses[stamp] - begin) for stamp, begin in sent.items() if stamp in poses]
    median, high = np.percentile(latency, [50, 95]) if latency else (np.nan, np.nan)
    answered = sum(stamp in driver.answers.arrived[_STATUS] for stamp in sent)
    return f"{frames:>8}{megabytes:>11.1f}{answered:>10}{len(sent) / seconds:>7.1f}{median:>8.1f}{high:>8.1f}"


if __name__ == "__main__":
    sys.exit(main())
