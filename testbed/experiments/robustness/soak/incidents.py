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
LATCHED_S = 75.0  # the same for a fault that stays latched until the next motion, a minute later, meets it
_LATCHED = "refused.error_latched"
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

    def explains(self, met: Incident) -> bool:
        """Whether what went wrong can come of it."""
        after_s = LATCHED_S if met.cause == _LATCHED else AFTERMATH_S
        return self.begin_s <= met.at_s <= self.end_s + after_s


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

        From the seconds before they said so to the end that they told, or to that of the soak.
        """
        for path in logs:
            begun_s: float | None = None
            for event, at_s in _overloads(path, self._began_s):
                if event == "overloaded" and begun_s is None:
                    begun_s = at_s - 1e-9 * WINDOW_NS
                elif event == "overload_over" and begun_s is not None:
                    self.overloads.append(Explanation(OVERLOAD, begun_s, at_s))
                    begun_s = None
            if begun_s is not None:
                self.overloads.append(Explanation(OVERLOAD, begun_s, self.now_s))

    @property
    def incidents(self) -> list[Incident]:
        """All incidents, each with what explains it: a fault before overload."""
        with self._lock:
            causes = [*self.overloads, *self.faults]
            return [
                met._replace(explained_by=next((c.name for c in reversed(causes) if c.explains(met)), ""))
                for met in self._met
            ]

    @property
    def unexplained(self) -> list[Incident]:
        """The incidents that nothing explains."""
        return [incident for incident in self.incidents if not incident.explained_by]

    def counts(self) -> Counter[tuple[str, str, str]]:
        """How often each cause came, by who met it and what explains it."""
        return Counter((i.who, i.cause, i.explained_by) for i in self.incidents)


def _overloads(log: Path, began_s: float) -> Iterator[tuple[str, float]]:
    """Names and times of a log's events about overload."""
    for line in log.read_text(encoding="utf-8").splitlines():
        event = event_of(line)
        if event is not None and event["event"] in ("overloaded", "overload_over"):
            yield event["event"], 1e-9 * event["time_ns"] - began_s
