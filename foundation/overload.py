"""Whether a machine keeps up: shares of what was missed within the last seconds, and what to say of them."""

from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

WINDOW_NS = 5_000_000_000
_FEWEST = 10  # of which a share says something


class Tally(NamedTuple):
    """What is done again and again, counted since the start: so many times done, so many missed or late."""

    done: int
    missed: int


class Limit(NamedTuple):
    """The share (percent) that may be missed, and the words for it: "of the controller's scans were late"."""

    percent: float
    words: str


class OverloadWatch:
    """Compares shares within the last five seconds with ``limits`` (by name).

    ``told``: one sentence with the worst figure while the machine is overloaded, else empty.
    """

    def __init__(self, limits: Mapping[str, Limit]) -> None:
        self._limits = limits
        self._past: deque[tuple[int, Mapping[str, Tally]]] = deque()
        self.told = ""

    def update(self, now_ns: int, counts: Mapping[str, Tally]) -> str:
        """``told`` after ``counts`` of ``now_ns``. Names without a limit are left aside."""
        self._past.append((now_ns, counts))
        while len(self._past) > 2 and self._past[1][0] <= now_ns - WINDOW_NS:
            self._past.popleft()
        began_ns, before = self._past[0]
        worst, self.told = 1.0, ""
        for name, limit in self._limits.items():
            if name not in counts or name not in before:
                continue
            missed = counts[name].missed - before[name].missed
            of = counts[name].done - before[name].done + missed
            if of < _FEWEST or missed < 0:  # too few, or counted anew by another process
                continue
            percent = 100.0 * missed / of
            if percent > limit.percent * worst:
                worst = percent / limit.percent
                seconds = (now_ns - began_ns) / 1e9
                share = f"{percent:.1f} % {limit.words} in the last {seconds:.0f} s"
                self.told = f"the machine is overloaded: {share}"
        return self.told
