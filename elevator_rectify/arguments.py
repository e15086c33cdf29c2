"""Arguments that several programs have, with their checks: a wrong value is one line of argparse, never a traceback."""

from __future__ import annotations

import argparse
import math

from elevator_rectify.share import share_file

SAMPLE_BAG = "bags/paper_5x5"


def positive(text: str) -> float:
    """Return a number above 0."""
    number = float(text)
    if not 0.0 < number < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return number


def count(text: str) -> int:
    """Return a whole number from 1 on."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text} is not 1 or more")
    return number


def domain(text: str) -> int:
    """Return a ROS_DOMAIN_ID."""
    number = int(text)
    if not 0 <= number <= 101:
        raise argparse.ArgumentTypeError(f"{text} is not in 0 to 101")
    return number


def size(text: str) -> tuple[int, int]:
    """Return width and height of a text such as 640x480."""
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit() and min(int(width), int(height)) > 0):
        raise argparse.ArgumentTypeError(f"'{text}' is not of the form WIDTHxHEIGHT, such as 640x480")
    return int(width), int(height)


def add_bag(parser: argparse.ArgumentParser, name: str = "--bag") -> None:
    """Add the bag whose pictures and detections are shown to a live node: the sample bag where none is named."""
    parser.add_argument(name, nargs="?", help="bag with camera and detections; default: the sample bag")


def bag_or_sample(path: str | None) -> str:
    """Return the path that was given, or the sample bag's. Raises FileNotFoundError where that is not installed."""
    return path or str(share_file(SAMPLE_BAG))


def add_load(parser: argparse.ArgumentParser, frames: int) -> None:
    """Add how much is sent to a live node: bag, frames, rate and size."""
    add_bag(parser)
    parser.add_argument("--frames", type=count, default=frames, help="frames that are sent in a run")
    parser.add_argument("--rate", type=positive, default=30.0, help="frames a second")
    parser.add_argument("--size", type=size, default=(640, 480), help="WIDTHxHEIGHT of the pictures, e.g. 1920x1080")


def add_domain(parser: argparse.ArgumentParser, default: int) -> None:
    """Add the ROS_DOMAIN_ID of the program's own graph."""
    parser.add_argument("--domain", type=domain, default=default, help="ROS_DOMAIN_ID of the graph of its own")
