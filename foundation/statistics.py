"""Statistics about a process itself, for people and for soak tests: a JSON file and the memory in use."""

import asyncio
import json
import os
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from foundation.event_log import EventLog
from foundation.recording.recovery import writable_directory

_PERIOD_S = 10.0
_PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 1e6


class StatisticsFile:
    """A file of one JSON object, replaced as a whole: a reader sees the old one or the new one."""

    def __init__(
        self, path: Path | None, service: str, log: EventLog, gather: Callable[[], Mapping[str, Any]]
    ) -> None:
        """``path``: None writes nothing; ``gather`` returns what is written. Raises ConfigurationError
        when its directory is not writable.
        """
        self._path = path
        self._service = service
        self._log = log
        self._gather = gather
        self._replacing = threading.Lock()
        if path is not None:
            writable_directory(path.parent, "configuration.statistics_unwritable", f"--statistics {path}")

    async def keep_writing(self) -> None:
        """Write every ten seconds, until cancelled; in a thread: a disk may hang longer than a link."""
        while True:
            await asyncio.sleep(_PERIOD_S)
            if self._path is not None:
                await asyncio.to_thread(self._replace, self._path, self._text())

    def write(self) -> None:
        """Write the statistics of now, with the service's name before them. A failure is logged."""
        if self._path is not None:
            self._replace(self._path, self._text())

    def _text(self) -> str:
        shown = {"service": self._service, **self._gather(), "log_lines_dropped": self._log.dropped}
        return json.dumps(shown, indent=2) + "\n"

    def _replace(self, path: Path, text: str) -> None:
        partial = path.with_name(path.name + ".part")
        try:
            with self._replacing:
                partial.write_text(text, encoding="utf-8")
                partial.replace(path)
        except OSError as error:
            why = f"{path}: {error.strerror}"
            self._log.write("statistics_failed", "error", cause="statistics.unwritable", detail=why)


def resident_mb(pid: int | None = None) -> float:
    """Resident memory of a process (None: this one) in MB; 0 when it has gone."""
    try:
        text = Path(f"/proc/{pid or 'self'}/statm").read_text(encoding="ascii")
    except OSError:
        return 0.0
    return int(text.split()[1]) * _PAGE_MB
