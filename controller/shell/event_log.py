"""JSON lines on stderr, written by a thread of their own: a reader that hangs never holds up the scan."""

import json
import queue
import sys
import threading
import time
from typing import Any, TextIO

_WAITING_MAX = 2000
_CLOSE_TIMEOUT_S = 0.5


class EventLog:
    """Writes one JSON object a line: ``event``, ``time_ns`` (CLOCK_MONOTONIC), ``level``, fields."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._lines: queue.Queue[str | None] = queue.Queue(_WAITING_MAX)
        self.dropped = 0
        self._thread = threading.Thread(target=self._write_lines, name="event-log", daemon=True)
        self._thread.start()

    def write(self, event: str, level: str = "info", **fields: Any) -> None:
        """Queue one line; it is dropped and counted when too many wait."""
        line = json.dumps({"event": event, "time_ns": time.monotonic_ns(), "level": level, **fields})
        try:
            self._lines.put_nowait(line)
        except queue.Full:
            self.dropped += 1

    def close(self) -> None:
        """Write what waits, for as long as that takes half a second at most."""
        try:
            self._lines.put(None, timeout=_CLOSE_TIMEOUT_S)
        except queue.Full:
            return
        self._thread.join(_CLOSE_TIMEOUT_S)

    def _write_lines(self) -> None:
        while (line := self._lines.get()) is not None:
            try:
                self._stream.write(line + "\n")
                self._stream.flush()
            except (OSError, ValueError):  # a closed pipe ends the log, never the control
                self.dropped += 1
