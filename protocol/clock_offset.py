"""Offset between two monotonic clocks from the four times of each echo, with a bound that holds.

A request left at t0 and its reply came back at t3 on the local clock; the peer received at t1 and replied at
t2 on its own. No datagram arrives before it was sent, so  t2 − t3 ≤ offset ≤ t1 − t0.  Every echo gives such
an interval. The intersection of the newest ones keeps the fastest way out and the fastest way back, whichever
echo they came from, and its half width bounds the error under any asymmetry of the delays.
(Intersection of intervals after Marzullo, RFC 5905 section 11.2.1, applied to one server over time.)
Below it the client's heartbeats, whose echoes it takes: when they are due, and which are open.
"""

from collections import deque
from collections.abc import Collection
from typing import NamedTuple

from protocol.reference_messages import HeartbeatReply
from protocol.session_events import DatagramDropped

WINDOW = 64
DRIFT_PPM = 100
DISPUTED_TO_RESET = 3
HEARTBEATS_PER_TIMEOUT = 5
# A burst at the start makes the offset known within 100 ms.
FIRST_HEARTBEATS = 8
FIRST_PERIOD_NS = 10_000_000
REMEMBERED = 64


class OffsetEstimate(NamedTuple):
    """``offset_ns`` is the peer's clock minus the local one; it is within ``uncertainty_ns`` of the truth."""

    offset_ns: int
    uncertainty_ns: int
    round_trip_ns: int


class _Echo(NamedTuple):
    low_ns: int
    high_ns: int
    local_ns: int


class ClockOffset:
    """Filter over the newest echoes; an echo that contradicts them is set aside as an outlier.

    Three outliers in a row that agree with one another mean that the peer's clock stepped: they replace the
    rest.
    """

    def __init__(self) -> None:
        self._echoes: deque[_Echo] = deque(maxlen=WINDOW)
        self._disputed: list[_Echo] = []
        self._round_trip_ns = 0
        self.outliers = 0

    def add(self, sent_ns: int, received_ns: int, replied_ns: int, returned_ns: int) -> bool:
        """Whether the echo was taken; times t0, t1, t2, t3 of the module's description."""
        round_trip_ns = (returned_ns - sent_ns) - (replied_ns - received_ns)
        if round_trip_ns < 0 or replied_ns < received_ns:
            self.outliers += 1
            return False
        echo = _Echo(replied_ns - returned_ns, received_ns - sent_ns, returned_ns)
        if _intersection([*self._echoes, echo], returned_ns) is None:
            return self._dispute(echo)
        self._disputed.clear()
        self._echoes.append(echo)
        self._round_trip_ns = round_trip_ns
        return True

    def estimate(self, now_ns: int) -> OffsetEstimate | None:
        """The offset as known at local time ``now_ns``, or None before the first echo."""
        interval = _intersection(self._echoes, now_ns)
        if not self._echoes or interval is None:
            return None
        low_ns, high_ns = interval
        return OffsetEstimate((low_ns + high_ns) // 2, (high_ns - low_ns + 1) // 2, self._round_trip_ns)

    def _dispute(self, echo: _Echo) -> bool:
        self.outliers += 1
        if _intersection([*self._disputed, echo], echo.local_ns) is None:
            self._disputed.clear()
        self._disputed.append(echo)
        if len(self._disputed) < DISPUTED_TO_RESET:
            return False
        self._echoes = deque(self._disputed, maxlen=WINDOW)
        self._disputed = []
        return True


def _intersection(echoes: Collection[_Echo], now_ns: int) -> tuple[int, int] | None:
    """What all echoes allow at ``now_ns``, each widened by the drift since; None if they disagree."""
    if not echoes:
        return None
    low_ns = max(echo.low_ns - _drift_ns(now_ns - echo.local_ns) for echo in echoes)
    high_ns = min(echo.high_ns + _drift_ns(now_ns - echo.local_ns) for echo in echoes)
    return (low_ns, high_ns) if low_ns <= high_ns else None


def _drift_ns(elapsed_ns: int) -> int:
    return elapsed_ns * DRIFT_PPM // 1_000_000


class HeartbeatTracker:
    """One session's heartbeats; ``now_ns`` is the client's clock throughout."""

    def __init__(self, link_timeout_ns: int, now_ns: int) -> None:
        self.due_ns = now_ns
        self._regular_ns = link_timeout_ns // HEARTBEATS_PER_TIMEOUT
        self._sent = 0
        self._open: dict[int, None] = {}
        self._offset = ClockOffset()
        self._estimate: OffsetEstimate | None = None

    def schedule_next(self, now_ns: int) -> None:
        """Notes that a heartbeat was queued; missed ones are not made up for."""
        self._sent += 1
        period_ns = self._regular_ns
        if self._sent < FIRST_HEARTBEATS:
            period_ns = min(period_ns, FIRST_PERIOD_NS)
        self.due_ns = max(self.due_ns + period_ns, now_ns)

    def sent(self, sent_ns: int) -> None:
        """Notes that a heartbeat with this time left."""
        self._open[sent_ns] = None
        if len(self._open) > REMEMBERED:
            del self._open[next(iter(self._open))]

    def returned(self, reply: HeartbeatReply, now_ns: int) -> DatagramDropped | None:
        """None if the echo was used, else why not. Every heartbeat counts once."""
        if reply.sent_ns not in self._open:
            return DatagramDropped("clock.unexpected_echo", f"heartbeat of {reply.sent_ns} ns is not open")
        del self._open[reply.sent_ns]
        taken = self._offset.add(reply.sent_ns, reply.received_ns, reply.replied_ns, now_ns)
        self._estimate = self._offset.estimate(now_ns)
        if taken:
            return None
        return DatagramDropped("clock.outlier", "the echo contradicts those before it")

    def estimate(self) -> OffsetEstimate | None:
        """Controller's clock minus the client's, as of the newest echo; None before the first."""
        return self._estimate
