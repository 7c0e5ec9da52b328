"""The link's story in the event log: sessions, answers, refused streams, datagrams that were not used."""

from protocol.reference_messages import Request
from protocol.session_events import (
    AcknowledgementReceived,
    ClientEvent,
    Connected,
    DatagramDropped,
    SessionLost,
    StreamRefusedReceived,
)
from vision_pc.application.ports import Clock, Log
from vision_pc.application.reference_link import Streamed, Submitted

_LOG_DROPS_NS = 1_000_000_000  # at most one line a second, whatever the peer sends


class LinkJournal:
    """Implements ``vision_pc.application.reference_link.Journal``."""

    def __init__(self, log: Log, clock: Clock) -> None:
        self._log = log
        self._clock = clock
        self._open: dict[int, Request] = {}
        self._refused_stream: int | None = None
        self._drop_logged_ns = 0

    def __call__(self, event: Submitted | Streamed | ClientEvent) -> None:
        """Write what a reader of the log wants to know of ``event``."""
        if isinstance(event, Submitted):
            self._open[event.command_id] = event.request
        elif isinstance(event, AcknowledgementReceived):
            self._answered(event)
        elif isinstance(event, StreamRefusedReceived):
            self._stream_refused(event)
        elif isinstance(event, Connected):
            self._log.write("link_connected", session=f"{event.session:x}", cycle_ns=event.welcome.cycle_ns)
        elif isinstance(event, SessionLost):
            self._open.clear()
            lost = {"reason": event.reason.name.lower(), "unanswered": len(event.unanswered)}
            self._log.write("link_lost", "warning", **lost)
        elif isinstance(event, DatagramDropped):
            self._dropped(event)

    def _answered(self, event: AcknowledgementReceived) -> None:
        answer = event.acknowledgement
        request = self._open.pop(answer.command_id, None)
        self._log.write(
            "acknowledged",
            request=type(request).__name__,
            command_id=answer.command_id,
            reason=answer.reason.name.lower(),
            value=answer.value,
        )

    def _stream_refused(self, event: StreamRefusedReceived) -> None:
        """One line a stream: every reference after the first refused one is refused too."""
        refusal = event.refusal
        if refusal.stream_id != self._refused_stream:
            self._refused_stream = refusal.stream_id
            self._log.write(
                "stream_refused",
                "warning",
                number=refusal.number,
                reason=refusal.reason.name.lower(),
                value=refusal.value,
            )

    def _dropped(self, event: DatagramDropped) -> None:
        if self._clock.now_ns - self._drop_logged_ns > _LOG_DROPS_NS:
            self._drop_logged_ns = self._clock.now_ns
            self._log.write("datagram_dropped", "warning", cause=event.cause, detail=event.detail)
