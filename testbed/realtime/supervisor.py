"""Watching over the services until they end, and starting anew those that end before."""

import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from foundation.incidents import ServiceIncident, note_incident
from testbed.realtime.child import (
    INCIDENT_FILE,
    READY_TIMEOUT_S,
    STOP_TIMEOUT_S,
    Child,
    Say,
    Service,
    ServiceFailed,
)

MOST_CRASHES = 3  # within the window; the last of them ends all
_WINDOW_S = 60.0
_PAUSE_S = 1.0  # before each restart within the window but the first
_MOST_COMPLAINTS = 20  # that wait to be told

Tell = Callable[[float, str], None]
"""Is told when something happened (seconds since 1970), and what."""


class Supervisor:
    """The running services, in the order of their start. ``most_crashes``: the last of them ends all."""

    def __init__(self, log_dir: Path, most_crashes: int = MOST_CRASHES) -> None:
        log_dir.mkdir(parents=True, exist_ok=True)
        self._log_dir = log_dir
        self._most_crashes = most_crashes
        self._services: dict[str, Service] = {}
        self._starts: Counter[str] = Counter()
        self._crashes: list[ServiceIncident] = []
        self._complaints: deque[str] = deque(maxlen=_MOST_COMPLAINTS)
        self.children: dict[str, Child] = {}

    def launch(self, service: Service) -> Child:
        """The service just started, not yet ready. From its second start on its log has a number."""
        self._services[service.name] = service
        self._starts[service.name] += 1
        number = self._starts[service.name]
        log = self._log_dir / f"{service.name}{f'.{number}' if number > 1 else ''}.log"
        self.children[service.name] = Child(service.numbered(number), log, self._complaints.append)
        return self.children[service.name]

    def start(self, *services: Service, say: Say, timeout_s: float = READY_TIMEOUT_S) -> None:
        """Start the ``services`` together and wait until all are ready. Raises ServiceFailed."""
        for child in [self.launch(service) for service in services]:
            child.wait_ready(say, timeout_s)

    def check(self) -> None:
        """Raise ServiceFailed when a service has ended by itself."""
        for child in self.children.values():
            if child.exit_status is not None:
                raise child.failure("by itself")

    def watch(self, seconds: float | None = None, interval_s: float = 0.25, tell: Tell | None = None) -> None:
        """Watch the services for ``seconds`` (None: for ever). Raises ServiceFailed when one ends.

        With ``tell``, what they complain of is told; and one that ended by itself is started anew, alone:
        crashes in quick succession end all.
        """
        until = None if seconds is None else time.monotonic() + seconds
        while until is None or time.monotonic() < until:
            if tell is not None:
                while self._complaints:
                    tell(time.time(), self._complaints.popleft())
                for child in [child for child in self.children.values() if child.ended_unasked]:
                    self._start_anew(child, tell)
            self.check()
            time.sleep(interval_s)

    def _start_anew(self, child: Child, tell: Tell) -> None:
        """Raises ServiceFailed with the first crash of too many."""
        how = "crashed" if child.exit_status else "ended"
        detail = f"{child.name} {how} with {child.how_it_ended()}"
        child.end()
        note = f"{detail}; it is started anew", self._log_dir / INCIDENT_FILE
        incident = note_incident(child.name, "service.crashed", *note)
        tell(incident.at_s, detail)
        earlier = [crash for crash in self._crashes if incident.at_s - crash.at_s < _WINDOW_S]
        self._crashes = [*earlier, incident._replace(detail=detail)]
        if len(self._crashes) >= self._most_crashes:
            first, at = self._crashes[0], time.strftime("%H:%M:%S", time.localtime(self._crashes[0].at_s))
            why = f"{len(self._crashes)} crashes within a minute; the first, at {at}: {first.detail}"
            raise ServiceFailed("service.crashed", why)
        time.sleep(_PAUSE_S * len(earlier))
        anew = self.launch(self._services[child.name])
        try:
            anew.wait_ready(lambda _note: None)
        except ServiceFailed:
            if not anew.ended_unasked:
                raise
            return  # the next look at it counts it as one more
        tell(time.time(), f"{child.name} is ready again: process {anew.pid}; the arm stays disabled")

    def stop(self) -> dict[str, int]:
        """The exit status of each service; they are ended the last first, in four seconds together."""
        deadline_s = time.monotonic() + STOP_TIMEOUT_S
        order = list(self.children.values())[::-1]
        return {child.name: child.end(max(deadline_s - time.monotonic(), 0.2)) for child in order}


@contextmanager
def supervised(
    services: Sequence[Service],
    log_dir: Path,
    say: Say = lambda _note: None,
    most_crashes: int = MOST_CRASHES,
) -> Iterator[Supervisor]:
    """The ``services`` running and ready, in a block that ends them however it is left.

    The first is ready before the others, which need it, are started together. Raises ServiceFailed with the
    last stderr line of the service that did not start.
    """
    supervisor = Supervisor(log_dir, most_crashes)
    try:
        say("a first start compiles kernels, for minutes on a busy machine")
        supervisor.start(*services[:1], say=say)
        supervisor.start(*services[1:], say=say)
        yield supervisor
    finally:
        supervisor.stop()
