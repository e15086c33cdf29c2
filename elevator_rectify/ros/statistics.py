"""What happened to the frames: counts by verdict, rates, latencies; the contents of /diagnostics."""

from __future__ import annotations

import threading
from collections import Counter, deque

import numpy as np

from elevator_rectify.ros.pairing import Pairing

_LATENCIES = 300
# The diagnostics tell of so many seconds.
_RECENT_SECONDS = 5
# A stamp further from now is of another clock: a bag, or a camera that is not synchronised.
_LONGEST_AGE_MS = 60e3


class Statistics:
    """Counts of one node; safe to use from its threads."""

    def __init__(self) -> None:
        self.verdicts: Counter[str] = Counter()
        self.last_reason = ""
        self._compute_ms: deque[float] = deque(maxlen=_LATENCIES)
        self._age_ms: deque[float] = deque(maxlen=_LATENCIES)
        self._before: Counter[str] = Counter()
        self._recent: deque[Counter[str]] = deque([Counter()], maxlen=_RECENT_SECONDS + 1)
        self._lock = threading.Lock()

    @property
    def frames(self) -> int:
        """Return how many frames were answered or refused."""
        return self.verdicts.total()

    def add(self, status: str, reason: str, compute_ms: float, age_ms: float) -> None:
        """Book one answered, refused or skipped frame; age: from the image's stamp to the answer."""
        with self._lock:
            self.verdicts[status] += 1
            if status != "ok":
                self.last_reason = f"{status}: {reason}"
            if status != "skipped":
                self._compute_ms.append(compute_ms)
                if 0.0 <= age_ms < _LONGEST_AGE_MS:
                    self._age_ms.append(age_ms)

    def values(self, pairing: Pairing, seconds: float) -> dict[str, str]:
        """Return everything as texts; rates are over the `seconds` since the last call."""
        with self._lock:
            counts = Counter({f"{topic} received": n for topic, n in pairing.received.items()})
            counts.update({f"frames {status}": n for status, n in self.verdicts.items()})
            rates = {f"{name} per second": f"{(n - self._before[name]) / seconds:.1f}" for name, n in counts.items()}
            self._before = counts
            total = self.verdicts.total()
            recent = self.verdicts - self._recent[0]
            self._recent.append(Counter(self.verdicts))
            return {
                **{name: str(n) for name, n in sorted(counts.items())},
                **rates,
                **{f"dropped {reason}": str(n) for reason, n in sorted(pairing.dropped.items())},
                **{name: str(n) for name, n in sorted(pairing.waiting().items())},
                "recent frames": str(recent.total()),
                "recent frames accepted": str(recent["ok"]),
                "share accepted": f"{self.verdicts['ok'] / total:.3f}" if total else "",
                "compute ms median, p95": _two(self._compute_ms),
                "age ms median, p95": _two(self._age_ms),
                "clock jumps": str(pairing.jumps),
                "last reason": self.last_reason,
            }


def _two(samples: deque[float]) -> str:
    return ", ".join(f"{p:.1f}" for p in np.percentile(np.array(samples), [50, 95])) if samples else ""
