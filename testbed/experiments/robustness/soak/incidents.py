"""What went wrong in a soak, when, who met it, and whether a fault that was injected explains it."""

import threading
import time
from collections import Counter
from typing import NamedTuple

AFTERMATH_S = 15.0  # how long after its end a fault still explains what goes wrong: settling, RESET, ENABLE


class Incident(NamedTuple):
    """A refusal, a failed program or an answer that did not come; ``cause`` is the machine-readable one.

    ``at_s`` counts from the start of the soak. ``explained_by`` names a fault; empty: nothing explains it.
    """

    at_s: float
    who: str
    cause: str
    detail: str
    explained_by: str


class InjectedFault(NamedTuple):
    """A fault of the plant, from ``begin_s`` to ``end_s`` of the soak."""

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
        self.faults: list[InjectedFault] = []
        self.incidents: list[Incident] = []

    @property
    def now_s(self) -> float:
        """Time since the start of the soak."""
        return time.monotonic() - self._began_s

    def fault(self, name: str, duration_s: float) -> None:
        """Note a fault that begins now."""
        with self._lock:
            self.faults.append(InjectedFault(name, self.now_s, self.now_s + duration_s))

    def incident(self, who: str, cause: str, detail: str) -> None:
        """Note what ``who`` met just now, and which fault explains it."""
        with self._lock:
            at_s = self.now_s
            explained = next((fault.name for fault in reversed(self.faults) if fault.explains(at_s)), "")
            self.incidents.append(Incident(at_s, who, cause, detail, explained))

    @property
    def unexplained(self) -> list[Incident]:
        """The incidents that no fault explains."""
        with self._lock:
            return [incident for incident in self.incidents if not incident.explained_by]

    def counts(self) -> Counter[tuple[str, str, str]]:
        """How often each cause came, by who met it and the fault that explains it."""
        with self._lock:
            return Counter((i.who, i.cause, i.explained_by) for i in self.incidents)
