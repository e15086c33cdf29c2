"""A press from beginning to end, rendered: find the button, press it with a finger, and ask whether its lamp went on.

The node runs in its own process, with our own detector and reader: pictures in, answers out.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Generator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rclpy.action import ActionClient

from elevator_rectify.arguments import add_domain
from elevator_rectify.core.types import Image
from elevator_rectify.live.driver import Driver, driven
from elevator_rectify.live.frames import header
from elevator_rectify.recordings.report import tiled
from elevator_rectify.render.overpaint import with_finger
from elevator_rectify.render.panel import Panel, paper_panels
from elevator_rectify.render.photograph import photograph
from elevator_rectify.render.scene import (
    DetectorModel,
    Scene,
    Viewpoint,
    box_sizes_px,
    camera_pose,
    detected,
    paper_camera,
)
from elevator_rectify.ros.goals import action
from elevator_rectify.ros.messages import make_ros
from elevator_rectify.ros.output import camera_info_message, image_message

_STATUS = "/elevator_rectify/status"
_INPUTS = {"image": "sensor_msgs/msg/Image", "camera_info": "sensor_msgs/msg/CameraInfo"}
_NODE = "node --ros-args -p scale.column_pitch_m:=0.045 -p detector:=own".split()  # noqa: SIM905
_PERIOD_SECONDS, _FIND_SECONDS, _CONFIRM_SECONDS = 0.25, 20.0, 8.0
# How far the finger's tip is off the button when it comes, while it presses, and when it goes, in the button's sizes;
# the lamp goes on when it touches.
_COMES, _PRESSES, _GOES = (4.0, 1.5), (0.0, 0.0, 0.0), (1.5, 4.0)
_VIEW = Viewpoint(np.deg2rad(25.0), 1.2, np.deg2rad(3.0), 0.75)
_NOISE = 1.5
_STRIP_HEIGHT_PX, _STRIP_COLUMNS = 240, 5


@dataclass
class Robot:
    """Shows rendered pictures of a panel to a live node, and asks it for a button of that panel."""

    driver: Driver
    panel: Panel
    label: str
    seed: int
    shown: list[Image] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Place the camera, and take the panel's picture with the lamp dark and lit."""
        camera, self._rng = paper_camera(), np.random.default_rng(self.seed)
        pose = camera_pose(self.panel, camera, _VIEW)
        self._scene = detected(self.panel, camera, *pose, DetectorModel(0.0), self._rng)
        at = next(k for k, button in enumerate(self.panel.buttons) if button.label == self.label)
        size = box_sizes_px(self.panel, camera, *pose)[at]
        self._box_px = np.concatenate([self._scene.pixels[at] - size / 2, self._scene.pixels[at] + size / 2])
        self._dark = self._picture(self._scene)
        self._lit = self._picture(replace(self._scene, panel=replace(self.panel, lit=frozenset({at}))))

    def _picture(self, scene: Scene) -> Image:
        """Return the picture without noise of its own: all but the lamp is the same in every one."""
        return photograph(scene, np.random.default_rng(self.seed))

    def show(self, lit: bool, off: float | None = None) -> None:
        """Publish one frame; off: how far the finger's tip is off the button, None for no finger."""
        clean = self._lit if lit else self._dark
        if off is not None:
            clean = with_finger(clean, self._box_px, np.random.default_rng(self.seed), off)
        noisy = np.clip(clean + self._rng.normal(0.0, _NOISE, clean.shape), 0, 255).astype(np.uint8)
        head = header(time.time_ns())
        info = camera_info_message(self._scene.camera, np.eye(3), head, make_ros)
        self.driver.send({"camera_info": info, "image": image_message(noisy, head, make_ros)})
        self.shown.append(noisy)
        self.driver.spin(_PERIOD_SECONDS)

    def ask(self, client: Any, kind: Any, timeout_s: float) -> Generator[None, None, Any]:
        """Send a goal, then yield until it is answered; the answer is the generator's value."""
        sent = client.send_goal_async(kind.Goal(label=self.label, timeout_s=timeout_s))
        while not sent.done():
            yield
        got = sent.result().get_result_async()
        while not got.done():
            yield
        return got.result().result

    def press(self, works: bool) -> tuple[Any, Any]:
        """Find the button, press it, ask; return both results. works: whether the lamp goes on."""
        kinds = [action(name) for name in ("FindButton", "ConfirmPress")]
        topics = ("/elevator_rectify/find_button", "/elevator_rectify/confirm_press")
        clients = [ActionClient(self.driver.node, *pair) for pair in zip(kinds, topics, strict=True)]
        for client in clients:
            while not client.server_is_ready():
                self.driver.spin(0.1)
        steps = [(False, off) for off in _COMES] + [(works, off) for off in (*_PRESSES, *_GOES)]
        found = self._until(self.ask(clients[0], kinds[0], _FIND_SECONDS), [], False)
        confirming = self.ask(clients[1], kinds[1], _CONFIRM_SECONDS)
        result = self._until(confirming, steps, works) if found.status == "found" else None
        for client in clients:
            client.destroy()
        return found, result

    def _until(self, asking: Any, steps: list[tuple[bool, float]], lit: bool) -> Any:
        """Show the steps, then the panel with its lamp lit or dark, until the goal is answered."""
        while True:
            try:
                next(asking)
            except StopIteration as answered:
                return answered.value
            self.show(*(steps.pop(0) if steps else (lit, None)))


