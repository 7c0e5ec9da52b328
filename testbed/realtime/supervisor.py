"""Starts the three services as processes of their own, watches them, and ends them cleanly."""

import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from testbed.realtime.child import STOP_TIMEOUT_S, Child, Service, process_state

READY_TIMEOUT_S = 180.0  # a first start compiles the numba kernels
STALLED_S = 1.5  # without a sign of life

Report = Callable[[float, str], None]


def _silent(_progress: float, _note: str) -> None:
    """Ignore progress, for callers that show none."""


class Supervisor:
    """The running services, in the order of their start."""

    def __init__(self, log_dir: Path) -> None:
        log_dir.mkdir(parents=True, exist_ok=True)
        self._log_dir = log_dir
        self._starts: Counter[str] = Counter()
        self._stalled: set[str] = set()
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
                child._settle()
                raise child.failure("by itself")

    def watch(
        self,
        seconds: float | None = None,
        interval_s: float = 0.25,
        tell: Callable[[str], None] | None = None,
    ) -> None:
        """Watch the services for ``seconds`` (None: for ever). Raises ServiceFailed when one ends.

        With ``tell``, what they complain of is told, and which one has stalled; and one that another asked to
        end (SIGTERM) is started anew, alone.
        """
        until = None if seconds is None else time.monotonic() + seconds
        while until is None or time.monotonic() < until:
            if tell is not None:
                self._renew(tell)
                self._tell_troubles(tell)
            self.check()
            time.sleep(interval_s)

    def _renew(self, tell: Callable[[str], None]) -> None:
        for child in list(self.children.values()):
            if child.ended_in_good_order:
                child.end()
                self.start(child.service)
                anew = self.children[child.name].pid
                tell(f"{child.name} was asked to end and is started anew: process {anew}")

    def _tell_troubles(self, tell: Callable[[str], None]) -> None:
        for child in self.children.values():
            while child.alarms:
                tell(f"{child.name}: {child.alarms.popleft()}")
            silent_s = child.silence_s()
            if (silent_s > STALLED_S) == (child.name in self._stalled) or child.exit_status is not None:
                continue
            if silent_s > STALLED_S:
                self._stalled.add(child.name)
                state = process_state(child.pid)
                tell(f"{child.name} has stalled: no sign of life for {silent_s:.1f} s, {state}")
            else:
                self._stalled.remove(child.name)
                tell(f"{child.name} goes on")

    def stop(self) -> dict[str, int]:
        """The exit status of each service; they are ended the last first, in four seconds together."""
        deadline_s = time.monotonic() + STOP_TIMEOUT_S
        order = list(self.children.values())[::-1]
        return {child.name: child.end(max(deadline_s - time.monotonic(), 0.2)) for child in order}


@contextmanager
def supervised(services: Sequence[Service], log_dir: Path, report: Report = _silent) -> Iterator[Supervisor]:
    """The ``services`` running and ready, in a block that ends them however it is left.

    The first is ready before the others, which need it, are started together. Raises ServiceFailed with the
    last stderr line of the service that did not start.
    """
    supervisor = Supervisor(log_dir)
    try:
        report(0.0, "the first time ever it compiles for a while")
        supervisor.start(*services[:1])
        report(0.5, "")
        supervisor.start(*services[1:])
        yield supervisor
    finally:
        supervisor.stop()


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """A port of 127.0.0.1 that was free a moment ago."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
