"""The reference link over UDP: an asyncio endpoint that carries the datagrams of a ``ReferenceLink``."""

import asyncio
import secrets
from collections.abc import Callable
from typing import Any, cast

from foundation.secret_source import read_key
from protocol.client_session import ReferenceClient
from protocol.errors import LinkLost
from protocol.reference_messages import FLAG_PLANT_LINK_OK, Request
from protocol.session_events import (
    AcknowledgementReceived,
    ClientEvent,
    Connected,
    DatagramDropped,
    SessionLost,
    StateReceived,
    StreamRefusedReceived,
)
from vision_pc.application.ports import Clock, FrameSource, Log
from vision_pc.application.reference_link import ReferenceLink, Streamed, Submitted
from vision_pc.config.vision import LinkSettings
from vision_pc.core.types import StereoPair


class MachineWatch:
    """Calls ``begun_anew`` when the plant was silent and the camera counts its pictures from the start again.

    Either alone is no reason: a camera that is plugged in anew stands where it stood, and what the arm did
    while its fieldbus was interrupted, the encoders tell.
    """

    def __init__(
        self, frames: FrameSource[StereoPair], link: ReferenceLink, begun_anew: Callable[[], None]
    ) -> None:
        self._frames = frames
        self._link = link
        self._begun_anew = begun_anew
        self._silent = False  # the plant was, and no picture of the same row has come since
        self._counts_anew = False
        self._answers_ns = 0
        self._last: StereoPair | None = None
        link.listeners.append(self._on_heard)

    def _on_heard(self, event: Submitted | Streamed | ClientEvent) -> None:
        if isinstance(event, SessionLost):
            self._silent, self._answers_ns = True, 0
        elif isinstance(event, StateReceived):
            self._judge(bool(event.state.flags & FLAG_PLANT_LINK_OK))

    def _judge(self, answers: bool) -> None:
        if not answers:
            self._silent, self._answers_ns = True, 0
        elif not self._answers_ns:
            self._answers_ns = self._link.now_ns
        newest, last = self._frames.newest, self._last
        if newest is not None and newest is not last:
            self._counts_anew |= last is not None and newest.frame_id < last.frame_id
            self._last = newest
        if not answers:
            return
        if self._silent and self._counts_anew:
            self._silent = False
            self._begun_anew()
        elif newest is not None and newest.capture_ns > self._answers_ns:
            self._silent = False  # the camera's own row of pictures has gone on
        if not self._silent:
            self._counts_anew = False


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
            self._on_answer(event)
        elif isinstance(event, StreamRefusedReceived):
            self._stream_refused(event)
        elif isinstance(event, Connected):
            self._log.write("link_connected", session=f"{event.session:x}", cycle_ns=event.welcome.cycle_ns)
        elif isinstance(event, SessionLost):
            self._open.clear()
            lost = {"reason": event.reason.name.lower(), "unanswered": len(event.unanswered)}
            self._log.write("link_lost", "warning", **lost)
        elif isinstance(event, DatagramDropped):
            self._on_drop(event)

    def _on_answer(self, event: AcknowledgementReceived) -> None:
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

    def _on_drop(self, event: DatagramDropped) -> None:
        if self._clock.now_ns - self._drop_logged_ns > _LOG_DROPS_NS:
            self._drop_logged_ns = self._clock.now_ns
            self._log.write("datagram_dropped", "warning", cause=event.cause, detail=event.detail)


class UdpEndpoint(asyncio.DatagramProtocol):
    """A socket to the controller at ``settings.host`` with the ``link`` over it.

    ``arm_hash``: of the arm that the controller must drive, or ``ANY_ARM``.
    """

    def __init__(self, settings: LinkSettings, arm_hash: int, log: Log, clock: Clock) -> None:
        self._address = (settings.host, settings.port)
        self._clock = clock
        self._transport: asyncio.DatagramTransport | None = None
        self._timer: asyncio.TimerHandle | None = None
        session = ReferenceClient(
            secrets.randbits(64), arm_hash, settings.state_period_ms, key=read_key(settings.link_key)
        )
        peer = f"controller at {settings.host}:{settings.port}"
        self.link = ReferenceLink(session, clock, self, LinkJournal(log, clock), peer)

    async def start(self) -> None:
        """Open the socket and begin to connect; does not wait for the controller.

        Raises LinkLost (``link.no_address``) when the host is not known.
        """
        try:
            await asyncio.get_running_loop().create_datagram_endpoint(lambda: self, remote_addr=self._address)
        except OSError as error:
            host, port = self._address
            raise LinkLost("link.no_address", f"controller at {host}:{port}: {error}") from error
        self.link.connect()

    async def close(self) -> None:
        """Tell the controller and close the socket."""
        self.link.disconnect()
        if self._timer is not None:
            self._timer.cancel()
        if self._transport is not None:
            self._transport.close()

    def flush(self) -> None:
        """Send what the link wants sent, and set the timer for its next deadline."""
        now_ns = self._clock.now_ns
        if self._transport is not None and not self._transport.is_closing():
            for datagram in self.link.outgoing(now_ns):
                self._transport.sendto(datagram)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        deadline_ns = self.link.next_deadline_ns()
        if deadline_ns is not None:
            delay_s = max((deadline_ns - now_ns) / 1e9, 0.0)
            self._timer = asyncio.get_running_loop().call_later(delay_s, self._tick)

    def _tick(self) -> None:
        self._timer = None
        self.link.tick()
        self.flush()

    # asyncio's side
    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)  # uvloop's is of no class of asyncio's

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self.link.receive(data)
        self.flush()

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there (yet): the session's own timeouts deal with it."""
