"""The actions find_button and confirm_press over real DDS: goals, feedback, results, and all that may be wrong."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.action import ActionClient

from elevator_rectify.live import press
from elevator_rectify.ros.goals import action
from elevator_rectify.ros.poses import rotation_of
from test.harness import ENVIRONMENT, PREFIX, ROOT, Harness, start, stop
from test.messages import vision_detections
from test.stand_ins import tf2_ros
from test.test_live import TRUTH, frame, live

INTERFACE, CONFIRM = action("FindButton"), action("ConfirmPress")
pytestmark = pytest.mark.skipif(
    INTERFACE is None, reason="elevator_rectify_interfaces is not installed: make test builds it"
)
VISION = {"detections": "vision_msgs/msg/Detection2DArray"}
LABELS = [d.label for d in TRUTH.detections]
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


class Client:
    """Asks a node for buttons and presses."""

    def __init__(self, harness: Harness) -> None:
        self.harness, self.stamp = harness, 0
        self._client = ActionClient(harness.node, INTERFACE, PREFIX + "find_button")
        self._confirm = ActionClient(harness.node, CONFIRM, PREFIX + "confirm_press")
        assert harness.until(lambda: self._client.server_is_ready() and self._confirm.server_is_ready())

    def close(self) -> None:
        """Leave the graph before the node does: a client that is left keeps its participant alive."""
        self._client.destroy()
        self._confirm.destroy()

    def ask(self, label: str, **goal: Any) -> tuple[Any, list[Any]]:
        """Return the handle of an accepted goal, and the list that its feedback goes to."""
        return self._ask(self._client, INTERFACE.Goal(label=label, **{"timeout_s": 20.0, **goal}))

    def confirm(self, label: str, timeout_s: float = 20.0) -> tuple[Any, list[Any]]:
        """The same for the press of a button."""
        return self._ask(self._confirm, CONFIRM.Goal(label=label, timeout_s=timeout_s))

    def _ask(self, client: Any, asked: Any) -> tuple[Any, list[Any]]:
        feedback: list[Any] = []
        sent = client.send_goal_async(asked, feedback_callback=lambda m: feedback.append(m.feedback))
        assert self.harness.until(sent.done)
        assert sent.result().accepted
        return sent.result(), feedback

    def frames(self, number: int, shift_px: float = 0.0) -> None:
        for _ in range(number):
            self.stamp += 1
            centres = TRUTH.centres_px + shift_px * self.stamp
            self.harness.send(**frame(self.stamp, detections=vision_detections(self.stamp, centres, LABELS)))
            assert self.harness.answered(self.stamp)

    def result(self, handle: Any) -> tuple[int, Any]:
        got = handle.get_result_async()
        assert self.harness.until(got.done, 10.0)
        return got.result().status, got.result().result


def test_a_goal_ends_with_the_node() -> None:
    with live(inputs=VISION) as (process, harness):
        assert harness.until(harness.connected)
        asking = Client(harness)
        (goal, _), other = asking.ask("7"), asking.ask("9")[0]
        waiting = [handle.get_result_async() for handle in (goal, other)]
        harness.until(lambda: False, 0.5)
        stop(process)
        assert harness.until(lambda: all(w.done() for w in waiting), 5.0)
        for got in waiting:
            assert (got.result().status, got.result().result.status) == (ABORTED, INTERFACE.Result.ENDED)
        asking.close()


def test_poses_come_in_the_frame_that_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ENVIRONMENT, "PYTHONPATH", str(Path(tf2_ros.__file__).parent))
    with live("-p", "detections.numbers_are_labels:=true", "-p", "measure:=false", inputs=VISION) as (process, harness):
        assert harness.until(harness.connected)
        asking = Client(harness)
        results = []
        for frame_id in ("", "map"):
            handle, _ = asking.ask("7", agreeing=1, of=1, frame_id=frame_id)
            asking.frames(1)
            status, result = asking.result(handle)
            assert status == SUCCEEDED and result.pose.header.frame_id == (frame_id or "camera")
            results.append(result)
        R, t = rotation_of(*tf2_ros.QUATERNION), np.array(tf2_ros.TRANSLATION)
        for kind in ("pose", "standoff"):
            in_camera, in_map = (getattr(result, kind) for result in results)
            # The second frame is smoothed by the first one, the detections are the same.
            assert np.linalg.norm(place(in_map) - (R @ place(in_camera) + t)) < 1e-4
        asking.close()
        stop(process)


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    process: subprocess.Popen[str] = start("-p", "detections.numbers_are_labels:=true", "-p", "measure:=false")
    harness = Harness(VISION)
    try:
        assert harness.until(harness.connected)
        asking = Client(harness)
        yield asking
        asking.close()
        stop(process)
    finally:
        harness.close()
        if process.poll() is None:
            process.kill()
        process.wait()


def place(pose: Any) -> Any:
    at = pose.pose.pose.position
    return np.array([at.x, at.y, at.z])


def test_a_goal_is_answered_once_enough_frames_agree(client: Client) -> None:
    handle, feedback = client.ask("7", agreeing=3, of=4)
    client.frames(2)
    assert client.harness.until(lambda: len(feedback) == 2)
    assert (feedback[1].status, feedback[1].frames, feedback[1].found) == ("found", 2, 2)
    client.frames(1)
    status, result = client.result(handle)
    assert (status, result.status, result.frames, result.agreed) == (SUCCEEDED, "found", 3, 3)
    seven = next(k for k, button in enumerate(TRUTH.panel.buttons) if button.label == "7")
    truth = TRUTH.R_camera_panel @ TRUTH.panel.points_m[seven] + TRUTH.t_camera_panel
    assert np.linalg.norm(place(result.pose) - truth) < 0.03 * np.linalg.norm(truth)
    assert np.linalg.norm(place(result.pose) - place(result.standoff)) == pytest.approx(0.1)
    assert result.pose.header.frame_id == "camera" and result.pose.header.stamp.nanosec > 0
    covariance = np.array(result.pose.pose.covariance).reshape(6, 6)
    assert (np.linalg.eigvalsh(covariance) > 0).all()
    assert 0.9 < result.label_probability <= 1.0
    # These detections come with black pictures: grey says nothing of lamps.
    assert result.lit == "unseen" and np.isnan(result.lit_probability)


def test_a_label_that_is_not_there_is_refused_after_the_last_frame(client: Client) -> None:
    handle, _ = client.ask("99", agreeing=2, of=3)
    client.frames(3)
    status, result = client.result(handle)
    assert (status, result.status) == (ABORTED, "unknown_label") and "known are" in result.reason


def test_two_goals_are_answered_each_with_its_own(client: Client) -> None:
    first, second = (client.ask(label, agreeing=2, of=2)[0] for label in ("3", "12"))
    client.frames(2)
    places = [place(client.result(handle)[1].pose) for handle in (first, second)]
    assert np.linalg.norm(places[0] - places[1]) > 0.04


def test_a_camera_that_moves_is_unsteady(client: Client) -> None:
    handle, _ = client.ask("7", agreeing=4, of=4)
    client.frames(4, shift_px=6.0)
    status, result = client.result(handle)
    assert (status, result.status) == (ABORTED, "unsteady")


def test_a_withdrawn_goal_and_one_without_frames_end(client: Client) -> None:
    handle, _ = client.ask("7")
    client.frames(1)
    withdrawn = handle.cancel_goal_async()
    assert client.harness.until(withdrawn.done)
    status, result = client.result(handle)
    assert (status, result.status) == (CANCELED, "cancelled")
    handle, _ = client.ask("7", timeout_s=0.3)
    status, result = client.result(handle)
    assert (status, result.status, result.frames) == (ABORTED, "no_frames", 0)


@pytest.mark.parametrize(
    ("goal", "code"),
    [
        ({"label": "7", "timeout_s": 0.0}, "bad_request"),
        ({"label": "7", "timeout_s": float("nan")}, "bad_request"),
        ({"label": "7", "agreeing": 8, "of": 7}, "bad_request"),
        ({"label": "7", "max_lateral_std_m": -1.0}, "bad_request"),
        ({"label": "  "}, "empty_target"),
    ],
)
def test_a_goal_that_cannot_be_used_is_refused_at_once(client: Client, goal: dict[str, Any], code: str) -> None:
    status, result = client.result(client.ask(**goal)[0])
    assert (status, result.status) == (ABORTED, code) and result.reason


def test_a_frame_that_cannot_be_known_is_named(client: Client) -> None:
    handle, _ = client.ask("7", agreeing=1, of=1, frame_id="map")
    client.frames(1)
    status, result = client.result(handle)
    assert (status, result.status) == (ABORTED, "unknown_frame")
    # Where tf2_ros is installed, it says itself that there is no such frame.
    assert "map" in result.reason or "needs tf2_ros" in result.reason


@pytest.mark.parametrize(
    ("label", "timeout_s", "frames", "code"),
    [
        ("7", 0.0, 0, "bad_request"),
        ("7", float("inf"), 0, "bad_request"),
        (" ", 5.0, 0, "empty_target"),
        ("7", 0.3, 0, "no_frames"),
        ("99", 1.5, 3, "unseen"),
    ],
)
def test_a_press_that_cannot_be_confirmed_says_why(
    client: Client, label: str, timeout_s: float, frames: int, code: str
) -> None:
    handle, feedback = client.confirm(label, timeout_s)
    client.frames(frames)
    status, result = client.result(handle)
    assert (status, result.status) == (ABORTED, code) and result.reason
    assert (result.frames, len(feedback), result.seen) == (frames, frames, 0)


def test_a_watch_is_ready_after_three_frames_or_at_once_after_the_button_was_found(client: Client) -> None:
    handle, feedback = client.confirm("11")
    client.frames(3)
    assert client.harness.until(lambda: len(feedback) == 3)
    assert [f.ready for f in feedback] == [False, False, True]
    assert client.harness.until(handle.cancel_goal_async().done)
    assert client.result(handle)[1].status == "cancelled"
    found, _ = client.ask("8", agreeing=1, of=1)
    client.frames(1)
    assert client.result(found)[1].status == "found"
    handle, feedback = client.confirm("8", 1.0)
    client.frames(1)
    assert client.harness.until(lambda: len(feedback) == 1) and feedback[0].ready
    assert client.result(handle)[1].status == "unseen"


def test_a_rendered_press_is_confirmed_and_a_broken_lamp_told(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, answer in (([], "confirmed"), (["--broken"], "not_lit")):
        # In a graph of its own: the node of the other tests still lives.
        assert press.main(arguments) == 0
        said = capsys.readouterr().out
        assert "find_button 7: found" in said and "lit: no" in said and f"confirm_press 7: {answer}" in said


@pytest.mark.parametrize(("label", "words"), [("7", "press at "), ("99", "unknown_label: no button")])
def test_the_example_of_the_page_asks_and_is_answered(client: Client, tmp_path: Path, label: str, words: str) -> None:
    page = (ROOT / "docs" / "pressing.md").read_text()
    example = tmp_path / "ask.py"
    example.write_text(page.split("```python\n")[1].split("```")[0])
    asking = subprocess.Popen(
        [sys.executable, str(example), label],
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        end = time.monotonic() + 20.0
        while asking.poll() is None and time.monotonic() < end:
            client.frames(1)
        said, _ = asking.communicate(timeout=5.0)
    finally:
        asking.kill()
    # Nothing is pressed here: the button is found, and no lamp goes on.
    assert asking.returncode == 1 and words in said and "went on" not in said
