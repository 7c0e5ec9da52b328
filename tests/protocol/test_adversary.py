"""An adversary on the wire of an authenticated link, without the key: replays, bends, reflects, invents.

Whatever it does, and whichever side restarts meanwhile: what is executed was submitted, at most once, in the
session it was submitted in; and what was answered to the client was the controller's own decision.
"""

from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from conformance.wire import resealed
from protocol.authentication import LinkKey
from protocol.client_session import ReferenceClient
from protocol.datagram import Header, encode
from protocol.faults import Reason
from protocol.pose import Pose
from protocol.reference_messages import Acknowledgement, Bye, Heartbeat, Hello, ReferencePose
from protocol.session_events import AcknowledgementReceived, RequestReceived, SessionClosed, SessionOpened
from tests.protocol.wire import ARM, MS, Wire, a_server

KEY = LinkKey(bytes(range(32)))
FORGED_M = 66.0


class Adversary:
    """Knows every byte that was ever sent, both ways, and not the key."""

    def __init__(self, wire: Wire, rng: np.random.Generator) -> None:
        self._wire, self._rng = wire, rng
        self.heard: list[bytes] = []

    def act(self) -> None:
        """One attack on either side."""
        wire, rng = self._wire, self._rng
        self.heard = list(
            dict.fromkeys([*self.heard, *(d for _, d in wire.upward), *(d for _, d in wire.downward)])
        )
        if not self.heard:
            return
        data = self.heard[int(rng.integers(len(self.heard)))]
        forged = (self._replay, self._bend, self._renumber, self._strip, self._invent)[int(rng.integers(5))](
            data
        )
        queue = wire.upward if rng.random() < 0.6 else wire.downward
        queue.append((wire.now_ns + int(rng.integers(0, 20 * MS)), forged))

    def _replay(self, data: bytes) -> bytes:
        return data

    def _bend(self, data: bytes) -> bytes:
        bent = bytearray(data)
        for _ in range(int(self._rng.integers(1, 4))):
            bent[int(self._rng.integers(6, len(bent)))] ^= 1 << int(self._rng.integers(8))
        return resealed(bytes(bent))

    def _renumber(self, data: bytes) -> bytes:
        """In the open session, under the next numbers."""
        bent = bytearray(data)
        bent[16:24] = (self._wire.server.session or 0).to_bytes(8, "little")
        bent[24:28] = self._next_number().to_bytes(4, "little")
        return resealed(bytes(bent))

    def _strip(self, data: bytes) -> bytes:
        """Without its tag and flag, as if authentication had never been heard of."""
        if len(data) < 64:
            return data
        bare = bytearray(data[:-24])
        bare[9] = 0
        return resealed(bytes(bare))

    def _invent(self, data: bytes) -> bytes:
        """Anything, under a key of its own."""
        rng, now_ns = self._rng, self._wire.now_ns
        away = ReferencePose(int(rng.integers(1, 2**53)), Pose((FORGED_M,) * 3, (1.0, 0.0, 0.0, 0.0)), 0.0)
        inventions = (
            away,
            Bye(Reason.SHUTDOWN),
            Heartbeat(now_ns),
            Hello(int(rng.integers(1, 2**62)), 7, ARM, 20),
            Acknowledgement(int(rng.integers(1, 2**53)), Reason.ACCEPTED, FORGED_M, 0.0),
        )
        message = inventions[int(rng.integers(len(inventions)))]
        session = 0 if isinstance(message, Hello) else self._wire.server.session or 0
        key = LinkKey(rng.bytes(32)).of_hello() if rng.random() < 0.5 else None
        return encode(message, Header(session, self._next_number(), now_ns), key)

    def _next_number(self) -> int:
        """A number that the receiver expects about now, as far as what was heard tells."""
        newest = max(int.from_bytes(data[24:28], "little") for data in self.heard[-20:])
        return int((newest + self._rng.integers(1, 20)) % 2**32)


def a_reference(metres: float) -> ReferencePose:
    return ReferencePose(0, Pose((metres, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), 0.0)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_nothing_but_what_was_submitted_is_executed_and_that_at_most_once(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wire = Wire(server=a_server(key=KEY), client=ReferenceClient(7, key=KEY))
    adversary = Adversary(wire, rng)
    submitted: dict[tuple[int, float], int] = {}
    wire.client.connect(wire.now_ns)
    for step in range(40):
        if wire.client.connected:
            metres = 1.0 + step / 64
            command_id = wire.client.submit(a_reference(metres), wire.now_ns)
            submitted[command_id, metres] = step
            wire.post()
        for _ in range(int(rng.integers(0, 5))):
            adversary.act()
        fate = rng.random()
        if fate < 0.04:  # the controller restarts and has forgotten everything
            wire.server = a_server(key=KEY, boot_id=int(rng.integers(1, 2**62)))
        elif fate < 0.08:  # the client restarts
            wire.client = ReferenceClient(int(rng.integers(1, 2**62)), key=KEY)
            wire.client.connect(wire.now_ns)
        elif not wire.client.connected and fate < 0.5:
            wire.client.connect(wire.now_ns)
        wire.run(int(rng.integers(1, 25)))
    executed = [(r.command_id, r.X_BT_ref.p_m[0]) for r in wire.requests() if isinstance(r, ReferencePose)]
    assert len(executed) == len(wire.requests())
    assert len(set(executed)) == len(executed)
    assert set(executed) <= set(submitted)
    told = [e.acknowledgement for e in wire.client_events if isinstance(e, AcknowledgementReceived)]
    assert {answer.value for answer in told} <= {0.0}
    assert {answer.command_id for answer in told} <= {command_id for command_id, _ in submitted}
    _each_in_a_session(wire.server_events)


def _each_in_a_session(events: list[Any]) -> None:
    """Requests are executed only between the beginning of a session and its end."""
    open_now = False
    for event in events:
        if isinstance(event, SessionOpened):
            open_now = True
        elif isinstance(event, SessionClosed):
            open_now = False
        elif isinstance(event, RequestReceived):
            assert open_now
