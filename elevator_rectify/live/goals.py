"""Clients that ask a live node for buttons and presses, by right and wrong goals, and note how each of them ended."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor

from elevator_rectify.ros.goals import action

_CLIENTS, _PREFIX = 2, "/elevator_rectify/"
_ACTIONS, _CONFIRM_SHARE = {"FindButton": "find_button", "ConfirmPress": "confirm_press"}, 0.3
_LABELS, _TIMEOUTS_S, _WITHDRAWN_SHARE = ("7", "99", "", "open"), (0.0, 0.3, 1.0, 2.0), 0.3
_ACCEPTED_SECONDS, _PATIENCE_SECONDS = 3.0, 8.0


@dataclass
class Goals:
    """How goals ended: counts by the result's status; without a result: goals that were accepted and never answered."""

    ended: Counter[str] = field(default_factory=Counter)
    without_result: list[str] = field(default_factory=list)
    _stop: threading.Event = field(default_factory=threading.Event)

    def ask(self, kinds: dict[str, Any], domain: int, seed: int) -> None:
        """Ask until it is enough, in a ROS graph's participant of its own."""
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain)
        node = rclpy.create_node(f"goals_{seed}", context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        clients = {name: ActionClient(node, kind, _PREFIX + _ACTIONS[name]) for name, kind in kinds.items()}
        rng = np.random.default_rng(seed)

        def until(condition: Callable[[], bool], seconds: float) -> bool:
            end = time.monotonic() + seconds
            while not condition() and time.monotonic() < end:
                executor.spin_once(timeout_sec=0.05)
            return condition()

        try:
            while not self._stop.is_set():
                name = "ConfirmPress" if rng.random() < _CONFIRM_SHARE else "FindButton"
                if until(clients[name].server_is_ready, 1.0):
                    self._one(clients[name], _goal(name, kinds[name], rng), rng, until)
        finally:
            for client in clients.values():
                client.destroy()
            executor.shutdown()
            node.destroy_node()
            rclpy.shutdown(context=context)

    def _one(
        self, client: Any, goal: Any, rng: np.random.Generator, until: Callable[[Callable[[], bool], float], bool]
    ) -> None:
        sent = client.send_goal_async(goal)
        if not until(sent.done, _ACCEPTED_SECONDS) or not sent.result().accepted:
            self.ended["not accepted"] += 1
            return
        handle = sent.result()
        if rng.random() < _WITHDRAWN_SHARE:
            until(lambda: False, float(rng.uniform(0.0, 0.3)))
            handle.cancel_goal_async()
        got = handle.get_result_async()
        if until(got.done, goal.timeout_s + _PATIENCE_SECONDS):
            self.ended[str(got.result().result.status)] += 1
        else:
            self.without_result.append(f"goal {goal.label!r}, {goal.timeout_s:g} s: no result")

    def stop(self) -> None:
        """Let the clients end after their last goal."""
        self._stop.set()


def _goal(name: str, kind: Any, rng: np.random.Generator) -> Any:
    """Return a goal, right or wrong."""
    asked = {"label": str(rng.choice(_LABELS)), "timeout_s": float(rng.choice(_TIMEOUTS_S))}
    if name == "FindButton":
        return kind.Goal(**asked, agreeing=int(rng.integers(1, 9)), of=int(rng.integers(1, 8)))
    return kind.Goal(**asked)


@contextmanager
def asking(domain: int, seed: int) -> Iterator[Goals]:
    """Let two clients ask meanwhile; nothing is asked where the interface package is not installed."""
    goals, kinds = Goals(), {name: action(name) for name in _ACTIONS}
    seeds = range(seed, seed + _CLIENTS) if all(kinds.values()) else ()
    threads = [threading.Thread(target=goals.ask, args=(kinds, domain, s)) for s in seeds]
    for thread in threads:
        thread.start()
    try:
        yield goals
    finally:
        goals.stop()
        for thread in threads:
            thread.join()
