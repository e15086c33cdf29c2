"""Goals of an action that wait for frames, several at a time: the worker looks, the executor's thread answers."""

from __future__ import annotations

import importlib
import threading
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.clock import Clock
from rclpy.executors import Executor
from rclpy.node import Node

_INTERFACES = "elevator_rectify_interfaces.action"
# Goals that have no more time, or were withdrawn, are noticed so soon.
_TICK_SECONDS = 0.05
# A node that ends takes so long to answer what still waits.
_LAST_ANSWERS_SECONDS = 0.3


class Verdict(Protocol):
    """How a goal ends."""

    @property
    def succeeds(self) -> bool:
        """Tell whether the action succeeded."""


@dataclass(kw_only=True)
class Goal:
    """A goal, when its time is over (on the clock of `time.monotonic`), and how it ends, once that is decided."""

    handle: Any
    end: float
    answer: Any = None


GoalT = TypeVar("GoalT", bound=Goal)


def action(name: str) -> Any:
    """Return an action's type, None where the interface package is not installed."""
    try:
        return getattr(importlib.import_module(_INTERFACES), name, None)
    except ImportError:
        return None


class Goals(ABC, Generic[GoalT]):
    """Serves an action; what a goal asks for and what its answer holds is the subclass's."""

    def __init__(self, node: Node, kind: Any, topic: str, steady: Clock) -> None:
        self._type, self._ending = kind, False
        self._goals, self._lock = list[GoalT](), threading.Lock()
        self._server = ActionServer(
            node,
            kind,
            topic,
            self._result,
            handle_accepted_callback=self._accepted,
            goal_callback=lambda _: GoalResponse.REJECT if self._ending else GoalResponse.ACCEPT,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        self._timer = node.create_timer(_TICK_SECONDS, self._tick, clock=steady)
        self._timer.cancel()

    @abstractmethod
    def _goal(self, handle: Any) -> GoalT:
        """Return the goal; with an answer where it cannot be used."""

    @abstractmethod
    def _late(self, goal: GoalT) -> Verdict:
        """Return how a goal ends that has no more time."""

    @abstractmethod
    def _refused(self, status: str, reason: str) -> Verdict:
        """Return a refusal."""

    @abstractmethod
    def _filled(self, goal: GoalT, answer: Any) -> Any:
        """Return the result message."""

    @property
    def wanted(self) -> bool:
        """Tell whether a goal waits for frames."""
        return bool(self._goals)

    def _waiting(self) -> list[GoalT]:
        with self._lock:
            return [goal for goal in self._goals if goal.answer is None]

    def _accepted(self, handle: Any) -> None:
        """Take a goal, or answer at once why it cannot be used."""
        goal = self._goal(handle)
        refusal, goal.answer = goal.answer, None
        with self._lock:
            self._goals.append(goal)
        if refusal is not None:
            self._decide(goal, refusal)
        self._timer.reset()

    def _decide(self, goal: GoalT, answer: Verdict) -> None:
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
        for goal in self._waiting():
            if goal.handle.is_cancel_requested or time.monotonic() > goal.end:
                self._decide(goal, self._late(goal))
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
            answer = self._refused("cancelled", "the goal was withdrawn")
        elif answer.succeeds:
            handle.succeed()
        else:
            handle.abort()
        return self._filled(goal, answer)

    def close(self, executor: Executor | None) -> None:
        """Let what still waits end, as far as the executor gets to answer, and leave the graph."""
        self._ending, waited = True, list(self._goals)
        for goal in waited:
            self._decide(goal, self._refused("ended", "the node ends"))
        end = time.monotonic() + _LAST_ANSWERS_SECONDS
        while waited and executor is not None and time.monotonic() < end:
            executor.spin_once(timeout_sec=_TICK_SECONDS)
        self._server.destroy()
