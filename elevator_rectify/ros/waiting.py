"""The frames that wait for the worker: few, so that the latency stays bounded."""

from __future__ import annotations

import threading
from collections import deque

from elevator_rectify.ros.pairing import Frame


class Waiting:
    """A queue between two threads; beyond `most` frames the oldest gives way, so that the newest are answered."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._frames: deque[Frame] = deque()
        self._change = threading.Condition()
        self._closed = False

    def put(self, frame: Frame) -> list[Frame]:
        """Add a frame; return those that gave way."""
        with self._change:
            self._frames.append(frame)
            late = [self._frames.popleft() for _ in range(len(self._frames) - self._most)]
            self._change.notify()
        return late

    def get(self) -> Frame | None:
        """Wait for the oldest frame; None when closed."""
        with self._change:
            while not self._frames and not self._closed:
                self._change.wait()
            return None if self._closed else self._frames.popleft()

    def close(self) -> int:
        """Let `get` return None; return how many frames were left."""
        with self._change:
            self._closed = True
            left = len(self._frames)
            self._frames.clear()
            self._change.notify_all()
        return left
