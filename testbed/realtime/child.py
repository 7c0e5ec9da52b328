"""One service as a process of its own: how it is started, what it says, how it ended."""

import ctypes
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from foundation.event_log import event_of, in_words
from foundation.incidents import INCIDENTS
from protocol.errors import LongreachError
from testbed.realtime.restarts import how_it_ended

STOP_TIMEOUT_S = 4.0
READY_TIMEOUT_S = 900.0  # of a first start, which compiles, on a busy machine
_NOTE_S = 60.0
INCIDENT_FILE = "incidents.jsonl"
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None, use_errno=True)

Say = Callable[[str], object]


class ServiceFailed(LongreachError):
    """A service did not start, or ended by itself; ``cause`` begins with ``service.``."""


class Service(NamedTuple):
    """One process to run: ``python -m module *arguments``, with ``environment`` beside ours."""

    name: str
    module: str
    arguments: tuple[str, ...]
    environment: tuple[tuple[str, str], ...] = ()

    def numbered(self, start: int) -> "Service":
        """As it is started the first, second, … time: from the second on its records have a number."""
        if start == 1 or "--record-dir" not in self.arguments:
            return self
        arguments = list(self.arguments)
        arguments[arguments.index("--record-dir") + 1] += f".{start}"
        return self._replace(arguments=tuple(arguments))


class Child:
    """A running service. Its stdout is read for the ready line, its stderr goes to ``log``.

    ``complain`` gets what it says of level error, and that the disk fills, from a thread of its own. Its
    incidents are noted beside ``log``.
    """

    def __init__(self, service: Service, log: Path, complain: Say) -> None:
        self.name, self.arguments = service.name, service.arguments
        self.ready: dict[str, Any] | None = None
        self._complain = complain
        self._last_line = self._last_error = ""
        self._is_ending = False
        self._reported_ready = threading.Event()
        environment = {INCIDENTS: str(log.parent.absolute() / INCIDENT_FILE)} | dict(service.environment)
        self._process = subprocess.Popen(
            [sys.executable, "-m", service.module, *service.arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env=os.environ | environment,
            # Ctrl-C is ours to pass on, in order. Not a session of its own: kernels that share a processor
            # between sessions (sched_autogroup) would let the idle renderer take as much as vision.
            process_group=0,
            # The kernel sends SIGTERM when the supervisor dies without ending it.
            preexec_fn=lambda: _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM),
        )
        self.pid = self._process.pid
        self._readers = [
            threading.Thread(target=self._read_stdout, daemon=True),
            threading.Thread(target=self._read_stderr, args=(log,), daemon=True),
        ]
        for reader in self._readers:
            reader.start()

    @property
    def exit_status(self) -> int | None:
        """The exit status; None while it runs."""
        return self._process.poll()

    @property
    def ended_unasked(self) -> bool:
        """Whether it ended although this supervisor had not asked it to."""
        return self.exit_status is not None and not self._is_ending

    def _read_stdout(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                with suppress(ValueError):
                    event = json.loads(line)
                    if isinstance(event, dict) and event.get("event") == "ready":
                        self.ready = event
                        self._reported_ready.set()
        self._reported_ready.set()  # the end of stdout: nothing more to wait for

    def _read_stderr(self, log: Path) -> None:
        """Keep the lines in ``log``. On a full disk they are lost, and the service is still read."""
        assert self._process.stderr is not None
        is_kept = True
        with log.open("wb", buffering=0) as file, self._process.stderr as lines:
            for line in lines:
                try:
                    if is_kept:
                        file.write(line.encode())
                except OSError as error:
                    is_kept = False
                    why = f"recording.unwritable: {log}: {error.strerror}; further lines are not kept"
                    self._complain(f"{self.name}: {why}")
                self._last_line = line.strip() or self._last_line
                self._sort(self._last_line)

    def _sort(self, line: str) -> None:
        """Keep what went wrong; what is no event is a refusal to start or a traceback."""
        event = event_of(line)
        if event is None or event.get("level", "info") != "info":
            self._last_error = line
        if event is not None and (event.get("level") == "error" or event["event"] == "disk_low"):
            self._complain(f"{self.name}: {in_words(line)}")

    def wait_ready(self, say: Say, timeout_s: float = READY_TIMEOUT_S) -> None:
        """Wait for the ready line; ``say`` gets a note now and then. Raises ServiceFailed."""
        until_s = time.monotonic() + timeout_s
        while not self._reported_ready.wait(min(_NOTE_S, timeout_s)):
            if time.monotonic() > until_s:
                last = in_words(self._last_line) or "it said nothing"
                raise ServiceFailed("service.not_ready", f"{self.name} in {timeout_s:.0f} s: {last}")
            say(f"{self.name} is starting: a first start compiles")
        if self.ready is None:
            raise self.failure("before it was ready")

    def failure(self, when: str) -> ServiceFailed:
        """The error that tells how this service ended, and what it last complained of."""
        return ServiceFailed("service.exited", f"{self.name} ended {when} with {self.how_it_ended()}")

    def how_it_ended(self) -> str:
        """Signal or status, and why as far as it is known, of a process that has ended."""
        status = self._settle()
        if status is None:
            return "its output closed, and runs on"
        last_words = self._last_line if event_of(self._last_line) is None else ""
        # Who is killed says nothing of it: what it had complained of before is no reason.
        event = last_words if status < 0 else in_words(self._last_error)
        return how_it_ended(status, event)

    def _settle(self) -> int | None:
        """The exit status, once it and the last line of an ended process are known."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(STOP_TIMEOUT_S)
            for reader in self._readers:
                reader.join(1.0)
        return self.exit_status

    def kill(self) -> None:
        """Send SIGKILL, for trials of what the others then do."""
        self._process.kill()
        self._process.wait()

    def end(self, timeout_s: float = STOP_TIMEOUT_S) -> int:
        """The exit status, after SIGTERM and, where that does not help in time, SIGKILL."""
        self._is_ending = True
        self._process.terminate()
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
        self._settle()
        return self._process.wait()
