"""The reference link over UDP: a socket that carries the datagrams of a ``ReferenceLink``."""

import asyncio
import contextlib
import secrets
import socket
from collections.abc import Callable
from typing import Any

from foundation.clock import Cancellable, current, followed
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
from vision_pc.application.camera_feed import CameraFeed
from vision_pc.application.ports import Clock, Log
from vision_pc.application.reference_link import ReferenceLink, Streamed, Submitted
from vision_pc.config.vision import LinkSettings
from vision_pc.core.types import StereoPair
from vision_pc.shell.stops.door_process import DoorProcess

_TRIED_S = 1.0  # for so long an address is tried
_Address = tuple[int, Any]  # family, and what connects to it


class MachineWatch:
    """Calls ``begun_anew`` when the plant was silent and the camera counts its pictures from the start again.

    Either alone is no reason: a camera that is plugged in anew stands where it stood, and what the arm did
    while its fieldbus was interrupted, the encoders tell.
    """

    def __init__(
        self, frames: CameraFeed[StereoPair], link: ReferenceLink, begun_anew: Callable[[], None]
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

    ``arm_hash``: of the arm that the controller must drive, or ``ANY_ARM``; ``beside``: who sends stops from
    the same socket. While there is no session the name is asked again, its addresses are tried in turn.
    """

    def __init__(
        self, settings: LinkSettings, arm_hash: int, log: Log, clock: Clock, beside: DoorProcess | None = None
    ) -> None:
        self._host, self._port = settings.host, settings.port
        self._clock = clock
        self._beside = beside
        self._transport: asyncio.DatagramTransport | None = None
        self._address: _Address | None = None
        self._timer: Cancellable | None = None
        self._finding: asyncio.Task[None] | None = None
        session = ReferenceClient(
            secrets.randbits(64), arm_hash, settings.state_period_ms, key=read_key(settings.link_key)
        )
        peer = f"controller at {settings.host}:{settings.port}"
        self.link = ReferenceLink(session, clock, self.flush, LinkJournal(log, clock), peer)

    async def start(self) -> None:
        """Open the socket and begin to connect; does not wait for the controller.

        Raises LinkLost (``link.no_address``) when the host is not known.
        """
        if self._beside is not None:
            self._beside.attach(self.link)
        for each in await self._addresses():
            if await self._open(each):
                break
        if followed():  # with the first tick: then all are there
            current().call_at(self._clock.now_ns, self.link.connect)
        else:
            self.link.connect()
        self._finding = asyncio.create_task(self._keep_finding())

    async def close(self) -> None:
        """Tell the controller and close the socket."""
        self.link.disconnect()
        if self._timer is not None:
            self._timer.cancel()
        if self._finding is not None:
            self._finding.cancel()
        self._close_socket()

    def flush(self) -> None:
        """Send what the link wants sent, and set the timer for its next deadline."""
        now_ns = self._clock.now_ns
        if self._transport is not None:
            for datagram in self.link.outgoing(now_ns):
                self._transport.sendto(datagram)
            if self._beside is not None:
                self._beside.sent(self.link)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        deadline_ns = self.link.next_deadline_ns()
        if deadline_ns is not None:
            self._timer = current().call_at(deadline_ns, self._tick)

    def _tick(self) -> None:
        self._timer = None
        self.link.tick()
        self.flush()

    # asyncio's side
    def datagram_received(self, data: bytes, addr: Any) -> None:
        if self._beside is not None:
            self._beside.hear()
        self.link.receive(data)
        self.flush()

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there (yet): the session's own timeouts deal with it."""

    async def _keep_finding(self) -> None:
        while True:
            await asyncio.sleep(_TRIED_S)
            if self.link.session.credentials is not None:
                continue
            with contextlib.suppress(LinkLost):
                addresses = await self._addresses()
                at = addresses.index(self._address) + 1 if self._address in addresses else 0
                following = addresses[at % len(addresses)]
                unheard = self.link.session.credentials is None
                if unheard and (following != self._address or self._transport is None):
                    await self._open(following)

    async def _addresses(self) -> list[_Address]:
        """Every address of the host. Raises LinkLost (``link.no_address``)."""
        try:
            found = await asyncio.get_running_loop().getaddrinfo(
                self._host, self._port, type=socket.SOCK_DGRAM
            )
        except OSError as error:
            why = f"controller at {self._host}:{self._port}: {error}"
            raise LinkLost("link.no_address", why) from error
        return [(family, address) for family, _, _, _, address in found]

    async def _open(self, where: _Address) -> bool:
        """Have a socket to another address; whether there is a way there."""
        self._close_socket()
        self._address = where
        with contextlib.ExitStack() as closing:
            try:
                opened = closing.enter_context(socket.socket(where[0], socket.SOCK_DGRAM))
                opened.setblocking(False)
                opened.connect(where[1])
            except OSError:  # no such family here, or no way there
                return False
            closing.pop_all()
        if self._beside is not None:
            self._beside.opened(opened)
        loop = asyncio.get_running_loop()
        self._transport, _ = await loop.create_datagram_endpoint(lambda: self, sock=opened)
        return True

    def _close_socket(self) -> None:
        if self._transport is not None:
            self._transport.close()
            self._transport = None
