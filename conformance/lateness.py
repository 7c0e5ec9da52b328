"""How late the tester itself is: a machine that is busy makes sound peers look late."""

import threading
import time
from typing import NamedTuple, Self

PERIOD_S = 0.01


class LatenessFigures(NamedTuple):
    """Lateness of a loop of 10 ms beside the cases, in ms; all 0 before its first period."""

    samples: int
    p50_ms: float
    p99_ms: float
    max_ms: float


class LatenessWatch:
    """A thread that waits 10 ms again and again, and notes by how much more it was waiting."""

    def __init__(self) -> None:
        self._late_ms: list[float] = []
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()

    def _watch(self) -> None:
        while True:
            began_s = time.monotonic()
            if self._ending.wait(PERIOD_S):
                return
            self._late_ms.append(max(time.monotonic() - began_s - PERIOD_S, 0.0) * 1e3)

    @property
    def samples(self) -> int:
        """How many periods have been noted."""
        return len(self._late_ms)

    def figures(self, since: int = 0) -> LatenessFigures:
        """What was noted from sample ``since`` on."""
        return figures_of(self._late_ms[since:])


def figures_of(late_ms: list[float]) -> LatenessFigures:
    """Median, 99th percentile (nearest rank) and maximum."""
    if not late_ms:
        return LatenessFigures(0, 0.0, 0.0, 0.0)
    ranked = sorted(late_ms)
    count = len(ranked)
    p50, p99 = (ranked[-(-count * percent // 100) - 1] for percent in (50, 99))
    return LatenessFigures(count, round(p50, 3), round(p99, 3), round(ranked[-1], 3))
