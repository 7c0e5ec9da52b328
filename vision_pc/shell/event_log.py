"""The vision PC's event log: JSON lines on stderr and, with a record directory, in ``events.jsonl`` there.

A thread of its own writes stderr: a console that hangs loses lines, and nothing else stops.
"""

import contextlib
import json
import queue
import sys
import threading
import time
from pathlib import Path
from typing import Any, TextIO

from protocol.errors import ConfigurationError

_WAITING_MAX = 2000
_CLOSE_TIMEOUT_S = 0.5


class EventLog:
    """Writes one JSON object a line: ``event``, ``time_ns`` (monotonic), ``utc`` and what the caller adds."""

    def __init__(self, record_dir: Path | None, stream: TextIO | None = None) -> None:
        """Raises ConfigurationError when the record directory cannot be written."""
        self.record_dir = record_dir
        self._file = None if record_dir is None else _opened(record_dir)
        self._stream = sys.stderr if stream is None else stream
        self._lines: queue.Queue[str | None] = queue.Queue(_WAITING_MAX)
        self._thread = threading.Thread(target=self._write_lines, name="event-log", daemon=True)
        self._thread.start()

    @property
    def healthy(self) -> bool:
        """Whether everything so far could be written to the record directory, if there is one."""
        return self.record_dir is None or self._file is not None

    def write(self, event: str, **fields: Any) -> None:
        """Appends one line. A full disk ends the recording, never the service."""
        utc = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        line = json.dumps({"event": event, "time_ns": time.monotonic_ns(), "utc": utc, **fields}, default=str)
        self._show(line)
        if self._file is not None:
            try:
                self._file.write(line + "\n")
            except OSError as error:
                with contextlib.suppress(OSError):  # what is still buffered has no place either
                    self._file.close()
                self._file = None
                self._show(json.dumps({"event": "recording_failed", "detail": error.strerror}))

    def close(self) -> None:
        """Writes what waits, for half a second at most, and closes the file."""
        if self._file is not None:
            self._file.close()
            self._file = None
        try:
            self._lines.put(None, timeout=_CLOSE_TIMEOUT_S)
        except queue.Full:
            return
        self._thread.join(_CLOSE_TIMEOUT_S)

    def flush(self) -> None:
        """Waits until all lines so far are shown."""
        self._lines.join()

    def _show(self, line: str) -> None:
        try:
            self._lines.put_nowait(line)
        except queue.Full:
            return

    def _write_lines(self) -> None:
        while True:
            line = self._lines.get()
            try:
                if line is None:
                    return
                self._stream.write(line + "\n")
                self._stream.flush()
            except (OSError, ValueError):  # a closed pipe
                continue
            finally:
                self._lines.task_done()


def _opened(record_dir: Path) -> TextIO:
    try:
        record_dir.mkdir(parents=True, exist_ok=True)
        return (record_dir / "events.jsonl").open("a", encoding="utf-8", buffering=1)
    except OSError as error:
        why = f"{record_dir}: {error.strerror}"
        raise ConfigurationError("configuration.record_dir_unwritable", why) from error
