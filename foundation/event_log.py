"""The event log of every process: JSON lines of one schema, on stderr and, where asked for, in a file.

docs/event_log.md is the written schema. Each line is one object: ``service``, ``event``, ``level``,
``time_ns`` (CLOCK_MONOTONIC, or the plant's clock), ``utc``, then the event's own fields. A thread of its own
writes stderr: a reader that hangs loses lines, which are counted, and holds up nothing. What may come again
and again goes through ``write_repeated``.
"""

import contextlib
import json
import logging
import queue
import sys
import threading
import time
import traceback
from collections.abc import Callable, Generator, Hashable
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Literal, NamedTuple, TextIO, TypeVar

from foundation import clock
from foundation.recording.beginning import recording_directory
from protocol.errors import ConfigurationError, LongreachError

SOONEST_NS = 1_000_000_000
LATEST_NS = 60 * SOONEST_NS

Line = TypeVar("Line")


@dataclass
class _Kind(Generic[Line]):
    """``waiting``: the newest of the ``repeated`` lines that were not written; ``seen_ns``: when one came."""

    seen_ns: int
    due_ns: int
    interval_ns: int = SOONEST_NS
    waiting: Line | None = None
    repeated: int = 0


class RepeatedLines(Generic[Line]):
    """The kinds of lines that came of late; a kind should be one of a limited number of them."""

    def __init__(self) -> None:
        self._kinds: dict[Hashable, _Kind[Line]] = {}

    def put(self, kind: Hashable, line: Line, now_ns: int) -> int:
        """How many lines ``line`` is to be written for, itself included; 0: not now, ``due`` has it later."""
        known = self._kinds.get(kind)
        if known is None or now_ns - known.seen_ns >= SOONEST_NS:
            self._kinds[kind] = _Kind(now_ns, now_ns + SOONEST_NS)
            return 1 + (0 if known is None else known.repeated)
        known.seen_ns, known.waiting = now_ns, line
        known.repeated += 1
        return 0

    def due(self, now_ns: int) -> list[tuple[Line, int]]:
        """The lines whose time has come, each with how many it stands for. Quiet kinds are forgotten."""
        reports: list[tuple[Line, int]] = []
        for kind, known in list(self._kinds.items()):
            if now_ns < known.due_ns:
                continue
            if known.waiting is None:
                if now_ns - known.seen_ns >= SOONEST_NS:
                    del self._kinds[kind]
                continue
            reports.append((known.waiting, known.repeated))
            known.waiting, known.repeated = None, 0
            known.interval_ns = min(2 * known.interval_ns, LATEST_NS)
            known.due_ns = now_ns + known.interval_ns
        return reports

    def rest(self) -> list[tuple[Line, int]]:
        """All lines that wait, as ``due`` has them; nothing is kept."""
        kinds, self._kinds = self._kinds, {}
        return [(each.waiting, each.repeated) for each in kinds.values() if each.waiting is not None]


Level = Literal["info", "warning", "error"]
LEVELS: tuple[Level, ...] = ("info", "warning", "error")
MEMBERS = ("service", "event", "level", "time_ns", "utc")
_EVERY_LINES = frozenset(MEMBERS)
RECORD_FILE = "events.jsonl"
_WAITING_MAX = 2000
_CLOSE_TIMEOUT_S = 0.5
_LOOK_NS = 500_000_000  # how often the thread looks for repetitions that are due


class _Occurrence(NamedTuple):
    """A line before it is one."""

    event: str
    level: Level
    time_ns: int
    fields: dict[str, Any]


