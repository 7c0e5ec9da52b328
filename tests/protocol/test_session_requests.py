"""Requests of a session on a wire that delays, loses, repeats and reorders."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol import errors
from protocol.client_session import ReferenceClient
from protocol.datagram import Header, decode, encode
from protocol.faults import CommandCode, Reason
from protocol.pose import IDENTITY
from protocol.reference_messages import (
    Acknowledgement,
    Command,
    ReferencePath,
    ReferencePose,
)
from protocol.session_events import (
    SessionLost,
)
from tests.protocol.wire import MS, Wire, a_server, answers, kind_of

STOP = Command(0, CommandCode.STOP)
ENABLE = Command(0, CommandCode.ENABLE)
MOVE = ReferencePose(0, IDENTITY, 1.0)


class TestRequests:
    def test_a_request_with_nan_is_recognised_when_it_comes_again(self) -> None:
        wire = Wire(answer=Reason.NOT_FINITE).connect()
        nan = MOVE._replace(command_id=5, duration_s=float("nan"))
        for sequence in (100, 101):
            wire.give_server(encode(nan, Header(wire.server.session or 0, sequence, wire.now_ns)))
        replies = [
            decode(data).message for data, _ in wire.server.outgoing() if kind_of(data) == "Acknowledgement"
        ]
        assert replies == [Acknowledgement(5, Reason.NOT_FINITE, 0.0, 0.0)] * 2
        assert len(wire.requests()) == 1

    def test_stops_are_repeated_before_all_other_open_requests(self) -> None:
        wire = Wire().connect()
        moves = [wire.client.submit(MOVE, wire.now_ns) for _ in range(200)]
        wire.client.outgoing(wire.now_ns)
        stop = wire.client.submit(STOP, wire.now_ns)
        sent = [decode(data).message for data in wire.client.outgoing(wire.now_ns)]
        assert sent == [STOP._replace(command_id=stop)]  # at once, however many are open
        wire.client.tick(wire.now_ns + 30_000_000)
        again = [decode(data).message for data in wire.client.outgoing(wire.now_ns + 30_000_000)]
        ids = [message.command_id for message in again if isinstance(message, Command | ReferencePose)]
        assert ids == [stop, *moves]

    def test_what_cannot_be_sent_is_refused_without_using_up_an_id(self) -> None:
        wire = Wire().connect()
        first = wire.client.submit(STOP, wire.now_ns)
        with pytest.raises(errors.RequestRefused):
            wire.client.submit(ReferencePath(0, (), 0.0, 0.0), wire.now_ns)
        assert wire.client.submit(STOP, wire.now_ns) == first + 1

    @settings(max_examples=25)
    @given(st.integers(0, 2**32 - 1))
    def test_every_request_is_executed_at_most_once_and_answered_on_a_terrible_wire(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        wire = Wire(
            client=ReferenceClient(7, first_sequence=2**32 - 20), server=a_server(first_sequence=2**32 - 9)
        )
        wire.connect()
        wire.loses = lambda direction, data: rng.random() < 0.3
        asked = []
        for _ in range(12):
            if wire.client.connected:
                asked.append(wire.client.submit(MOVE, wire.now_ns))
            wire.up_ns = int(rng.integers(0, 12 * MS))  # reorders
            wire.down_ns = int(rng.integers(0, 12 * MS))
            if wire.upward and rng.random() < 0.5:
                wire.upward.append(wire.upward[int(rng.integers(len(wire.upward)))])  # duplicates
            wire.run(6)
        wire.run(900)
        executed = [request.command_id for request in wire.requests()]
        assert executed == sorted(set(executed))
        answered = [a.command_id for a in answers(wire)]
        lost = [i for e in wire.client_events if isinstance(e, SessionLost) for i in e.unanswered]
        assert sorted(answered + lost) == asked
        for answer in answers(wire):
            assert (answer.reason is Reason.ACCEPTED) == (answer.command_id in executed)
