"""What went wrong in a soak, who met it when, and what explains it: a fault, or an overloaded machine."""

import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from foundation.event_log import event_of
from foundation.overload import WINDOW_NS

AFTERMATH_S = 15.0  # how long after its end a cause still explains what goes wrong: settling, RESET, ENABLE
OVERLOAD = "overload"


class Incident(NamedTuple):
    """A refusal, a failed program or an answer that did not come; ``cause`` is the machine-readable one.

    ``at_s`` counts from the start of the soak. ``explained_by`` names a fault or overload; empty: nothing.
    """

    at_s: float
    who: str
    cause: str
    detail: str
    explained_by: str = ""


class Explanation(NamedTuple):
    """What makes things go wrong from ``begin_s`` to ``end_s`` of the soak, and for a while after."""

    name: str
    begin_s: float
    end_s: float

    def explains(self, at_s: float) -> bool:
        """Whether what goes wrong at ``at_s`` can come of it."""
        return self.begin_s <= at_s <= self.end_s + AFTERMATH_S


class Journal:
    """Incidents and faults of one soak, written from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._began_s = time.monotonic()
        self._met: list[Incident] = []
        self.faults: list[Explanation] = []
        self.overloads: list[Explanation] = []

    @property
    def now_s(self) -> float:
        """Time since the start of the soak."""
        return time.monotonic() - self._began_s

    def fault(self, name: str, duration_s: float) -> None:
        """Note a fault that begins now."""
        with self._lock:
            self.faults.append(Explanation(name, self.now_s, self.now_s + duration_s))

    def incident(self, who: str, cause: str, detail: str) -> None:
        """Note what ``who`` met just now."""
        with self._lock:
            self._met.append(Incident(self.now_s, who, cause, detail))

    def read_overloads(self, logs: Iterable[Path]) -> None:
        """Take over when the services said in their ``logs`` that the machine was overloaded.

        What they say stands for the seconds before it.
        """
        for event in (event for path in logs for event in _overloaded(path)):
            at_s = 1e-9 * event["time_ns"] - self._began_s
            self.overloads.append(Explanation(OVERLOAD, at_s - 1e-9 * WINDOW_NS, at_s))

    @property
    def incidents(self) -> list[Incident]:
        """All incidents, each with what explains it: a fault before overload."""
        with self._lock:
            causes = [*self.overloads, *self.faults]
            return [
                met._replace(
                    explained_by=next((c.name for c in reversed(causes) if c.explains(met.at_s)), "")
                )
                for met in self._met
            ]

    @property
    def unexplained(self) -> list[Incident]:
        """The incidents that nothing explains."""
        return [incident for incident in self.incidents if not incident.explained_by]

    def counts(self) -> Counter[tuple[str, str, str]]:
        """How often each cause came, by who met it and what explains it."""
        return Counter((i.who, i.cause, i.explained_by) for i in self.incidents)


def _overloaded(log: Path) -> Iterator[dict[str, float]]:
    for line in log.read_text(encoding="utf-8").splitlines():
        event = event_of(line)
        if event is not None and event["event"] == "overloaded":
            yield event
