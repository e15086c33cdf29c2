"""The action `find_button`: a label in, one answer out; on hand where elevator_rectify_interfaces is installed."""

from __future__ import annotations

import importlib
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.clock import Clock
from rclpy.executors import Executor
from rclpy.node import Node

from elevator_rectify.core.reading.agreement import Look, Request, Verdict, timed_out, verdict
from elevator_rectify.core.reading.target import Choice
from elevator_rectify.ros.answer import Answer
from elevator_rectify.ros.buttons import button_covariance
from elevator_rectify.ros.frames import Frames, Transform
from elevator_rectify.ros.messages import make_ros
from elevator_rectify.ros.poses import pose_of, quaternion, ros_header, stamped_pose

_INTERFACES = "elevator_rectify_interfaces.action"
# Goals that have no more time, or were withdrawn, are noticed so soon.
_TICK_SECONDS = 0.05
# A node that ends takes so long to answer what still waits.
_LAST_ANSWERS_SECONDS = 0.3

# Chooses the button of a label in the present frame, its place as exact as the second argument says (0: as usual).
Choose = Callable[[str, float], Choice]


@dataclass(frozen=True)
class Seen:
    """What one frame says for a goal: the look, and of a found button what is answered of it."""

    look: Look
    pose: Any = None
    standoff: Any = None


@dataclass
class Goal:
    """A goal, the number of frames since it came, and what the last of them say."""

    handle: Any
    request: Request
    frame: str
    end: float
    seen: deque[Seen]
    frames: int = 0
    answer: Verdict | None = None

    @property
    def looks(self) -> list[Look]:
        """Return the last looks, as many as are asked for at most."""
        return [seen.look for seen in self.seen]


def action(name: str) -> Any:
    """Return an action's type, None where the interface package is not installed."""
    try:
        return getattr(importlib.import_module(_INTERFACES), name, None)
    except ImportError:
        return None


class FindButton:
    """Serves goals, several at a time: the worker adds what each frame says, the executor's thread answers."""

    def __init__(self, node: Node, kind: Any, frames: Frames, steady: Clock) -> None:
        self._type, self._ending = kind, False
        self._frames, self._goals, self._lock = frames, list[Goal](), threading.Lock()
        self._server = ActionServer(
            node,
            kind,
            "~/find_button",
            self._result,
            handle_accepted_callback=self._accepted,
            goal_callback=lambda _: GoalResponse.REJECT if self._ending else GoalResponse.ACCEPT,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        self._timer = node.create_timer(_TICK_SECONDS, self._tick, clock=steady)
        self._timer.cancel()

    @property
    def wanted(self) -> bool:
        """Tell whether a goal waits for frames."""
        return bool(self._goals)

    def _accepted(self, handle: Any) -> None:
        """Take a goal, or answer at once why it cannot be used."""
        asked = handle.request
        request = Request(
            str(asked.label),
            float(asked.timeout_s),
            int(asked.agreeing),
            int(asked.of),
            float(asked.max_lateral_std_m),
        ).usual()
        problem = request.problem()
        last = deque[Seen](maxlen=1 if problem else request.of)
        goal = Goal(handle, request, str(asked.frame_id), time.monotonic() + request.timeout_s, last)
        refusal = Verdict("bad_request", problem) if problem else None
        if refusal is None and not request.label.strip():
            refusal = Verdict("empty_target", "the label is empty")
        with self._lock:
            self._goals.append(goal)
        if refusal is not None:
            self._decide(goal, refusal)
        self._timer.reset()

    def look(self, answer: Answer, choose: Choose) -> None:
        """Add what a frame says to every goal; answer those for which that is enough."""
        with self._lock:
            goals = [goal for goal in self._goals if goal.answer is None]
        for goal in goals:
            goal.seen.append(self._seen(goal, answer, choose))
            goal.frames += 1
            decided = verdict(goal.looks, goal.request)
            self._feed_back(goal)
            if decided is not None:
                self._decide(goal, decided)

    def _seen(self, goal: Goal, answer: Answer, choose: Choose) -> Seen:
        choice = choose(goal.request.label, goal.request.max_lateral_std_m)
        if choice.button is None:
            return Seen(Look(choice))
        transform = self._frames.at(goal.frame, answer.header)
        if isinstance(transform, str):
            return Seen(Look(Choice(None, "unknown_frame", transform)))
        return _placed(answer, choice, transform)

    def _feed_back(self, goal: Goal) -> None:
        last, feedback = goal.seen[-1].look.choice, self._type.Feedback()
        feedback.status, feedback.reason = last.status, last.reason
        feedback.frames, feedback.found = goal.frames, sum(look.place is not None for look in goal.looks)
        goal.handle.publish_feedback(feedback)

    def _decide(self, goal: Goal, answer: Verdict) -> None:
        """Let the executor answer, once."""
        with self._lock:
            if goal.answer is not None:
                return
            goal.answer = answer
        try:
            goal.handle.execute()
        except Exception:
            # The goal was withdrawn in this moment: the next tick ends it.
            goal.answer = None

    def _tick(self) -> None:
        """End what has no more time or was withdrawn."""
        for goal in list(self._goals):
            if goal.answer is not None:
                continue
            if goal.handle.is_cancel_requested or time.monotonic() > goal.end:
                self._decide(goal, timed_out(goal.looks, goal.request))
        if not self._goals:
            self._timer.cancel()

    def _result(self, handle: Any) -> Any:
        """Return the result of a goal that is decided, and end it."""
        with self._lock:
            goal = next(goal for goal in self._goals if goal.handle is handle)
            self._goals.remove(goal)
        answer = goal.answer
        assert answer is not None
        if handle.is_cancel_requested:
            handle.canceled()
            answer = replace(answer, status="cancelled", reason="the goal was withdrawn", chosen=-1)
        elif answer.chosen >= 0:
            handle.succeed()
        else:
            handle.abort()
        return self._filled(goal, answer)

    def _filled(self, goal: Goal, answer: Verdict) -> Any:
        result = self._type.Result()
        result.status, result.reason = answer.status, answer.reason
        result.frames, result.agreed = goal.frames, answer.agreed
        if answer.chosen >= 0:
            seen = goal.seen[answer.chosen]
            result.pose, result.standoff = seen.pose, seen.standoff
            result.label_probability = seen.look.choice.probability
            result.alternatives = [label for label, _ in seen.look.choice.others]
            result.alternative_probabilities = [p for _, p in seen.look.choice.others]
        return result

    def close(self, executor: Executor | None) -> None:
        """Let what still waits end, as far as the executor gets to answer, and leave the graph."""
        self._ending, waited = True, list(self._goals)
        for goal in waited:
            self._decide(goal, Verdict("ended", "the node ends"))
        end = time.monotonic() + _LAST_ANSWERS_SECONDS
        while waited and executor is not None and time.monotonic() < end:
            executor.spin_once(timeout_sec=_TICK_SECONDS)
        self._server.destroy()


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
    return Seen(Look(choice, places[0], covariance[:3, :3]), *poses)
