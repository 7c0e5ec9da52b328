"""Which lines of a log are written when the same thing happens again and again.

The first of a kind is written at once. What follows it is counted, and told in one line after a second,
after two more, after four more, … and once a minute in the end: a flood fills no disk, and its figure is
never older than a minute. A kind that has been quiet for a second begins anew.
"""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

SOONEST_NS = 1_000_000_000
LATEST_NS = 60 * SOONEST_NS

Line = TypeVar("Line")


@dataclass
class _Kind(Generic[Line]):
    """``waiting``: the newest of the ``repeated`` lines that were not written; ``seen_ns``: when one came."""

    seen_ns: int
    due_ns: int
    interval_ns: int = SOONEST_NS
    waiting: Line | None = None
    repeated: int = 0


class RepeatedLines(Generic[Line]):
    """The kinds of lines that came of late; a kind should be one of a limited number of them."""

    def __init__(self) -> None:
        self._kinds: dict[Hashable, _Kind[Line]] = {}

    def put(self, kind: Hashable, line: Line, now_ns: int) -> int:
        """How many lines ``line`` is to be written for, itself included; 0: not now, ``due`` has it later."""
        known = self._kinds.get(kind)
        if known is None or now_ns - known.seen_ns >= SOONEST_NS:
            self._kinds[kind] = _Kind(now_ns, now_ns + SOONEST_NS)
            return 1 + (0 if known is None else known.repeated)
        known.seen_ns, known.waiting = now_ns, line
        known.repeated += 1
        return 0

    def due(self, now_ns: int) -> list[tuple[Line, int]]:
        """The lines whose time has come, each with how many it stands for. Quiet kinds are forgotten."""
        told: list[tuple[Line, int]] = []
        for kind, known in list(self._kinds.items()):
            if now_ns < known.due_ns:
                continue
            if known.waiting is None:
                if now_ns - known.seen_ns >= SOONEST_NS:
                    del self._kinds[kind]
                continue
            told.append((known.waiting, known.repeated))
            known.waiting, known.repeated = None, 0
            known.interval_ns = min(2 * known.interval_ns, LATEST_NS)
            known.due_ns = now_ns + known.interval_ns
        return told

    def rest(self) -> list[tuple[Line, int]]:
        """All lines that wait, as ``due`` has them; nothing is kept."""
        kinds, self._kinds = self._kinds, {}
        return [(each.waiting, each.repeated) for each in kinds.values() if each.waiting is not None]
