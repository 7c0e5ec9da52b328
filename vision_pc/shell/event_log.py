"""The vision PC's event log: JSON lines on stderr and, with a record directory, in ``events.jsonl`` there."""

import json
import sys
import time
from pathlib import Path
from typing import Any, TextIO

from protocol.errors import ConfigurationError


class EventLog:
    """Writes one JSON object a line: ``event``, ``time_ns`` (monotonic), ``utc`` and what the caller adds."""

    def __init__(self, record_dir: Path | None, stream: TextIO | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream
        self.record_dir = record_dir
        self._file: TextIO | None = None
        if record_dir is not None:
            try:
                record_dir.mkdir(parents=True, exist_ok=True)
                self._file = (record_dir / "events.jsonl").open("a", encoding="utf-8", buffering=1)
            except OSError as error:
                why = f"{record_dir}: {error.strerror}"
                raise ConfigurationError("configuration.record_dir_unwritable", why) from error

    @property
    def healthy(self) -> bool:
        """Whether everything so far could be written to the record directory, if there is one."""
        return self.record_dir is None or self._file is not None

    def write(self, event: str, **fields: Any) -> None:
        """Appends one line. A full disk ends the recording, never the service."""
        utc = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        line = json.dumps({"event": event, "time_ns": time.monotonic_ns(), "utc": utc, **fields}, default=str)
        print(line, file=self._stream, flush=True)
        if self._file is not None:
            try:
                self._file.write(line + "\n")
            except OSError:
                self._file = None
                print(json.dumps({"event": "recording_failed"}), file=self._stream, flush=True)

    def close(self) -> None:
        """Closes the file."""
        if self._file is not None:
            self._file.close()
            self._file = None
