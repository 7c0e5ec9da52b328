"""What services complain of, as lines for a terminal: each with its own time, none for ever."""

import time
from typing import Any, NamedTuple

from foundation.event_log import in_words

_QUIET_S = 120.0  # a complaint that was silent for so long is news again


class Complaint(NamedTuple):
    """``at_s``: when it happened, seconds since 1970."""

    at_s: float
    cause: str
    words: str


def complaint_of(line: str, said: dict[str, Any]) -> Complaint:
    """A line of an event log, which was read as ``said``."""
    age_ns = time.monotonic_ns() - int(said.get("time_ns", time.monotonic_ns()))
    return Complaint(time.time() - 1e-9 * age_ns, str(said.get("cause") or said["event"]), in_words(line))


class Repetitions:
    """Which complaints are news."""

    def __init__(self) -> None:
        self._last_s: dict[tuple[str, str], float] = {}

    def is_news(self, service: str, complaint: Complaint) -> bool:
        """Whether the service has not complained of the same cause in the two minutes before."""
        kind = (service, complaint.cause)
        last_s = self._last_s.get(kind)
        self._last_s[kind] = complaint.at_s
        return last_s is None or complaint.at_s - last_s >= _QUIET_S
