"""Latency and processor time of the node beside a bare relay, over DDS, in one run."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from elevator_rectify.arguments import add_domain, add_load, bag_or_sample
from elevator_rectify.live.driver import Driver, cpu_seconds, driven
from elevator_rectify.live.frames import Frames
from elevator_rectify.progress import progress

_PYTHON = [sys.executable, "-m", "elevator_rectify"]
_NODE = [*_PYTHON, "node", "--ros-args", "-p", "scale.column_pitch_m:=0.045"]
_IMAGE = ("sensor_msgs/msg/Image", False)
_POSE = ("geometry_msgs/msg/PoseWithCovarianceStamped", False)
_STATUS = ("diagnostic_msgs/msg/DiagnosticStatus", True)
_N = "/elevator_rectify/"
# Who runs, what is listened to, and which topic's arrival is the answer; the first row is the yardstick.
RUNS = {
    "relay": ([*_PYTHON, "relay"], {"/relay/image": _IMAGE}, "/relay/image"),
    "node": (
        _NODE,
        {_N + "panel_pose": _POSE, _N + "rectified/image": _IMAGE, _N + "status": _STATUS},
        _N + "panel_pose",
    ),
    "node, no picture": (_NODE, {_N + "panel_pose": _POSE, _N + "status": _STATUS}, _N + "panel_pose"),
}


@dataclass(frozen=True)
class Row:
    """One run: share of frames answered, milliseconds from publishing to the answer, share of one processor."""

    answered: float
    latency_ms: np.ndarray[tuple[int], np.dtype[np.float64]]
    cpu: float


def measure(name: str, frames: Frames, number: int, rate: float, domain: int) -> Row:
    """Drive one run at a steady rate."""
    command, listen, answer = RUNS[name]
    inputs = {"image": "sensor_msgs/msg/Image"} if name == "relay" else None
    driver, sent = Driver(domain, listen, inputs), dict[int, float]()
    try:
        with driven(command, driver, domain) as pid:
            begin_cpu, begin = cpu_seconds(pid), time.perf_counter()
            for k in progress(range(number), name):
                stamp = time.time_ns()
                sent[stamp] = driver.send(frames.messages(k, stamp))
                driver.spin(begin + (k + 1) / rate - time.perf_counter())
            seconds, cpu = time.perf_counter() - begin, cpu_seconds(pid) - begin_cpu
            # The status comes last.
            last = answer if name == "relay" else _N + "status"
            driver.catch_up(last, sent)
    finally:
        driver.close()
    arrived = driver.answers.arrived[last]
    times = driver.answers.arrived[answer]
    latency = np.array([1e3 * (times[stamp] - begin) for stamp, begin in sent.items() if stamp in times])
    return Row(sum(stamp in arrived for stamp in sent) / number, latency, cpu / seconds)


def table(rows: dict[str, Row]) -> str:
    """Return the table, with ratios to the first row."""
    first = next(iter(rows.values()))
    lines = [f"{'':<18}{'answered':>9}{'med ms':>8}{'p95 ms':>8}{'p95/relay':>10}{'cpu':>7}{'cpu/relay':>10}"]
    p95 = np.percentile(first.latency_ms, 95)
    for name, row in rows.items():
        median, high = np.percentile(row.latency_ms, [50, 95]) if len(row.latency_ms) else (np.nan, np.nan)
        lines.append(
            f"{name:<18}{row.answered:>9.4f}{median:>8.1f}{high:>8.1f}{high / p95:>10.2f}"
            f"{row.cpu:>7.2f}{row.cpu / first.cpu:>10.2f}"
        )
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Print the table; 1 where the node left a frame without an answer."""
    parser = argparse.ArgumentParser(prog="latency", description=__doc__)
    add_load(parser, 900)
    add_domain(parser, 81)
    options = parser.parse_args(arguments)
    try:
        frames = Frames(Path(bag_or_sample(options.bag)), *options.size)
    except (ValueError, FileNotFoundError) as error:
        print(f"latency: {error}", file=sys.stderr)
        return 2
    rows = {name: measure(name, frames, options.frames, options.rate, options.domain) for name in RUNS}
    print(f"{options.size[0]}x{options.size[1]} at {options.rate:g} Hz, {options.frames} frames a run")
    print(table(rows))
    return 0 if all(row.answered == 1.0 for row in rows.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
