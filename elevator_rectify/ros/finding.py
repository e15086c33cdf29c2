"""The action `find_button`: a label in, one answer out; on hand where elevator_rectify_interfaces is installed."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.clock import Clock
from rclpy.node import Node

from elevator_rectify.core.geometry.common_errors import covariance_if_right
from elevator_rectify.core.reading.agreement import Look, Request, Verdict, timed_out, verdict
from elevator_rectify.core.reading.target import Choice
from elevator_rectify.ros.answer import Answer
from elevator_rectify.ros.buttons import button_covariance
from elevator_rectify.ros.frames import Frames, Transform
from elevator_rectify.ros.goals import Goal, Goals
from elevator_rectify.ros.messages import make_ros
from elevator_rectify.ros.poses import pose_of, quaternion, ros_header, stamped_pose

# Chooses the button of a label in the present frame, its place as exact as the second argument says (0: as usual).
Choose = Callable[[str, float], Choice]
_UNKNOWN_FRAME = "unknown_frame"


@dataclass(frozen=True)
class Seen:
    """What one frame says for a goal: the look, and of a found button what is answered of it."""

    look: Look
    pose: Any = None
    standoff: Any = None
    lit: tuple[str, float] = ("", float("nan"))


@dataclass(kw_only=True)
class FindGoal(Goal):
    """A label that is looked for, the number of frames since it came, and what the last of them say."""

    request: Request
    frame: str
    seen: deque[Seen]
    frames: int = 0

    @property
    def looks(self) -> list[Look]:
        """Return the last looks, as many as are asked for at most."""
        return [seen.look for seen in self.seen]


class FindButton(Goals[FindGoal]):
    """Finds buttons: the worker adds what each frame says, the executor's thread answers."""

    def __init__(self, node: Node, kind: Any, frames: Frames, steady: Clock) -> None:
        self._frames = frames
        super().__init__(node, kind, "~/find_button", steady)

    def _goal(self, handle: Any) -> FindGoal:
        asked = handle.request
        request = Request(
            str(asked.label),
            float(asked.timeout_s),
            int(asked.agreeing),
            int(asked.of),
            float(asked.max_lateral_std_m),
        ).usual()
        problem = request.problem()
        refusal = Verdict("bad_request", problem) if problem else None
        if refusal is None and not request.label.strip():
            refusal = Verdict("empty_target", "the label is empty")
        last = deque[Seen](maxlen=1 if problem else request.of)
        end = time.monotonic() + request.timeout_s
        frame = str(asked.frame_id)
        return FindGoal(handle=handle, end=end, answer=refusal, request=request, frame=frame, seen=last)

    def look(self, answer: Answer, choose: Choose) -> list[str]:
        """Add what a frame says to every goal; answer those for which that is enough; return the labels it found."""
        found = []
        for goal in self._waiting():
            seen = self._seen(goal, answer, choose)
            if seen.look.choice.status == _UNKNOWN_FRAME and self._frames.filling:
                continue
            goal.seen.append(seen)
            goal.frames += 1
            decided = verdict(goal.looks, goal.request)
            self._feed_back(goal)
            if decided is not None:
                self._decide(goal, decided)
            if goal.seen[-1].look.place is not None:
                found.append(goal.request.label)
        return found

    def _seen(self, goal: FindGoal, answer: Answer, choose: Choose) -> Seen:
        choice = choose(goal.request.label, goal.request.max_lateral_std_m)
        if choice.button is None:
            return Seen(Look(choice))
        transform = self._frames.at(goal.frame, answer.header)
        if isinstance(transform, str):
            return Seen(Look(Choice(None, _UNKNOWN_FRAME, transform)))
        return _placed(answer, choice, transform)

    def _feed_back(self, goal: FindGoal) -> None:
        last, feedback = goal.seen[-1].look.choice, self._type.Feedback()
        feedback.status, feedback.reason = last.status, last.reason
        feedback.frames, feedback.found = goal.frames, sum(look.place is not None for look in goal.looks)
        goal.handle.publish_feedback(feedback)

    def _late(self, goal: FindGoal) -> Verdict:
        return timed_out(goal.looks, goal.request)

    def _refused(self, status: str, reason: str) -> Verdict:
        return Verdict(status, reason)

    def _filled(self, goal: FindGoal, answer: Verdict) -> Any:
        result = self._type.Result()
        result.status, result.reason = answer.status, answer.reason
        result.frames, result.agreed = goal.frames, answer.agreed
        if answer.chosen >= 0:
            seen = goal.seen[answer.chosen]
            result.pose, result.standoff = seen.pose, seen.standoff
            result.label_probability = seen.look.choice.probability
            result.lit, result.lit_probability = seen.lit
            result.alternatives = [label for label, _ in seen.look.choice.others]
            result.alternative_probabilities = [p for _, p in seen.look.choice.others]
        return result


def _placed(answer: Answer, choice: Choice, transform: Transform) -> Seen:
    """Return the look at a button that was found, its poses in the frame of the transform."""
    button = choice.button
    assert button is not None
    fit = answer.fit
    covariance = transform.covariance(button_covariance(fit, button))
    turn = quaternion(transform.R @ fit.R_camera_panel)
    header = ros_header(answer.header, make_ros)
    header.frame_id = transform.name
    places = [transform.R @ point + transform.t for point in (button.point, answer.standoff(button))]
    poses = [stamped_pose(pose_of(place, turn, make_ros), covariance, header, make_ros) for place in places]
    own = transform.R @ covariance_if_right(fit, button.covariance, button.panel) @ transform.R.T
    return Seen(Look(choice, places[0], own), poses[0], poses[1], (button.lit, button.lit_probability))
