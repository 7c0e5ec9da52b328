"""The conformance suite and the controller under test in simulated time: one thread, one clock, no sockets.

The suite knows its clock and sockets by three modules, ``time``, ``socket`` and ``select``. Within
``simulated()`` stand-ins of the same shape take their place. The tester waits in ``select`` or ``sleep``; the
stand-ins let the controllers take their turns until a datagram has come or the time is over.
"""

import math
import socket
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from types import SimpleNamespace
from typing import Any, Protocol
from unittest.mock import patch

LATENCY_NS = 50_000
TICK_NS = 1_000  # what reading the clock costs: time moves while the tester computes
Address = tuple[str, int]


class Serving(Protocol):
    """A controller that is not run by a thread of its own."""

    next_ns: int

    def turn(self) -> None:
        """Read, scan if a scan is due, and send."""
        ...


class SimulatedSocket:
    """The part of a UDP socket that suite and controller use."""

    def __init__(self, network: "SimulatedNetwork") -> None:
        self._network = network
        self._peer: Address | None = None
        self.inbox: deque[tuple[int, bytes, Address]] = deque()
        self.address = network.new_address(self)

    def connect(self, address: Address) -> None:
        """Send to, and hear, this peer alone."""
        self._peer = address

    def setblocking(self, blocking: bool) -> None:
        """Nothing to do: it never blocks."""

    def getsockname(self) -> Address:
        """Its own address."""
        return self.address

    def close(self) -> None:
        """Hear nothing more."""
        self._network.sockets.pop(self.address, None)

    def send(self, data: bytes) -> None:
        """Send to the peer."""
        assert self._peer is not None
        self.sendto(data, self._peer)

    def sendto(self, data: bytes, address: Address) -> None:
        """Put ``data`` on its way."""
        other = self._network.sockets.get(address)
        if other is not None and other._peer in (None, self.address):
            other.inbox.append((self._network.now_ns + LATENCY_NS, data, self.address))

    def readable(self) -> bool:
        """True if something has come, or if nobody listens at the peer's address."""
        refused = self._peer is not None and self._peer not in self._network.sockets
        return refused or (bool(self.inbox) and self.inbox[0][0] <= self._network.now_ns)

    def recvfrom(self, _: int) -> tuple[bytes, Address]:
        """The oldest datagram that has come, and its sender."""
        if not self.inbox or self.inbox[0][0] > self._network.now_ns:
            if self._peer is not None and self._peer not in self._network.sockets:
                raise ConnectionRefusedError
            raise BlockingIOError
        _, data, source = self.inbox.popleft()
        return data, source

    def recv(self, size: int) -> bytes:
        """The oldest datagram that has come."""
        return self.recvfrom(size)[0]


class SimulatedNetwork:
    """The clock, the sockets and the controllers of one test."""

    def __init__(self) -> None:
        self.now_ns = 1_000_000_000_000
        self.sockets: dict[Address, SimulatedSocket] = {}
        self.controllers: list[Serving] = []
        self._port = 40_000

    def new_address(self, owner: SimulatedSocket) -> Address:
        """A free address on loopback, now ``owner``'s."""
        self._port += 1
        self.sockets["127.0.0.1", self._port] = owner
        return "127.0.0.1", self._port

    def clock_ns(self) -> int:
        """The time; it moves a little with every reading."""
        self.now_ns += TICK_NS
        return self.now_ns

    def wait(self, seconds: float, *, until: SimulatedSocket | None = None) -> bool:
        """Let ``seconds`` pass, or less if ``until`` becomes readable; return whether it did."""
        end_ns = self.now_ns + math.ceil(seconds * 1e9)
        while True:
            for controller in self.controllers:
                controller.turn()
            if until is not None and until.readable():
                return True
            if self.now_ns >= end_ns:
                return False
            self.now_ns = max(min([end_ns, *self._due()]), self.now_ns + 1)

    def _due(self) -> list[int]:
        scans = [controller.next_ns for controller in self.controllers]
        # What has come and is not read waits for a scan.
        return scans + [
            s.inbox[0][0] for s in self.sockets.values() if s.inbox and s.inbox[0][0] > self.now_ns
        ]

    def modules(self) -> dict[str, SimpleNamespace]:
        """Stand-ins for the modules of time and of the network."""

        def selected(
            readers: list[SimulatedSocket], _: Any, __: Any, timeout_s: float
        ) -> tuple[Any, Any, Any]:
            (reader,) = readers
            return (readers if self.wait(timeout_s, until=reader) else []), [], []

        return {
            "time": SimpleNamespace(
                monotonic_ns=self.clock_ns,
                monotonic=lambda: self.clock_ns() * 1e-9,
                time_ns=self.clock_ns,
                sleep=self.wait,
            ),
            "socket": SimpleNamespace(
                socket=lambda *_: SimulatedSocket(self),
                getaddrinfo=socket.getaddrinfo,
                SOCK_DGRAM=socket.SOCK_DGRAM,
                AF_INET=socket.AF_INET,
            ),
            "select": SimpleNamespace(select=selected),
        }


@contextmanager
def simulated() -> Iterator[SimulatedNetwork]:
    """Suite and controllers share one simulated clock; no sockets, no waiting."""
    network = SimulatedNetwork()
    modules = network.modules()
    with ExitStack() as stack:
        for place in ("wire.time", "wire.socket", "wire.select", "peer.time", "runner.time"):
            stack.enter_context(patch(f"conformance.{place}", modules[place.split(".")[1]]))
        stack.enter_context(patch("tests.conformance.controllers.ControllerUnderTest.network", network))
        yield network