def strip(pictures: list[Image]) -> Image:
    """Return the pictures in rows, in their order."""
    width = round(_STRIP_HEIGHT_PX * pictures[0].shape[1] / pictures[0].shape[0])
    small = [cv2.resize(p, (width, _STRIP_HEIGHT_PX), interpolation=cv2.INTER_AREA) for p in pictures]
    return tiled(small, _STRIP_COLUMNS)


def main(arguments: list[str] | None = None) -> int:
    """Command line: press a button; 0 where the lamp was told as it was."""
    parser = argparse.ArgumentParser(prog="press", description=__doc__)
    parser.add_argument("--label", default="7", help="the button to press, of a panel with floors 1 to 18")
    parser.add_argument("--broken", action="store_true", help="the button's lamp stays dark")
    parser.add_argument("--strip", type=Path, help="file for the pictures that the node saw, beside each other")
    parser.add_argument("--seed", type=int, default=3)
    add_domain(parser, 73)
    options = parser.parse_args(arguments)
    if action("ConfirmPress") is None:
        print("press: the package elevator_rectify_interfaces is not installed beside this one", file=sys.stderr)
        return 2
    panel = replace(paper_panels()[0], lit=frozenset())
    if options.label not in {button.label for button in panel.buttons}:
        print(f"press: there is no button {options.label}", file=sys.stderr)
        return 2
    driver = Driver(options.domain, {_STATUS: ("diagnostic_msgs/msg/DiagnosticStatus", False)}, _INPUTS)
    robot = Robot(driver, panel, options.label, options.seed)
    try:
        with driven([sys.executable, "-m", "elevator_rectify", *_NODE], driver, options.domain):
            found, pressed = robot.press(works=not options.broken)
    finally:
        driver.close()
    if options.strip is not None:
        cv2.imwrite(str(options.strip), strip(robot.shown))
    lamp = f"lit: {found.lit} ({found.lit_probability:.3f})" if found.status == "found" else found.reason
    print(f"find_button {options.label}: {found.status} after {found.frames} frames, {lamp}")
    if pressed is None:
        return 1
    print(f"confirm_press {options.label}: {pressed.status}, probability {pressed.probability:.3f}, {pressed.reason}")
    return int(pressed.status != ("not_lit" if options.broken else "confirmed"))


if __name__ == "__main__":
    sys.exit(main())
