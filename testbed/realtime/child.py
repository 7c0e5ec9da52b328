"""One service as a process of its own: how it is started, what it says, whether it lives, how it ended."""

import ctypes
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import psutil

from foundation.event_log import event_of, in_words
from foundation.incidents import INCIDENTS
from foundation.live.wire import SHARED_VARIABLE
from foundation.recording.beginning import SESSION_VARIABLE
from foundation.service_main import LONGEST_SILENCE, SOCKET, Listener
from protocol.errors import LongreachError
from testbed.realtime.complaints import Complaint, complaint_of
from testbed.realtime.restarts import how_it_ended, oom_kills

STOP_TIMEOUT_S = 4.0
_SIGNS_WITHIN_S = 1.0
_ALARMS_MAX = 20  # that wait to be told
_ALARMING = ("overloaded", "disk_low")  # warnings that a person should see at once
_VMSTAT = Path("/proc/vmstat")
INCIDENT_FILE = "incidents.jsonl"
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None, use_errno=True)


class ServiceFailed(LongreachError):
    """A service did not start, or ended by itself; ``cause`` begins with ``service.``."""


class Service(NamedTuple):
    """One process to run: ``python -m module *arguments``. ``session``: that its recordings are of;
    ``feeds``: the live face that it feeds.
    """

    name: str
    module: str
    arguments: tuple[str, ...]
    session: str = ""
    feeds: str = ""

    def numbered(self, start: int) -> "Service":
        """As it is started the first, second, … time: from the second on its records have a number."""
        if start == 1 or "--record-dir" not in self.arguments:
            return self
        place = self.arguments.index("--record-dir") + 1
        renamed = f"{self.arguments[place]}.{start}"
        return self._replace(arguments=(*self.arguments[:place], renamed, *self.arguments[place + 1 :]))


class Child:
    """A running service. Its stdout is read for the ready line, its stderr goes to ``log``.

    ``alarms``: what it said of level error, and that the machine is overloaded, until it is taken. Its
    incidents are noted beside ``log``.
    """

    def __init__(self, service: Service, log: Path) -> None:
        self.name = service.name
        self.service = service
        self._arguments = service.arguments
        self.ready: dict[str, Any] | None = None
        self.alarms: deque[Complaint] = deque(maxlen=_ALARMS_MAX)
        self._last_line = ""
        self._last_error = ""
        self._log = log
        self._asked_to_end = False
        self._said_ready = threading.Event()
        self._oom_kills = oom_kills(_VMSTAT.read_text())
        self._signs = Listener(f"longreach-{os.getpid()}-{service.name}-{id(self):x}", time.monotonic_ns())
        environment = {SOCKET: self._signs.address, LONGEST_SILENCE: f"{_SIGNS_WITHIN_S * 1e6:.0f}"}
        environment |= {INCIDENTS: str(log.parent.absolute() / INCIDENT_FILE)}
        environment |= {SESSION_VARIABLE: service.session} if service.session else {}
        environment |= {SHARED_VARIABLE: service.feeds} if service.feeds else {}
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
    def arguments(self) -> tuple[str, ...]:
        """What it was started with."""
        return self._arguments

    @property
    def exit_status(self) -> int | None:
        """The exit status; None while it runs."""
        return self._process.poll()

    @property
    def ended_in_good_order(self) -> bool:
        """Whether somebody else than this supervisor asked it to end, and it did."""
        return self.exit_status == 0 and not self._asked_to_end

    @property
    def crashed(self) -> bool:
        """Whether it ended although nobody had asked it to."""
        return self.exit_status not in (None, 0) and not self._asked_to_end

    @property
    def last_line(self) -> str:
        """The last line that it wrote on stderr, in words, or what replaces it."""
        return in_words(self._last_line) or "it said nothing"

    def silence_s(self) -> float:
        """How long the loop that serves has given no sign of life; 0 before it was ready."""
        silent_s = 1e-9 * self._signs.silence_ns(time.monotonic_ns())
        return silent_s if self.ready is not None else 0.0

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
        with _LogFile(self._log) as log, self._process.stderr as lines:
            for line in lines:
                trouble = log.append(line)
                if trouble:
                    self.alarms.append(Complaint(time.time(), "recording.unwritable", trouble))
                self._last_line = line.strip() or self._last_line
                self._sort(self._last_line)

    def _sort(self, line: str) -> None:
        """Keep what went wrong; what is no event is a refusal to start or a traceback."""
        said = event_of(line)
        if said is None:
            self._last_error = line
        elif said.get("level", "info") != "info":
            self._last_error = line
            if said["level"] == "error" or said["event"] in _ALARMING:
                self.alarms.append(complaint_of(line, said))

    def wait_ready(self, timeout_s: float) -> dict[str, Any]:
        """The ready line's fields. Raises ServiceFailed when it ends or stays silent instead."""
        self._said_ready.wait(timeout_s)
        if self.ready is not None:
            self._signs.count_from(time.monotonic_ns())
            return self.ready
        if self._said_ready.is_set():
            raise self.failure("before it was ready")
        raise ServiceFailed(
            "service.not_ready", f"{self.name} was not ready within {timeout_s:.0f} s: {self.last_line}"
        )

    def failure(self, when: str) -> ServiceFailed:
        """The error that tells how this service ended, and what it last complained of."""
        return ServiceFailed("service.exited", f"{self.name} ended {when} with {self.how_it_ended()}")

    def how_it_ended(self) -> str:
        """Signal or status, and why as far as it is known, of a process that has ended."""
        self._settle()
        status = self.exit_status
        if status is None:
            return "its output closed, and runs on"
        last_words = self._last_line if event_of(self._last_line) is None else ""
        # Who is killed says nothing of it: what it had complained of before is no reason.
        said = last_words if status < 0 else in_words(self._last_error)
        return how_it_ended(status, said, oom_kills(_VMSTAT.read_text()) > self._oom_kills)

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
        self._asked_to_end = True
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL, for trials of what the others then do."""
        self._process.kill()
        self._process.wait()
        self._signs.close()

    def end(self, timeout_s: float = STOP_TIMEOUT_S) -> int:
        """The exit status, after SIGTERM and, where that does not help in time, SIGKILL."""
        self.ask_to_end()
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._settle()
        self._signs.close()
        return self._process.returncode


class _LogFile:
    """The file of a service's stderr. On a full disk the lines are lost and the service is still read."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: TextIO | None = path.open("w", encoding="utf-8")

    def __enter__(self) -> "_LogFile":
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            with suppress(OSError):
                self._file.close()

    def append(self, line: str) -> str:
        """Write a line; what there is to tell when that fails the first time, else nothing."""
        if self._file is None:
            return ""
        try:
            self._file.write(line)
            self._file.flush()
        except OSError as error:
            with suppress(OSError):  # what is still buffered has no place either
                self._file.close()
            self._file = None
            return f"recording.unwritable: {self._path}: {error.strerror}; further lines are not kept"
        return ""


def _end_with_parent() -> None:
    """Ask the kernel, in the child, for SIGTERM when the supervisor dies without ending it."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def process_state(pid: int) -> str:
    """What the kernel says that a process does."""
    try:
        state = psutil.Process(pid).status()
    except psutil.NoSuchProcess:
        state = "ended"
    return f"process {pid} is {'stopped by a signal' if state == psutil.STATUS_STOPPED else state}"
