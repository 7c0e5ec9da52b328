"""Order, age, states and clocks of a session on a wire that delays, loses, repeats and reorders."""

import numpy as np
import pytest

from protocol.client_session import ReferenceClient
from protocol.datagram import Header, decode, encode
from protocol.faults import CommandCode, Reason
from protocol.pose import IDENTITY
from protocol.reference_messages import (
    Bye,
    Command,
    HeartbeatReply,
    Message,
    ReferencePose,
    State,
)
from protocol.session_events import (
    SessionClosed,
    StateReceived,
)
from tests.protocol.wire import BOOT, CYCLE_NS, MS, Wire, a_server, dropped_causes, kind_of
from tools.sample_messages import MESSAGES

STOP = Command(0, CommandCode.STOP)
MOVE = ReferencePose(0, IDENTITY, 1.0)
STATE = next(m for m in MESSAGES if isinstance(m, State))


class TestOrderAndAge:
    def test_both_numbers_wrap_without_a_trace(self) -> None:
        wire = Wire(
            client=ReferenceClient(7, first_sequence=2**32 - 5), server=a_server(first_sequence=2**32 - 5)
        )
        wire.connect().run(1000)
        assert wire.client.connected
        assert wire.server.statistics.lost == wire.client.statistics.lost == 0
        assert wire.server.statistics.dropped == wire.client.statistics.dropped == 0

    def test_a_reordered_request_is_dropped_and_counted_and_done_when_it_comes_again(self) -> None:
        wire = Wire().connect()
        wire.client.submit(STOP, wire.now_ns)
        (stop,) = wire.client.outgoing(wire.now_ns)
        wire.run(12)
        assert dropped_causes(wire.give_server(stop)) == ["sequence.reordered"]
        assert (wire.server.statistics.reordered, wire.server.statistics.lost) == (1, 0)
        wire.run(50)
        assert len(wire.requests()) == 1

    def test_a_number_that_starts_again_within_a_session_is_refused(self) -> None:
        wire = Wire(client=ReferenceClient(7, first_sequence=5000)).connect().run(200)
        restarted = encode(Command(1, CommandCode.STOP), Header(wire.server.session or 0, 1, wire.now_ns))
        assert dropped_causes(wire.give_server(restarted)) == ["sequence.old"]
        leap = encode(Command(1, CommandCode.STOP), Header(wire.server.session or 0, 2**20, wire.now_ns))
        assert dropped_causes(wire.give_server(leap)) == ["sequence.jump"]
        assert wire.requests() == []

    def test_a_second_source_with_the_right_session_is_ignored(self) -> None:
        wire = Wire().connect()
        stolen = encode(Command(1, CommandCode.STOP), Header(wire.server.session or 0, 100, wire.now_ns))
        assert dropped_causes(wire.give_server(stolen, "elsewhere")) == ["session.wrong_source"]
        assert wire.requests() == []
        assert wire.server.statistics.foreign == 1

    def test_a_frozen_server_finds_its_backlog_stale_and_does_not_resume(self) -> None:
        wire = Wire().connect().run(300)
        backlog: list[bytes] = []
        for i in range(120):
            wire.now_ns += 17 * MS
            pose = encode(
                MOVE._replace(command_id=i + 1), Header(wire.server.session or 0, 1000 + i, wire.now_ns)
            )
            backlog.append(pose)
        events = [event for data in backlog for event in wire.give_server(data)]
        assert isinstance(events[0], SessionClosed)
        assert events[0].reason is Reason.LINK_TIMEOUT
        assert wire.requests() == []

    def test_a_backlog_within_a_living_session_is_stale_but_for_its_newest(self) -> None:
        wire = Wire(server=a_server(max_age_ms=30)).connect().run(300)
        session = wire.server.session or 0
        sent = [wire.now_ns + i * 17 * MS for i in range(6)]
        wire.now_ns += 100 * MS
        for i, at_ns in enumerate(sent):
            wire.give_server(encode(MOVE._replace(command_id=i + 1), Header(session, 1000 + i, at_ns)))
        assert [r.command_id for r in wire.requests()] == [6]
        assert wire.server.statistics.stale == 5

    @pytest.mark.parametrize("offset_h", [-1, 0, 1, 24])
    def test_the_clocks_may_differ_by_hours(self, offset_h: int) -> None:
        wire = Wire(now_ns=10**14, offset_ns=offset_h * 3_600_000 * MS).connect().run(500)
        assert wire.client.connected
        assert wire.server.statistics.stale == wire.client.statistics.stale == 0
        assert wire.client.clock_offset_ns == pytest.approx(wire.offset_ns, abs=MS)

    def test_garbage_is_counted_and_changes_nothing(self) -> None:
        wire = Wire().connect()
        for data in (b"", b"x" * 40, bytes(1416), b"LRLK" + bytes(36)):
            assert dropped_causes(wire.give_server(data))
            assert dropped_causes(wire.client.receive(data, wire.now_ns))
        assert wire.server.statistics.refused == wire.client.statistics.refused == 4
        assert wire.server.link_alive(wire.server_ns)

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

    def test_refusals_to_strangers_are_rationed(self) -> None:
        wire = Wire()
        stray = encode(Command(1, CommandCode.STOP), Header(0xDEAD, 1, 0))
        for _ in range(1000):
            wire.now_ns += MS
            wire.give_server(stray, "stranger")
        replies = wire.server.outgoing()
        assert len(replies) == 20
        header, message = decode(replies[0][0])
        assert (header.session, message) == (0xDEAD, Bye(Reason.UNKNOWN_SESSION))

    def test_two_strangers_never_answer_each_other_for_ever(self) -> None:
        wire = Wire()
        wire.give_server(encode(Bye(Reason.UNKNOWN_SESSION), Header(0xDEAD, 1, 0)))
        assert wire.server.outgoing() == []


