"""A progress bar for whatever takes longer than two seconds."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator, Sized
from typing import TypeVar

T = TypeVar("T")
_WIDTH = 28


def progress(items: Iterable[T], title: str, total: int | None = None) -> Iterator[T]:
    """Yield the items, drawing a bar on stderr: in place on a terminal, else a line at every tenth."""
    if total is None:
        total = len(items) if isinstance(items, Sized) else 0
    live, begin, last = sys.stderr.isatty(), time.monotonic(), -1
    for number, item in enumerate(items, start=1):
        yield item
        tenth = 10 * number // max(total, 1)
        if not (live or tenth > last or number == total):
            continue
        last = tenth
        filled = min(_WIDTH, _WIDTH * number // max(total, 1))
        bar = "#" * filled + "." * (_WIDTH - filled)
        line = f"{title} [{bar}] {number}/{total or '?'} {time.monotonic() - begin:.1f} s"
        print(f"\r{line}" if live else line, end="" if live and number != total else "\n", file=sys.stderr, flush=True)
