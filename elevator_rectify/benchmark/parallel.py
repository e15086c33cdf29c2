"""Runs independent tasks on all cores, each on one thread, in their order."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from typing import TypeVar

import cv2

from elevator_rectify.progress import progress
from elevator_rectify.threads import ONE_THREAD

T = TypeVar("T")
R = TypeVar("R")
# Tasks that a process takes at a time: fewer are not worth its start.
_CHUNK = 8


def _single_thread() -> None:
    cv2.setNumThreads(1)


def parallel(function: Callable[[T], R], tasks: Sequence[T], title: str, workers: int | None = None) -> list[R]:
    """Return function(task) for every task; with a progress bar."""
    if len(tasks) <= _CHUNK:
        return list(progress(map(function, tasks), title, len(tasks)))
    # BLAS reads it when it is loaded: the workers are fresh interpreters.
    os.environ.update(ONE_THREAD)
    with multiprocessing.get_context("spawn").Pool(workers or os.cpu_count(), _single_thread) as pool:
        return list(progress(pool.imap(function, tasks, chunksize=_CHUNK), title, len(tasks)))