class TestStateAndClock:
    @pytest.mark.parametrize(("period_ms", "expected"), [(0, 200), (5, 200), (20, 50), (100, 10)])
    def test_states_come_at_the_rate_that_was_asked_for_despite_jitter(
        self, period_ms: int, expected: int
    ) -> None:
        wire = Wire(client=ReferenceClient(7, state_period_ms=period_ms)).connect()
        rng = np.random.default_rng(3)
        begin_ns = wire.now_ns
        for cycle in range(200):
            wire.now_ns = begin_ns + cycle * CYCLE_NS + int(rng.integers(0, MS))
            wire.server.publish(STATE, wire.server_ns)
        states = [data for data, _ in wire.server.outgoing() if kind_of(data) == "State"]
        assert abs(len(states) - expected) <= 1

    def test_a_state_reaches_the_client_whole(self) -> None:
        wire = Wire().connect()
        wire.server.publish(STATE, wire.server_ns)
        wire.post()
        wire.run(2)
        assert StateReceived(STATE) in wire.client_events

    def test_nothing_is_published_without_a_session(self) -> None:
        wire = Wire()
        wire.server.publish(STATE, wire.server_ns)
        assert wire.server.outgoing() == []

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

    @pytest.mark.parametrize(("up_ms", "down_ms"), [(1, 1), (8, 1), (1, 8), (40, 3)])
    def test_the_offset_is_within_its_bound_under_asymmetric_delay(self, up_ms: int, down_ms: int) -> None:
        wire = Wire(up_ns=up_ms * MS, down_ns=down_ms * MS)
        wire.client.connect(wire.now_ns)
        wire.run(600)
        clock = wire.client.clock
        assert clock is not None
        assert abs(clock.offset_ns - wire.offset_ns) <= clock.uncertainty_ns
        assert clock.offset_ns - wire.offset_ns == pytest.approx((up_ms - down_ms) / 2 * MS, abs=MS)
        assert wire.client.clock_uncertainty_ns == clock.uncertainty_ns

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

    def test_time_in_the_controller_does_not_count_as_delay(self) -> None:
        wire = Wire().connect().run(200)
        heartbeat = encode(MESSAGES[2], Header(wire.server.session or 0, 5000, wire.now_ns))
        wire.server.outgoing()
        wire.server.receive(heartbeat, wire.source, wire.server_ns)
        ((reply, _),) = wire.server.outgoing(wire.server_ns + 4 * MS)
        message = decode(reply).message
        assert (message.received_ns, message.replied_ns) == (wire.server_ns, wire.server_ns + 4 * MS)

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


def test_the_same_calls_give_the_same_bytes() -> None:
    def run() -> list[bytes]:
        wire = Wire().connect()
        wire.client.submit(MOVE, wire.now_ns)
        return wire.run(300).sent_up

    assert run() == run()
