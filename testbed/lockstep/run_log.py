"""The event log of a lockstep run: JSON lines with simulated time, and their hash."""

import hashlib
import json
from typing import Any

from testbed.reporting.console import plain


class RunLog:
    """Events in order. Two runs are the same exactly when their digests are."""

    def __init__(self) -> None:
        self.events: list[dict[str, Any]] = []
        self._hash = hashlib.sha256()

    def add(self, time_ns: int, event: str, **fields: Any) -> None:
        """Append the event to the log. Floats enter the hash with all their digits."""
        entry = {"time_ns": time_ns, "event": event, **plain(fields)}
        self.events.append(entry)
        self._hash.update(json.dumps(entry, sort_keys=True).encode() + b"\n")

    def digest(self) -> str:
        """SHA-256 of all lines so far, in hexadecimal."""
        return self._hash.hexdigest()

    def __deepcopy__(self, memo: dict[int, Any]) -> "RunLog":
        """A log of its own that goes on from here: what a forked world writes to."""
        other = RunLog()
        other.events = list(self.events)
        other._hash = self._hash.copy()
        memo[id(self)] = other
        return other
