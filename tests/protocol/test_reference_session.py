"""Order, age, states and clocks of a session on a wire that delays, loses, repeats and reorders."""

import pytest

from protocol.datagram import Header, decode, encode
from protocol.pose import IDENTITY
from protocol.reference_messages import (
    HeartbeatReply,
    Message,
    ReferencePose,
    State,
)
from protocol.session_events import (
    StateReceived,
)
from tests.protocol.sample_messages import MESSAGES
from tests.protocol.wire import BOOT, MS, Wire, a_server, dropped_causes, kind_of

MOVE = ReferencePose(0, IDENTITY, 1.0)
STATE = next(m for m in MESSAGES if isinstance(m, State))


class TestOrderAndAge:
    @pytest.mark.parametrize("message", MESSAGES, ids=lambda m: type(m).__name__)
    def test_messages_in_the_wrong_direction_are_dropped(self, message: Message) -> None:
        wire = Wire().connect()
        data = encode(message, Header(wire.server.session or 0, 100, wire.now_ns))
        from_client = {"Hello", "Heartbeat", "ReferencePose", "ReferencePath", "Command"}
        from_server = {"Welcome", "HeartbeatReply", "Acknowledgement", "State"}
        name = type(message).__name__
        if name in from_server:
            assert dropped_causes(wire.give_server(data)) == ["session.wrong_direction"]
        if name in from_client:
            assert dropped_causes(wire.client.receive(data, wire.now_ns)) == ["session.wrong_direction"]


class TestStateAndClock:
    def test_a_state_reaches_the_client_whole(self) -> None:
        wire = Wire().connect()
        wire.server.publish(STATE, wire.server_ns)
        wire.post()
        wire.run(2)
        assert StateReceived(STATE) in wire.client_events

    def test_a_backlog_of_states_is_stale_but_for_the_fresh_ones(self) -> None:
        wire = Wire().connect().run(100)
        backlog = []
        for i in range(40):
            wire.now_ns += 50 * MS
            wire.server.publish(STATE._replace(cycle=i), wire.server_ns)
            backlog += [data for data, _ in wire.server.outgoing(wire.server_ns)]
        events = [event for data in backlog for event in wire.client.receive(data, wire.now_ns)]
        fresh = [event.state.cycle for event in events if isinstance(event, StateReceived)]
        assert fresh == list(range(34, 40))
        assert wire.client.statistics.stale == 34

    def test_the_offset_is_known_a_tenth_of_a_second_after_connecting(self) -> None:
        wire = Wire().connect().run(100)
        clock = wire.client.clock
        assert clock is not None
        assert clock.uncertainty_ns < 2 * MS

    def test_a_clock_from_before_the_restart_is_forgotten(self) -> None:
        wire = Wire().connect().run(300)
        wire.server = a_server(boot_id=BOOT + 1)
        wire.offset_ns = -5_000 * MS
        wire.run(100)
        wire.connect().run(200)
        assert wire.client.clock_offset_ns == pytest.approx(-5_000 * MS, abs=2 * MS)

    def test_an_echo_that_was_not_asked_for_is_refused(self) -> None:
        wire = Wire().connect().run(100)
        recorded = [decode(data) for data in wire.sent_up if kind_of(data) == "Heartbeat"]
        before = wire.client.clock
        for i in range(5):
            lie = HeartbeatReply(recorded[0].header.sent_ns, 5, 5)
            data = encode(lie, Header(wire.server.session or 0, 1000 + i, wire.server_ns))
            assert dropped_causes(wire.client.receive(data, wire.now_ns)) == ["clock.unexpected_echo"]
        assert wire.client.clock == before

    def test_tick_is_due_when_the_deadline_says_and_not_before(self) -> None:
        wire = Wire().connect().run(300)
        for _ in range(200):
            deadline_ns = wire.client.next_deadline_ns()
            assert deadline_ns is not None
            wire.client.tick(deadline_ns - 1)
            assert wire.client.outgoing() == []
            wire.client.tick(deadline_ns)
            for data in wire.client.outgoing(deadline_ns):
                wire.server.receive(data, wire.source, deadline_ns + wire.offset_ns)
            for data, _ in wire.server.outgoing(deadline_ns + wire.offset_ns):
                wire.client.receive(data, deadline_ns)
        assert wire.client.connected
