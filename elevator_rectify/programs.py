"""The package's programs by name: for `ros2 run`, for `python3 -m elevator_rectify`, for `elevator-rectify`."""

from __future__ import annotations

import errno
import importlib
import os
import sys
from collections.abc import Callable
from functools import partial

from elevator_rectify.threads import ONE_THREAD

# Program: module with a main(arguments) function, and what it is for.
PROGRAMS = {
    "node": ("elevator_rectify.ros.node", "the ROS 2 node"),
    "lifecycle_node": ("elevator_rectify.ros.lifecycle", "the node as a managed node"),
    "detector": ("elevator_rectify.ros.detector", "our own detector alone, as a node"),
    "look": ("elevator_rectify.recordings.look", "find and read the panel in photographs"),
    "teach": ("elevator_rectify.recordings.teach", "teach a panel from photographs or a bag"),
    "calibrate_camera": ("elevator_rectify.recordings.calibrate_camera", "calibrate a camera by a panel"),
    "replay": ("elevator_rectify.recordings.replay", "run a bag through the pipeline, offline"),
    "render": ("elevator_rectify.render.bag", "make a bag of rendered panels with their truth"),
    "make_bag": ("elevator_rectify.recordings.make_bag", "make a bag from pictures and a JSON of boxes"),
    "play": ("elevator_rectify.recordings.play", "play a bag into live topics"),
    "demo": ("elevator_rectify.live.demo", "the live node, fed by a bag over DDS, checked and shown"),
    "press": ("elevator_rectify.live.press", "a rendered press: the live node finds a button and sees its lamp go on"),
    "benchmark": ("elevator_rectify.benchmark.program", "success rate, calibration, time: rendered and real panels"),
    "calibrate": ("elevator_rectify.calibrate.confidence", "refit the confidence on generated scenes"),
    "latency": ("elevator_rectify.live.latency", "latency and processor time of the live node beside a bare relay"),
    "relay": ("elevator_rectify.live.relay", "the bare relay of the latency table"),
    "soak": ("elevator_rectify.live.soak", "memory, rates and latencies of the live node over many frames"),
    "chaos": (
        "elevator_rectify.live.chaos",
        "the live node under all that goes wrong, its counts and its clients' goals checked",
    ),
}
# rclpy wants the full argument list (--ros-args and all), argparse the arguments only.
_WHOLE_COMMAND = ("node", "lifecycle_node", "detector", "relay")
# What is wrong with a disk, or with the rights on it, and not with a program.
_UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EPERM, errno.EROFS)
# Packages that some programs need, and how to get them.
_PACKAGES = {
    "rosbags": "reads and writes bags: pip install rosbags",
    "rclpy": "is ROS 2's: source ROS 2, or pip install 'ros-jazzy-rclpy[fastrtps]' ros-jazzy-common-interfaces",
}


def run(name: str, command: list[str] | None = None) -> int:
    """Run a program with a command line (sys.argv); return its exit code.

    It is 3 where a package is missing, 1 where nothing can be written.
    """
    command = sys.argv if command is None else command
    for variable, number in ONE_THREAD.items():
        os.environ.setdefault(variable, number)
    try:
        program = importlib.import_module(PROGRAMS[name][0])
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in _PACKAGES:
            raise
        print(f"{name} needs the Python package {package}, which {_PACKAGES[package]}", file=sys.stderr)
        return 3
    try:
        return int(program.main(command if name in _WHOLE_COMMAND else command[1:]))
    except OSError as error:
        if error.errno not in _UNWRITABLE:
            raise
        where = f" {error.filename}" if error.filename else ""
        print(f"{name}: cannot write{where}: {error.strerror}; what was written before may be cut off", file=sys.stderr)
        return 1


def main() -> int:
    """Run the program that the first argument names with the remaining arguments."""
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name not in PROGRAMS:
        print("usage: elevator-rectify PROGRAM ... (or python3 -m elevator_rectify, ros2 run elevator_rectify)\n")
        print("\n".join(f"  {program:<10} {meaning}" for program, (_, meaning) in PROGRAMS.items()))
        print("\nPROGRAM --help tells a program's arguments")
        return 0 if name in ("", "-h", "--help") else 2
    return run(name, sys.argv[1:])


def __getattr__(name: str) -> Callable[[], int]:
    """Return the entry point of a program, as setup.py names it."""
    if name not in PROGRAMS:
        raise AttributeError(name)
    return partial(run, name)
