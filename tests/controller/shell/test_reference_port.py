"""The UDP port on loopback: answers between scans, one peer at a time, a flood survived, last words
obeyed."""

import asyncio
import contextlib
import io
import socket
import time
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any

import pytest

from controller.config import ReferenceLinkConfig
from controller.core.inbox import Request
from controller.shell.reference_port import ReferencePort
from foundation.event_log import EventLog
from protocol.client_session import ReferenceClient
from protocol.errors import ConfigurationError
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import Command
from protocol.server_session import ReferenceServer
from protocol.session_events import Connected, SessionLost

pytestmark = pytest.mark.realtime

TIMEOUT_MS = 400


class Peer:
    """A client session on a socket of its own."""

    def __init__(self, address: tuple[str, int], nonce: int) -> None:
        self.session = ReferenceClient(nonce=nonce, state_period_ms=10)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.socket.connect(address)
        self.events: list[object] = []

    async def turn(self) -> None:
        """Send what waits, let the port answer, receive."""
        for data in self.session.outgoing(time.monotonic_ns()):
            self.socket.send(data)
        await asyncio.sleep(0.01)
        while True:
            try:
                data = self.socket.recv(4096)
            except BlockingIOError:
                return
            self.events += self.session.receive(data, time.monotonic_ns())

    async def connect(self) -> None:
        self.session.connect(time.monotonic_ns())
        await self.turn()
        assert any(isinstance(event, Connected) for event in self.events)
        self.session.tick(time.monotonic_ns())
        await self.turn()

    def submit(self, message: Request) -> int:
        return self.session.submit(message, time.monotonic_ns())


@pytest.fixture
def meet() -> Iterator[Callable[[ReferencePort, int], Peer]]:
    """Makes peers of a port, and closes their sockets in the end."""
    with contextlib.ExitStack() as sockets:

        def made(port: ReferencePort, nonce: int) -> Peer:
            peer = Peer(port.address, nonce)
            sockets.callback(peer.socket.close)
            return peer

        yield made


Meet = Callable[[ReferencePort, int], Peer]


@pytest.fixture
async def port() -> AsyncIterator[ReferencePort]:
    server = ReferenceServer(boot_id=1, arm_hash=2, cycle_ns=5_000_000, link_timeout_ms=TIMEOUT_MS)
    config = ReferenceLinkConfig(host="127.0.0.1", port=0, link_timeout_ms=TIMEOUT_MS)
    opened = ReferencePort(server, config, EventLog("controller", io.StringIO()))
    opened.open()
    yield opened
    opened.close()


def _take(port: ReferencePort) -> tuple[tuple[Request, ...], bool]:
    return port.take(time.monotonic_ns())


async def test_a_flood_of_strangers_does_not_hold_up_a_stop(port: ReferencePort, meet: Meet) -> None:
    """250 datagrams a cycle of 5 ms are 50 000 a second."""
    peer = meet(port, 8)
    await peer.connect()
    stopped_after, looked_at = None, 96
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.connect(port.address)
        for cycle in range(60):
            for _ in range(250):
                stranger.send(b"noise" * 10)
            if cycle == 20:
                peer.submit(Command(0, CommandCode.STOP))
            now_ns = time.monotonic_ns()
            peer.session.tick(now_ns)
            for data in peer.session.outgoing(now_ns):
                peer.socket.send(data)
            await asyncio.sleep(0.001)
            requests, alive = _take(port)
            looked_at += 8 if alive else 96  # a machine that stood still loses the peer for a while
            if requests and stopped_after is None:
                stopped_after = cycle - 20
    assert port.flooded > 50  # of 60 cycles
    assert port.server.statistics.refused <= looked_at
    assert stopped_after is not None
    assert stopped_after <= 10


async def test_a_busy_port_is_named(port: ReferencePort) -> None:
    host, number = port.address
    server = ReferenceServer(boot_id=1, arm_hash=2, cycle_ns=5_000_000, link_timeout_ms=TIMEOUT_MS)
    config = ReferenceLinkConfig(host=host, port=number, link_timeout_ms=TIMEOUT_MS)
    with pytest.raises(ConfigurationError) as caught:
        ReferencePort(server, config, EventLog("controller", io.StringIO()))
    assert caught.value.cause == "configuration.port_busy"
    assert str(number) in str(caught.value)


async def test_answers_leave_from_the_address_that_was_asked() -> None:
    """On a host with two: a client with a connected socket would not see others, all through its session."""
    server = ReferenceServer(boot_id=1, arm_hash=2, cycle_ns=5_000_000, link_timeout_ms=TIMEOUT_MS)
    config = ReferenceLinkConfig(host="0.0.0.0", port=0, link_timeout_ms=TIMEOUT_MS)
    port = ReferencePort(server, config, EventLog("controller", io.StringIO()))
    port.open()
    peer = Peer(("127.0.0.2", port.address[1]), 2)
    strangers = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(70)]
    try:
        await peer.connect()
        for stranger in strangers:  # more than addresses are remembered of
            stranger.sendto(b"nothing", ("127.0.0.1", port.address[1]))
            stranger.close()
        for _ in range(12):
            _take(port)
        port.server.close(time.monotonic_ns(), Reason.SHUTDOWN)
        port.publish((), None, time.monotonic_ns())  # type: ignore[arg-type] - no session is left
        await peer.turn()
        assert any(isinstance(e, SessionLost) and e.reason is Reason.SHUTDOWN for e in peer.events)
        peer.socket.connect(("127.0.0.3", port.address[1]))  # from the same port to another of the addresses
        peer.session, peer.events = ReferenceClient(nonce=3, state_period_ms=10), []
        await peer.connect()
        peer.submit(Command(0, CommandCode.STOP))
        await peer.turn()
        assert [type(request) for request in _take(port)[0]] == [Command]
    finally:
        peer.socket.close()
        port.close()


async def test_a_greeting_that_comes_while_the_session_ends_is_answered(
    port: ReferencePort, meet: Meet, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, again = meet(port, 1), ReferenceClient(nonce=2)
    await first.connect()
    judge = port.server.receive_batch

    def judged(datagrams: list[Any], now_ns: int) -> list[Any]:
        events = judge(datagrams, now_ns)
        if port.server.session is None and again.statistics.received == 0:
            monkeypatch.undo()
            again.connect(now_ns)
            for data in again.outgoing(now_ns):
                first.socket.send(data)  # behind the batch that was read, before its socket is closed
        return events

    monkeypatch.setattr(port.server, "receive_batch", judged)
    first.session.disconnect(time.monotonic_ns())
    for data in first.session.outgoing(time.monotonic_ns()):
        first.socket.send(data)
    await asyncio.sleep(0.02)
    _take(port)
    again.receive(first.socket.recv(4096), time.monotonic_ns())
    assert again.connected
