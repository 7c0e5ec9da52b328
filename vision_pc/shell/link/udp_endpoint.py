"""The reference link over UDP: an asyncio endpoint that carries the datagrams of a ``ReferenceLink``."""

import asyncio
import secrets
from typing import Any, cast

from foundation.secret_source import read_key
from protocol.client_session import ReferenceClient
from protocol.errors import LinkLost
from vision_pc.application.ports import Clock, Log
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.config.vision import LinkSettings
from vision_pc.shell.link.link_journal import LinkJournal


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
