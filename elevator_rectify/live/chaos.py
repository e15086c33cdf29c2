"""Drives the live node for minutes with everything that goes wrong, and checks every outcome and the counters."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from elevator_rectify.arguments import add_bag, add_domain, bag_or_sample, positive
from elevator_rectify.core import fit_panel
from elevator_rectify.core.geometry.rotations import rotation_angle_rad
from elevator_rectify.live.acts import NOTHING, POSE, REFUSED, Script
from elevator_rectify.live.driver import Driver, driven
from elevator_rectify.live.frames import Frames
from elevator_rectify.live.goals import asking
from elevator_rectify.progress import progress
from elevator_rectify.recordings.report import pose_of_message
from elevator_rectify.ros.config import DEFAULT_NODE

_N = "/elevator_rectify/"
_LISTEN = {
    _N + "status": ("diagnostic_msgs/msg/DiagnosticStatus", True),
    _N + "panel_pose": ("geometry_msgs/msg/PoseWithCovarianceStamped", True),
    _N + "rectified/image": ("sensor_msgs/msg/Image", False),
    "/diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", True),
}
# A tracked and smoothed pose against the single image's: the noise of one is below this.
_WRONG_RAD = float(np.deg2rad(8.0))
_NODE = [sys.executable, "-m", "elevator_rectify", "node", "--ros-args", "-p", "scale.column_pitch_m:=0.045"]


def run(frames: Frames, seconds: float, seed: int, compressed: bool, domain: int) -> list[str]:
    """Play acts for so long; return what went wrong."""
    image = "image/compressed" if compressed else "image"
    inputs = {
        image: "sensor_msgs/msg/CompressedImage" if compressed else "sensor_msgs/msg/Image",
        "camera_info": "sensor_msgs/msg/CameraInfo",
        "detections": "geometry_msgs/msg/PoseArray",
    }
    driver = Driver(domain, _LISTEN, inputs)
    script = Script(driver, frames, np.random.default_rng(seed), compressed)
    command = [*_NODE, "-p", f"image_transport:={'compressed' if compressed else 'raw'}"]
    try:
        with driven(command, driver, domain), asking(domain, seed) as goals:
            title, begin = f"chaos {'compressed' if compressed else 'raw'}", time.monotonic()
            for second in progress(range(1, int(seconds) + 1), title):
                while time.monotonic() - begin < second:
                    script.play()
            driver.spin(4.0)
    finally:
        driver.close()
    print(", ".join(f"{n} {name}" for name, n in sorted(script.acts.items())))
    if goals.ended:
        print("goals: " + ", ".join(f"{n} {name}" for name, n in sorted(goals.ended.items())))
    return [*wrong_outcomes(script), *wrong_counts(script), *goals.without_result]


def wrong_outcomes(script: Script) -> list[str]:
    """Return the frames of which something else came than had to."""
    statuses, poses = (script.driver.messages[_N + topic] for topic in ("status", "panel_pose"))
    counts, wrong = Counter[str](), list[str]()
    for stamp, expected in script.expected.items():
        came = [message.message.split(":")[0] for message in statuses.get(stamp, [])]
        counts[f"{expected}: {', '.join(came) or 'nothing'}"] += 1
        posed = len(poses.get(stamp, []))
        skipped = came == ["skipped"] and not posed and _overtaken(script, stamp)
        right = {
            POSE: (came == ["ok"] and posed == 1) or skipped,
            REFUSED: len(came) == 1 and came != ["ok"] and not posed,
            NOTHING: not came and not posed,
        }[expected]
        if not right:
            wrong.append(f"stamp {stamp}: {expected} expected; statuses {came}, {posed} poses")
        elif posed and (angle := _angle(script, stamp, poses[stamp][0])) > _WRONG_RAD:
            wrong.append(f"stamp {stamp}: the pose is {np.rad2deg(angle):.1f} degrees from the single image's")
    print("\n".join(f"{n:>7}  {name}" for name, n in sorted(counts.items())))
    return wrong


def _overtaken(script: Script, stamp: int) -> bool:
    """Tell whether so many newer frames had been sent when a frame was skipped that the queue was full of them."""
    sent, skipped = script.sent_at[stamp], script.driver.answers.arrived[_N + "status"][stamp]
    newer = sum(sent < at <= skipped for other, at in script.sent_at.items() if script.expected[other] != NOTHING)
    return newer >= DEFAULT_NODE.max_waiting


def _angle(script: Script, stamp: int, message: Any) -> float:
    """Return the angle between the published pose and that of the frame alone."""
    centres = script.shown[stamp]
    alone = fit_panel(centres, script.frames.views[0].camera)
    for view in script.frames.views:
        if len(view.centres_px) == len(centres) and np.abs(view.centres_px - centres).max() < 5.0:
            alone = fit_panel(centres, view.camera)
    R, _ = pose_of_message(message.pose.pose)
    return rotation_angle_rad(R.T @ alone.R_camera_panel)


def wrong_counts(script: Script) -> list[str]:
    """Return where the node's last counters do not add up to what was sent and answered."""
    last = script.driver.answers.last["/diagnostics"]
    values = {pair.key: pair.value for pair in last.status[0].values}

    def total(*starts: str) -> int:
        return sum(int(v) for k, v in values.items() if k.startswith(starts) and not k.endswith("per second"))

    wrong = []
    for name in ("image", "detections"):
        received, booked = int(values[f"{name} received"]), total("frames ", f"dropped {name}", f"{name} waiting")
        print(f"{name}: {script.sent[name]} sent, {received} received = {booked} answered, dropped or waiting")
        if received != booked:
            wrong.append(f"{name}: {received} received, {booked} booked")
        if received != script.sent[name]:
            wrong.append(f"{name}: {script.sent[name]} sent, {received} received")
    came = Counter(m.message.split(":")[0] for s in script.driver.messages[_N + "status"].values() for m in s)
    booked_by_status = {k.removeprefix("frames "): int(v) for k, v in values.items() if _is_count(k)}
    if dict(came) != booked_by_status:
        wrong.append(f"statuses published {dict(came)}, booked {booked_by_status}")
    return wrong


def _is_count(key: str) -> bool:
    return key.startswith("frames ") and not key.endswith("per second")


def main(arguments: list[str] | None = None) -> int:
    """Play raw and compressed images; 1 where anything went wrong."""
    parser = argparse.ArgumentParser(prog="chaos", description=__doc__)
    add_bag(parser)
    parser.add_argument("--minutes", type=positive, default=2.0, help="half with raw, half with compressed images")
    parser.add_argument("--seed", type=int, default=0, help="of the order of what goes wrong")
    add_domain(parser, 83)
    options = parser.parse_args(arguments)
    try:
        frames, wrong = Frames(Path(bag_or_sample(options.bag))), list[str]()
    except (ValueError, FileNotFoundError) as error:
        print(f"chaos: {error}", file=sys.stderr)
        return 2
    for compressed in (False, True):
        wrong += run(frames, 30.0 * options.minutes, options.seed + compressed, compressed, options.domain)
    print("\n".join([f"{len(wrong)} things went wrong", *wrong[:20]]))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
