"""Watching over the services until they end, and starting anew those that end before."""

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from foundation.incidents import ServiceIncident, note_incident
from testbed.realtime.child import INCIDENT_FILE, STOP_TIMEOUT_S, Child, Service, ServiceFailed, process_state
from testbed.realtime.complaints import Complaint, Repetitions
from testbed.realtime.restarts import MOST_CRASHES, GiveUp, decide

READY_TIMEOUT_S = 180.0  # a first start compiles the numba kernels
STALLED_S = 1.5  # without a sign of life

Report = Callable[[float, str], None]
Tell = Callable[[float, str], None]
"""Is told when something happened (seconds since 1970), and what."""


def _silent(_progress: float, _note: str) -> None:
    """Ignore progress, for callers that show none."""


class Supervisor:
    """The running services, in the order of their start. ``most_crashes``: the last of them ends all."""

    def __init__(self, log_dir: Path, most_crashes: int = MOST_CRASHES) -> None:
        log_dir.mkdir(parents=True, exist_ok=True)
        self._log_dir = log_dir
        self._most_crashes = most_crashes
        self._starts: Counter[str] = Counter()
        self._stalled: set[str] = set()
        self._crashes: list[ServiceIncident] = []
        self._repetitions = Repetitions()
        self.children: dict[str, Child] = {}

    def launch(self, service: Service) -> Child:
        """The service just started, not yet ready. From its second start on its log has a number."""
        self._starts[service.name] += 1
        number = self._starts[service.name]
        suffix = f".{number}" if number > 1 else ""
        child = Child(service.numbered(number), self._log_dir / f"{service.name}{suffix}.log")
        child.service = service
        self.children[service.name] = child
        return child

    def start(self, *services: Service, timeout_s: float = READY_TIMEOUT_S) -> None:
        """Start the ``services`` together and wait until all are ready. Raises ServiceFailed."""
        for child in [self.launch(service) for service in services]:
            child.wait_ready(timeout_s)

    def check(self) -> None:
        """Raise ServiceFailed when a service has ended by itself."""
        for child in self.children.values():
            if child.exit_status is not None:
                raise child.failure("by itself")

    def watch(self, seconds: float | None = None, interval_s: float = 0.25, tell: Tell | None = None) -> None:
        """Watch the services for ``seconds`` (None: for ever). Raises ServiceFailed when one ends.

        With ``tell``, what they complain of is told, and which one has stalled; and one that crashed, or that
        another asked to end (SIGTERM), is started anew, alone: crashes in quick succession end all.
        """
        until = None if seconds is None else time.monotonic() + seconds
        while until is None or time.monotonic() < until:
            if tell is not None:
                self._renew(tell)
                self._tell_troubles(tell)
            self.check()
            time.sleep(interval_s)

    def _renew(self, tell: Tell) -> None:
        for child in list(self.children.values()):
            if child.ended_in_good_order:
                child.end()
                self.start(child.service)
                anew = self.children[child.name].pid
                tell(time.time(), f"{child.name} was asked to end and is started anew: process {anew}")
            elif child.crashed:
                self._start_after_crash(child, tell)

    def _start_after_crash(self, child: Child, tell: Tell) -> None:
        """The service running again. Raises ServiceFailed with the first crash of too many."""
        detail = f"{child.name} crashed with {child.how_it_ended()}"
        child.end()
        incident = note_incident(
            child.name, "service.crashed", f"{detail}; it is started anew", self._log_dir / INCIDENT_FILE
        )
        self._crashes.append(incident._replace(detail=detail))
        tell(incident.at_s, detail)
        decision = decide(self._crashes, self._most_crashes)
        if isinstance(decision, GiveUp):
            at = time.strftime("%H:%M:%S", time.localtime(decision.first.at_s))
            why = f"{decision.crashes} crashes within a minute; the first, at {at}: {decision.first.detail}"
            raise ServiceFailed("service.crashed", why)
        time.sleep(decision.after_s)
        anew = self.launch(child.service)
        try:
            anew.wait_ready(READY_TIMEOUT_S)
        except ServiceFailed:
            if not anew.crashed:
                raise
            return  # the next look at it counts it as one more
        tell(time.time(), f"{child.name} is ready again: process {anew.pid}; the arm stays disabled")

    def _tell_troubles(self, tell: Tell) -> None:
        for child in self.children.values():
            while child.alarms:
                self._tell_news(child.name, child.alarms.popleft(), tell)
            silent_s = child.silence_s()
            if (silent_s > STALLED_S) == (child.name in self._stalled) or child.exit_status is not None:
                continue
            if silent_s > STALLED_S:
                self._stalled.add(child.name)
                state = process_state(child.pid)
                said = f"{child.name} has stalled: no sign of life for {silent_s:.1f} s, {state}"
                tell(time.time() - silent_s, said)
            else:
                self._stalled.remove(child.name)
                tell(time.time(), f"{child.name} goes on")

    def _tell_news(self, name: str, complaint: Complaint, tell: Tell) -> None:
        if self._repetitions.is_news(name, complaint):
            tell(complaint.at_s, f"{name}: {complaint.words}")

    def stop(self) -> dict[str, int]:
        """The exit status of each service; they are ended the last first, in four seconds together."""
        deadline_s = time.monotonic() + STOP_TIMEOUT_S
        order = list(self.children.values())[::-1]
        return {child.name: child.end(max(deadline_s - time.monotonic(), 0.2)) for child in order}


@contextmanager
def supervised(
    services: Sequence[Service], log_dir: Path, report: Report = _silent, most_crashes: int = MOST_CRASHES
) -> Iterator[Supervisor]:
    """The ``services`` running and ready, in a block that ends them however it is left.

    The first is ready before the others, which need it, are started together. Raises ServiceFailed with the
    last stderr line of the service that did not start.
    """
    supervisor = Supervisor(log_dir, most_crashes)
    try:
        report(0.0, "the first time ever it compiles for a while")
        supervisor.start(*services[:1])
        report(0.5, "")
        supervisor.start(*services[1:])
        yield supervisor
    finally:
        supervisor.stop()
