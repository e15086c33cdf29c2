"""`python3 -m elevator_rectify PROGRAM`: the package's programs where there is no ros2 command."""

from __future__ import annotations

import importlib
import sys

# Program: module with a main(arguments) function, and what it is for.
PROGRAMS = {
    "node": ("elevator_rectify.ros.node", "the ROS 2 node"),
    "replay": ("elevator_rectify.recordings.replay", "run a bag through the pipeline, offline"),
    "render": ("elevator_rectify.render.bag", "make a bag of rendered panels with their truth"),
    "make_bag": ("elevator_rectify.recordings.make_bag", "make a bag from pictures and a JSON of boxes"),
    "play": ("elevator_rectify.recordings.play", "play a bag into live topics"),
    "benchmark": ("elevator_rectify.benchmark.program", "how right, how honest, how fast: three tables"),
    "calibrate": ("elevator_rectify.calibrate.confidence", "refit the confidence on generated scenes"),
    "latency": ("elevator_rectify.live.latency", "latency and processor time of the live node beside a bare relay"),
    "relay": ("elevator_rectify.live.relay", "the bare relay of the latency table"),
    "soak": ("elevator_rectify.live.soak", "memory, rates and latencies of the live node over many frames"),
    "chaos": ("elevator_rectify.live.chaos", "the live node under everything that goes wrong, its counts checked"),
    "demo": ("elevator_rectify.live.demo", "the live node, fed by a bag over DDS, checked and shown"),
}


def main() -> int:
    """Run the named program with the remaining arguments."""
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name not in PROGRAMS:
        print("usage: python3 -m elevator_rectify PROGRAM ...\n")
        print("\n".join(f"  {program:<10} {meaning}" for program, (_, meaning) in PROGRAMS.items()))
        return 0 if name in ("", "-h", "--help") else 2
    program = importlib.import_module(PROGRAMS[name][0])
    # rclpy wants the full argument list (--ros-args and all), argparse the arguments only.
    return int(program.main(sys.argv[1:] if name in ("node", "relay") else sys.argv[2:]))


if __name__ == "__main__":
    sys.exit(main())
