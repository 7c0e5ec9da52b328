"""What went wrong in a soak, who met it when, and what explains it: a fault, or an overloaded machine."""

import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import numpy as np

from foundation.event_log import event_of
from foundation.periods import WINDOW_NS
from testbed.realtime.rest_rig import bearer

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


_GAP_S = (30.0, 90.0)
_TIMEOUT_S = 5.0


class Disturbance(NamedTuple):
    """A kind of fault with its parameters, and for how long (s, from … to) it may last."""

    fault: dict[str, Any]
    duration_s: tuple[float, float]

    @property
    def name(self) -> str:
        """Its kind, with its joint where it has one."""
        joint = self.fault.get("joint")
        return f"{self.fault['kind']}.{joint}" if joint else str(self.fault["kind"])


# What a machine meets within an hour of a bad day; each leaves a plant that can go on.
DISTURBANCES = (
    Disturbance({"kind": "camera_blind"}, (0.5, 4.0)),
    Disturbance({"kind": "camera_frozen"}, (0.5, 4.0)),
    Disturbance({"kind": "frames_dropped", "share": 0.5}, (2.0, 8.0)),
    Disturbance({"kind": "marker_covered", "marker_id": 0, "share": 0.5}, (2.0, 8.0)),
    Disturbance({"kind": "valve_slow", "joint": "lift", "bandwidth_share": 0.3}, (5.0, 15.0)),
    Disturbance({"kind": "valve_stuck", "joint": "tilt"}, (0.5, 3.0)),
    Disturbance({"kind": "supply_lost"}, (0.5, 2.0)),
    Disturbance({"kind": "encoder_stuck", "joint": "slew"}, (0.5, 2.0)),
    Disturbance({"kind": "encoder_jump", "joint": "wrist2", "angle_mrad": 300.0}, (0.5, 2.0)),
    Disturbance({"kind": "payload_change", "mass_kg": 60.0}, (5.0, 15.0)),
    Disturbance({"kind": "coupler_silent"}, (0.02, 1.0)),
)


class RandomFaults(threading.Thread):
    """Injects ``DISTURBANCES`` one after another, in an order and at times drawn by ``seed``, until ended."""

    def __init__(self, url: str, token: bytes | None, journal: Journal, seed: int) -> None:
        super().__init__(daemon=True)
        self._rng = np.random.default_rng(seed)
        self._journal = journal
        self._ended = threading.Event()
        self._client = httpx.Client(base_url=url, timeout=_TIMEOUT_S, headers=bearer(token))

    def end(self) -> None:
        """Inject nothing more; mend what is broken."""
        self._ended.set()
        self.join()
        self._client.delete("/faults")
        self._client.close()

    def run(self) -> None:
        """The thread's work."""
        while not self._ended.wait(self._rng.uniform(*_GAP_S)):
            chosen = DISTURBANCES[self._rng.integers(len(DISTURBANCES))]
            duration_s = float(self._rng.uniform(*chosen.duration_s))
            try:
                answer = self._client.post("/faults", json={"fault": chosen.fault, "duration_s": duration_s})
            except httpx.HTTPError as error:
                self._journal.incident("fault API", "link.rest", f"{chosen.name}: {error!r}")
                continue
            if answer.is_success:
                self._journal.fault(chosen.name, duration_s)
            else:
                self._journal.incident("fault API", str(answer.json().get("cause")), answer.text)
