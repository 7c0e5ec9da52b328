"""A client and a server joined by a wire that the test controls: delay, loss, order and both clocks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from protocol.client_session import ReferenceClient
from protocol.datagram import decode
from protocol.faults import Reason
from protocol.reference_messages import Acknowledgement
from protocol.server_session import ReferenceServer
from protocol.session_events import (
    AcknowledgementReceived,
    ClientEvent,
    Connected,
    DatagramDropped,
    RequestReceived,
    ServerEvent,
)

MS = 1_000_000
CYCLE_NS = 5 * MS
TIMEOUT_MS = 250
ARM = 0xA12A
BOOT = 0xB007


def a_server(**overrides: Any) -> ReferenceServer:
    """A server with the values of this module."""
    settings = {"boot_id": BOOT, "arm_hash": ARM, "cycle_ns": CYCLE_NS, "link_timeout_ms": TIMEOUT_MS}
    return ReferenceServer(**settings | overrides)


@dataclass
class Wire:
    """Steps both ends every ``step_ns``; the server's clock is the client's plus ``offset_ns``.

    ``up_ns`` and ``down_ns`` are the delays to and from the server; ``loses`` says which datagrams vanish.
    ``answer`` is the controller: it acknowledges every request at once unless set to None.
    """

    server: ReferenceServer = field(default_factory=a_server)
    client: ReferenceClient = field(default_factory=lambda: ReferenceClient(7))
    now_ns: int = 10**12
    offset_ns: int = 3_600_000 * MS
    up_ns: int = 200_000
    down_ns: int = 200_000
    step_ns: int = MS
    source: object = "vision"
    loses: Callable[[str, bytes], bool] = lambda direction, data: False
    answer: Reason | None = Reason.ACCEPTED
    server_events: list[ServerEvent] = field(default_factory=list)
    client_events: list[ClientEvent] = field(default_factory=list)
    upward: list[tuple[int, bytes]] = field(default_factory=list)
    downward: list[tuple[int, bytes]] = field(default_factory=list)
    sent_up: list[bytes] = field(default_factory=list)

    @property
    def server_ns(self) -> int:
        """The server's clock."""
        return self.now_ns + self.offset_ns

    def step(self) -> None:
        """One step of time: deliver what is due, let both ends act, post what they say."""
        self.now_ns += self.step_ns
        for data in self._due(self.upward):
            self.give_server(data)
        self.server_events += self.server.tick(self.server_ns)
        for data in self._due(self.downward):
            self.client_events += self.client.receive(data, self.now_ns)
        self.client_events += self.client.tick(self.now_ns)
        self.post()

    def give_server(self, data: bytes, source: object = None) -> list[ServerEvent]:
        """Hands the server one datagram now, and plays the controller for its requests."""
        events = self.server.receive(data, source or self.source, self.server_ns)
        self.server_events += events
        for event in events:
            if isinstance(event, RequestReceived) and self.answer is not None:
                answer = Acknowledgement(event.message.command_id, self.answer, 0.0, 0.0)
                self.server.acknowledge(answer, self.server_ns)
        return events

    def post(self) -> None:
        """Puts what both ends want to send on the wire."""
        for data in self.client.outgoing(self.now_ns):
            self.sent_up.append(data)
            if not self.loses("up", data):
                self.upward.append((self.now_ns + self.up_ns, data))
        for data, _ in self.server.outgoing(self.server_ns):
            if not self.loses("down", data):
                self.downward.append((self.now_ns + self.down_ns, data))

    def run(self, duration_ms: int) -> "Wire":
        """Steps through ``duration_ms``."""
        for _ in range(duration_ms * MS // self.step_ns):
            self.step()
        return self

    def connect(self) -> "Wire":
        """Runs until the session is open at both ends."""
        self.client.connect(self.now_ns)
        for _ in range(20):
            self.step()
            if self.client.connected and self.server.session == self.sessions()[-1]:
                return self
        raise AssertionError("no session within 20 steps")

    def requests(self) -> list[object]:
        """What the controller was asked to execute."""
        return [event.message for event in self.server_events if isinstance(event, RequestReceived)]

    def sessions(self) -> list[int]:
        """The sessions that the client has entered, in order."""
        return [event.session for event in self.client_events if isinstance(event, Connected)]

    def _due(self, way: list[tuple[int, bytes]]) -> list[bytes]:
        due = [data for at_ns, data in way if at_ns <= self.now_ns]
        way[:] = [(at_ns, data) for at_ns, data in way if at_ns > self.now_ns]
        return due


def kind_of(data: bytes) -> str:
    """Name of the message in a datagram."""
    return type(decode(data).message).__name__


def dropped_causes(events: Sequence[object]) -> list[str]:
    """Causes of the datagrams that were dropped, in order."""
    return [event.cause for event in events if isinstance(event, DatagramDropped)]


def answers(wire: Wire) -> list[Acknowledgement]:
    """What the client has been acknowledged."""
    return [e.acknowledgement for e in wire.client_events if isinstance(e, AcknowledgementReceived)]