class EventLog:
    """Writes one line an event. ``dropped``: lines that stderr did not take.

    ``service``: who writes. ``record_dir``: where the events are also recorded; None without ``record_in``.
    ``room``: whether there is disk left for them, as a ``SelfWatch`` finds. ``listener`` is told every event
    by its name, level and fields, in the thread that writes it.
    """

    def __init__(self, service: str, stream: TextIO | None = None) -> None:
        """``stream``: stderr by default."""
        self.dropped = 0
        self.record_dir: Path | None = None
        self.room = True
        self.listener: Callable[[str, Level, dict[str, Any]], object] | None = None
        self.service = service
        self._stream = sys.stderr if stream is None else stream
        self._file: TextIO | None = None
        self._recording = threading.Lock()
        self._repeated: RepeatedLines[_Occurrence] = RepeatedLines()
        self._repeating = threading.Lock()
        self._lines: queue.Queue[str | None] = queue.Queue(_WAITING_MAX)
        self._thread = threading.Thread(target=self._write_lines, name="event-log", daemon=True)
        self._thread.start()

    def record_in(self, directory: Path) -> None:
        """Append every event to ``events.jsonl`` in ``directory`` too, which is made where it is missing.

        Raises ConfigurationError when it cannot be written.
        """
        self.record_dir = recording_directory(directory)
        try:
            self._file = (directory / RECORD_FILE).open("a", encoding="utf-8", buffering=1)
        except OSError as error:
            why = f"--record-dir {directory}: {RECORD_FILE}: {error.strerror}"
            raise ConfigurationError("configuration.record_dir_unwritable", why) from error

    @property
    def healthy(self) -> bool:
        """Whether everything so far could be recorded, if it is to be, and there is room for more."""
        return self.record_dir is None or (self._file is not None and self.room)

    def write(self, event: str, level: Level = "info", /, **fields: Any) -> None:
        """Append one line. A full disk ends the recording, never the service.

        Raises ValueError for a field that has the name of a member of every line.
        """
        self._append(_occurrence(event, level, fields))

    def write_repeated(self, kind: Hashable, event: str, level: Level = "info", /, **fields: Any) -> None:
        """As ``write``, for what may come again and again: see ``repeated_lines`` for which are written.

        ``kind``: what makes it the same again, such as the cause; of a limited number, never what a stranger
        sent. A line that stands for several has the fields of the last, and their number as ``repeated``.
        """
        occurrence = _occurrence(event, level, fields)
        with self._repeating:
            count = self._repeated.put((event, level, kind), occurrence, occurrence.time_ns)
        if count:
            self._append(_standing_for(occurrence, count))

    def close(self) -> None:
        """Write what waits, for half a second at most, and close the file."""
        self._tell(self._repeated.rest)
        with self._recording:
            if self._file is not None:
                self._file.close()
                self._file = None
        try:
            self._lines.put(None, timeout=_CLOSE_TIMEOUT_S)
        except queue.Full:
            return
        self._thread.join(_CLOSE_TIMEOUT_S)

    def flush(self) -> None:
        """Return when all lines so far are shown."""
        self._lines.join()

    def _append(self, occurrence: _Occurrence) -> None:
        line = self._line(occurrence)
        self._show(line)
        if self.listener is not None:
            self.listener(occurrence.event, occurrence.level, occurrence.fields)
        with self._recording:
            if self._file is not None:
                try:
                    self._file.write(line + "\n")
                except OSError as error:
                    with contextlib.suppress(OSError):  # what is still buffered has no place either
                        self._file.close()
                    self._file = None
                    why = {"cause": "recording.unwritable", "detail": error.strerror}
                    self._show(self._line(_occurrence("recording_failed", "error", why)))

    def _tell(self, which: Callable[[], list[tuple[_Occurrence, int]]]) -> None:
        with self._repeating:
            reports = which()
        for occurrence, count in reports:
            self._append(_standing_for(occurrence, count))

    def _line(self, occurrence: _Occurrence) -> str:
        event, level, time_ns, fields = occurrence
        past_s = (clock.now_ns() - time_ns) * 1e-9
        utc = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(time.time() - past_s))
        members = (self.service, event, level, time_ns, utc)
        return json.dumps(dict(zip(MEMBERS, members, strict=True)) | fields, default=str)

    def _show(self, line: str) -> None:
        try:
            self._lines.put_nowait(line)
        except queue.Full:
            self.dropped += 1

    def _write_lines(self) -> None:
        look_ns = 0
        while True:
            now_ns = clock.now_ns()
            if now_ns >= look_ns:
                look_ns = now_ns + _LOOK_NS
                self._tell(lambda: self._repeated.due(clock.now_ns()))
            try:
                line = self._lines.get(timeout=1e-9 * _LOOK_NS)
            except queue.Empty:
                continue
            try:
                if line is None:
                    return
                self._stream.write(line + "\n")
                self._stream.flush()
            except (OSError, ValueError):  # a closed pipe ends the log, never the service
                self.dropped += 1
            finally:
                self._lines.task_done()


def _occurrence(event: str, level: Level, fields: dict[str, Any]) -> _Occurrence:
    if taken := _EVERY_LINES.intersection(fields):
        raise ValueError(f"event {event}: {', '.join(sorted(taken))} belongs to every line")
    return _Occurrence(event, level, clock.now_ns(), fields)


def _standing_for(last: _Occurrence, count: int) -> _Occurrence:
    return last if count == 1 else last._replace(fields=last.fields | {"repeated": count})


class LibraryMessages(logging.Handler):
    """Writes what libraries log, from WARNING up, as event ``library`` of ``log``."""

    def __init__(self, log: EventLog) -> None:
        super().__init__(logging.WARNING)
        self._log = log

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line for ``record``."""
        fields = {"logger": record.name, "message": record.getMessage()}
        if record.exc_info:
            fields["exception"] = logging.Formatter().formatException(record.exc_info)
        self._log.write("library", "error" if record.levelno >= logging.ERROR else "warning", **fields)


@contextmanager
def process_log(service: str) -> Generator[EventLog, None, None]:
    """The event log of this process; what libraries warn of is written to it.

    An exception that was not raised on purpose is written too, and ends the process with status 1.
    """
    log = EventLog(service)
    handler = LibraryMessages(log)
    logging.getLogger().addHandler(handler)
    logging.captureWarnings(True)
    try:
        yield log
    except LongreachError:
        raise
    except Exception as error:
        why = "".join(traceback.format_exception(error))
        log.write("broken", "error", cause="internal", detail=repr(error), exception=why)
        raise SystemExit(1) from error
    finally:
        logging.captureWarnings(False)
        logging.getLogger().removeHandler(handler)
        log.close()


def event_of(line: str) -> dict[str, Any] | None:
    """A line of the log as its members and fields; None for any other line."""
    try:
        entry = json.loads(line)
    except ValueError:
        return None
    return entry if isinstance(entry, dict) and "event" in entry else None


def in_words(line: str) -> str:
    """A line of the log as one line for a person: ``cause: detail``; any other line is returned as it is."""
    entry = event_of(line)
    if entry is None:
        return line
    cause = entry.get("cause") or entry["event"]
    detail = entry.get("detail") or entry.get("message")
    return f"{cause}: {detail}" if detail else str(cause)
