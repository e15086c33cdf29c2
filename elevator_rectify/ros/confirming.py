"""The action `confirm_press`: whether the lamp of a button went on; on hand as `find_button` is."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rclpy.clock import Clock
from rclpy.node import Node

from elevator_rectify.core.lamps.patches import Patches
from elevator_rectify.core.lamps.watch import REFERENCES, Pressed, Watch, confirmed, ended, reference_of, watched
from elevator_rectify.core.reading.agreement import LONGEST_SECONDS
from elevator_rectify.core.reading.labels import canonical
from elevator_rectify.ros.answer import Answer
from elevator_rectify.ros.goals import Goal, Goals

# What a button looked like when it was found serves so long as its look before the press; frames that lie further
# apart are of two occasions; so many buttons are remembered.
_REMEMBERED_SECONDS, _APART_SECONDS, _MOST_BUTTONS = 120.0, 5.0, 16


@dataclass
class Remembered:
    """The last frames in which a button was found, and when that was (on the clock of `time.monotonic`)."""

    frames: deque[Patches] = field(default_factory=lambda: deque(maxlen=REFERENCES))
    last: float = 0.0


@dataclass(kw_only=True)
class PressGoal(Goal):
    """A button that is watched."""

    watch: Watch


class ConfirmPress(Goals[PressGoal]):
    """Watches buttons: the worker adds what each frame shows, the executor's thread answers."""

    def __init__(self, node: Node, kind: Any, steady: Clock) -> None:
        self._found: dict[str, Remembered] = {}
        super().__init__(node, kind, "~/confirm_press", steady)

    def remember(self, labels: list[str], answer: Answer) -> None:
        """Keep what the panel looks like in a frame in which the buttons of these labels were found."""
        now, patches = time.monotonic(), answer.patches
        for label in map(canonical, labels) if patches is not None else ():
            remembered = self._found.pop(label, Remembered())
            if now - remembered.last > _APART_SECONDS:
                remembered.frames.clear()
            if patches is not None and label in patches.labels:
                remembered.frames.append(patches)
            remembered.last = now
            self._found[label] = remembered
        while len(self._found) > _MOST_BUTTONS:
            self._found.pop(next(iter(self._found)))

    def _goal(self, handle: Any) -> PressGoal:
        label, timeout_s = str(handle.request.label), float(handle.request.timeout_s)
        refusal = None if label.strip() else self._refused("empty_target", "the label is empty")
        if not 0.0 < timeout_s <= LONGEST_SECONDS:
            problem = f"timeout_s must lie in (0, {LONGEST_SECONDS:g}], not {timeout_s!r}"
            refusal = self._refused("bad_request", problem)
        now, known = time.monotonic(), self._found.get(canonical(label), Remembered())
        before = reference_of(list(known.frames)) if now - known.last < _REMEMBERED_SECONDS else ()
        return PressGoal(handle=handle, end=now + timeout_s, answer=refusal, watch=Watch(canonical(label), before))

    def look(self, answer: Answer) -> None:
        """Add what a frame shows to every goal; answer those for which that is enough."""
        for goal in self._waiting():
            goal.watch = watched(goal.watch, answer.patches, answer.fit.reason)
            self._feed_back(goal)
            if (decided := confirmed(goal.watch)) is not None:
                self._decide(goal, decided)

    def _feed_back(self, goal: PressGoal) -> None:
        watch, feedback = goal.watch, self._type.Feedback()
        feedback.ready, feedback.frames, feedback.seen = watch.ready, watch.frames, watch.seen
        feedback.probability = watch.sights[-1].probability if watch.sights else float(np.nan)
        feedback.reason = watch.sights[-1].problem if watch.sights else ""
        goal.handle.publish_feedback(feedback)

    def _late(self, goal: PressGoal) -> Pressed:
        return ended(goal.watch)

    def _refused(self, status: str, reason: str) -> Pressed:
        return Pressed(status, reason)

    def _filled(self, goal: PressGoal, answer: Pressed) -> Any:
        result = self._type.Result()
        result.status, result.reason, result.probability = answer.status, answer.reason, answer.probability
        result.frames, result.seen = goal.watch.frames, goal.watch.seen
        return result
