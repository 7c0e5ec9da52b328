"""Starts the three services as processes of their own, watches them, and ends them cleanly."""

import ctypes
import json
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from foundation.event_log import in_words
from protocol.errors import LongreachError

READY_TIMEOUT_S = 180.0  # a first start compiles the numba kernels
STOP_TIMEOUT_S = 4.0
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None, use_errno=True)


class ServiceFailed(LongreachError):
    """A service did not start, or ended by itself; ``cause`` begins with ``service.``."""


Report = Callable[[float, str], None]


class Service(NamedTuple):
    """One process to run: ``python -m module *arguments``."""

    name: str
    module: str
    arguments: tuple[str, ...]


class Child:
    """A running service. Its stdout is read for the ready line, its stderr goes to ``log``."""

    def __init__(self, service: Service, log: Path) -> None:
        self.name = service.name
        self.ready: dict[str, Any] | None = None
        self._last_line = ""
        self._log = log
        self._said_ready = threading.Event()
        self._process = subprocess.Popen(
            [sys.executable, "-m", service.module, *service.arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            start_new_session=True,  # Ctrl-C is ours to pass on, in order
            preexec_fn=_end_with_parent,
        )
        self._readers = [
            threading.Thread(target=self._read_stdout, daemon=True),
            threading.Thread(target=self._read_stderr, daemon=True),
        ]
        for reader in self._readers:
            reader.start()

    @property
    def pid(self) -> int:
        """The process number."""
        return self._process.pid

    @property
    def exit_status(self) -> int | None:
        """The exit status; None while it runs."""
        return self._process.poll()

    @property
    def last_line(self) -> str:
        """The last line that it wrote on stderr, in words, or what replaces it."""
        return in_words(self._last_line) or "it said nothing"

    def _read_stdout(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                try:
                    said = json.loads(line)
                except ValueError:
                    continue
                if isinstance(said, dict) and said.get("event") == "ready":
                    self.ready = said
                    self._said_ready.set()
        self._said_ready.set()  # the end of stdout: nothing more to wait for

    def _read_stderr(self) -> None:
        assert self._process.stderr is not None
        with self._log.open("w", encoding="utf-8") as log, self._process.stderr as lines:
            for line in lines:
                log.write(line)
                log.flush()
                self._last_line = line.strip() or self._last_line

    def wait_ready(self, timeout_s: float) -> dict[str, Any]:
        """The ready line's fields. Raises ServiceFailed when it ends or stays silent instead."""
        self._said_ready.wait(timeout_s)
        if self.ready is not None:
            return self.ready
        if self._said_ready.is_set():
            self._settle()
            raise self.failure("before it was ready")
        raise ServiceFailed(
            "service.not_ready", f"{self.name} was not ready within {timeout_s:.0f} s: {self.last_line}"
        )

    def failure(self, when: str) -> ServiceFailed:
        """The error that tells how this service ended."""
        return ServiceFailed(
            "service.exited", f"{self.name} ended {when} with status {self.exit_status}: {self.last_line}"
        )

    def _settle(self) -> None:
        """Wait until exit status and last line of an ended process are known."""
        try:
            self._process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            return
        for reader in self._readers:
            reader.join(1.0)

    def ask_to_end(self) -> None:
        """Send SIGTERM if the process still runs."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL, for trials of what the others then do."""
        self._process.kill()
        self._process.wait()

    def end(self, timeout_s: float = STOP_TIMEOUT_S) -> int:
        """The exit status, after SIGTERM and, where that does not help in time, SIGKILL."""
        self.ask_to_end()
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._settle()
        return self._process.returncode


def _silent(_progress: float, _note: str) -> None:
    """Ignore progress, for callers that show none."""


def _end_with_parent() -> None:
    """Ask the kernel, in the child, for SIGTERM when the supervisor dies without having ended it."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


class Supervisor:
    """The running services, in the order of their start."""

    def __init__(self, log_dir: Path) -> None:
        log_dir.mkdir(parents=True, exist_ok=True)
        self._log_dir = log_dir
        self.children: dict[str, Child] = {}

    def launch(self, service: Service) -> Child:
        """The service just started, not yet ready."""
        child = Child(service, self._log_dir / f"{service.name}.log")
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

    def watch(self, seconds: float | None = None, interval_s: float = 0.25) -> None:
        """Watch the services for ``seconds`` (None: for ever). Raises ServiceFailed when one ends."""
        until = None if seconds is None else time.monotonic() + seconds
        while until is None or time.monotonic() < until:
            self.check()
            time.sleep(interval_s)

    def stop(self) -> dict[str, int]:
        """The exit status of each service; all are ended, the last started first."""
        order = list(self.children.values())[::-1]
        return {child.name: child.end() for child in order}


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
