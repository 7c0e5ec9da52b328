"""What became of the services themselves: their crashes.

One file of JSON lines. Whoever starts services anew notes their crashes in it; the vision PC shows it. Nobody
depends on it: a file that cannot be written or read costs the notes alone.
"""

import contextlib
import json
import math
import os
import time
from pathlib import Path
from typing import Any, NamedTuple

INCIDENTS = "LONGREACH_INCIDENTS"
"""The environment's variable for the file."""
_NEWEST = 20
_TAIL_BYTES = 16_384


class ServiceIncident(NamedTuple):
    """``at_s``: seconds since 1970. ``cause``: machine-readable, such as ``service.crashed``."""

    at_s: float
    service: str
    cause: str
    detail: str


def note_incident(service: str, cause: str, detail: str, path: Path | None = None) -> ServiceIncident:
    """Append to ``path``, by default the environment's file, if there is one. Returns what was noted."""
    incident = ServiceIncident(time.time(), service, cause, detail)
    named = path or os.environ.get(INCIDENTS)
    if named:
        with contextlib.suppress(OSError), Path(named).open("a", encoding="utf-8") as file:
            file.write(json.dumps(incident._asdict()) + "\n")
    return incident


class IncidentFile:
    """The newest incidents of a file, which is read again when it has changed."""

    def __init__(self, path: Path | None) -> None:
        """``path``: None has no incidents."""
        self._path = path
        self._version: tuple[int, int] | None = None
        self._read: tuple[ServiceIncident, ...] = ()

    def newest(self) -> tuple[ServiceIncident, ...]:
        """At most twenty, the oldest first. Lines that are no incident are left out."""
        if self._path is None:
            return ()
        with contextlib.suppress(OSError):
            about = self._path.stat()
            if (about.st_mtime_ns, about.st_size) != self._version:
                with self._path.open("rb") as file:
                    file.seek(max(about.st_size - _TAIL_BYTES, 0))
                    lines = file.read(_TAIL_BYTES).decode("utf-8", "replace").splitlines()
                self._read = tuple(filter(None, map(_incident_of, lines)))[-_NEWEST:]
                self._version = (about.st_mtime_ns, about.st_size)
        return self._read


def incidents_here() -> IncidentFile:
    """The file that the environment names."""
    named = os.environ.get(INCIDENTS)
    return IncidentFile(Path(named) if named else None)


def _incident_of(line: str) -> ServiceIncident | None:
    try:
        record: Any = json.loads(line)
        at_s, *words = (record[name] for name in ServiceIncident._fields)
        incident = ServiceIncident(float(at_s), *(str(word)[:400] for word in words))
    except (ValueError, TypeError, KeyError, OverflowError):
        return None
    return incident if math.isfinite(incident.at_s) else None
