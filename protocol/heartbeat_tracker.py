"""The client's heartbeats: when they are due, which are open, and the clock offset from their echoes."""

from protocol.clock_offset import ClockOffset, OffsetEstimate
from protocol.reference_messages import HeartbeatReply
from protocol.session_events import DatagramDropped

HEARTBEATS_PER_TIMEOUT = 5
# A burst at the start makes the offset known within 100 ms.
FIRST_HEARTBEATS = 8
FIRST_PERIOD_NS = 10_000_000
REMEMBERED = 64


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
