"""Both ends of the reference link on a wire that delays, loses, repeats and reorders."""

from collections.abc import Sequence
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conformance.bytes_of import with_number
from protocol import errors
from protocol.client_session import ReferenceClient
from protocol.datagram import Header, decode, encode
from protocol.faults import CommandCode, Reason
from protocol.pose import IDENTITY
from protocol.reference_messages import (
    CAPABILITY_PATHS,
    CAPABILITY_STREAMING,
    Acknowledgement,
    Bye,
    Command,
    Heartbeat,
    HeartbeatReply,
    Hello,
    Message,
    ReferencePath,
    ReferencePose,
    State,
)
from protocol.session_events import (
    AcknowledgementReceived,
    Connected,
    ConnectionDelayed,
    DatagramDropped,
    SessionClosed,
    SessionLost,
    SessionOpened,
    StateReceived,
)
from tests.protocol.wire import ARM, BOOT, CYCLE_NS, MS, TIMEOUT_MS, Wire, a_server, kind_of
from tools.sample_messages import MESSAGES

STOP = Command(0, CommandCode.STOP)
ENABLE = Command(0, CommandCode.ENABLE)
MOVE = ReferencePose(0, IDENTITY, 1.0)
STATE = next(m for m in MESSAGES if isinstance(m, State))


def dropped_causes(events: list[object]) -> list[str]:
    return [event.cause for event in events if isinstance(event, DatagramDropped)]


def answers(wire: Wire) -> list[Acknowledgement]:
    return [e.acknowledgement for e in wire.client_events if isinstance(e, AcknowledgementReceived)]


def byes(wire: Wire) -> list[Reason]:
    """Reasons of the BYEs that the server has queued."""
    messages = [decode(data).message for data, _ in wire.server.outgoing(wire.server_ns)]
    return [message.reason for message in messages if isinstance(message, Bye)]


class TestHandshake:
    def test_opens_a_session_and_says_what_was_granted(self) -> None:
        wire = Wire().connect()
        (opened,) = wire.server_events
        (connected,) = wire.client_events
        assert isinstance(opened, SessionOpened)
        assert isinstance(connected, Connected)
        assert opened.session == connected.session == wire.server.session != 0
        welcome = connected.welcome
        assert (welcome.arm_hash, welcome.boot_id, welcome.cycle_ns) == (ARM, BOOT, CYCLE_NS)
        assert (welcome.link_timeout_ms, welcome.state_period_ms) == (TIMEOUT_MS, 20)
        assert welcome.capabilities == CAPABILITY_PATHS | CAPABILITY_STREAMING

    def test_nothing_is_sent_before_the_client_asks(self) -> None:
        wire = Wire().run(1000)
        assert wire.sent_up == []
        assert wire.downward == []
        assert wire.client.next_deadline_ns() is None

    @pytest.mark.parametrize("lost", [1, 3, 25])
    def test_survives_the_loss_of_the_first_hellos(self, lost: int) -> None:
        wire = Wire()
        wire.loses = lambda direction, data: direction == "up" and len(wire.sent_up) <= lost
        wire.client.connect(wire.now_ns)
        wire.run(100 * lost + 50)
        assert wire.client.connected
        assert wire.server.statistics.lost == 0

    @pytest.mark.parametrize("blind_ms", [150, 700, 3000])
    def test_survives_the_loss_of_the_first_welcomes(self, blind_ms: int) -> None:
        wire = Wire(server=a_server(link_timeout_ms=80))
        until_ns = wire.now_ns + blind_ms * MS
        wire.loses = lambda direction, data: direction == "down" and wire.now_ns < until_ns
        wire.client.connect(wire.now_ns)
        wire.run(blind_ms + 1200)
        assert wire.client.connected
        assert wire.server.link_alive(wire.server_ns)

    def test_a_repeated_hello_gets_the_same_session(self) -> None:
        wire = Wire(down_ns=150 * MS)
        wire.client.connect(wire.now_ns)
        wire.run(400)
        assert [type(e) for e in wire.server_events] == [SessionOpened]
        assert len(wire.sessions()) == 1

    def test_another_arm_is_refused_with_the_reason(self) -> None:
        wire = Wire(client=ReferenceClient(7, arm_hash=ARM + 1))
        wire.client.connect(wire.now_ns)
        wire.run(20)
        assert wire.client_events == [SessionLost(Reason.WRONG_ARM, ())]
        assert dropped_causes(wire.server_events) == ["session.wrong_arm"]
        assert wire.server.session is None

    def test_another_major_version_is_told_so(self) -> None:
        wire = Wire()
        wire.client.connect(wire.now_ns)
        (hello,) = wire.client.outgoing()
        events = wire.give_server(with_number(hello, 4, "B", 2))
        assert dropped_causes(events) == ["datagram.wrong_major"]
        wire.post()
        wire.run(5)
        assert wire.client_events == [SessionLost(Reason.INCOMPATIBLE_VERSION, ())]

    def test_a_newer_minor_version_is_met_with_ours(self) -> None:
        wire = Wire()
        wire.give_server(encode(Hello(1, 0, 0, 20), Header(0, 1, 0, minor=9)))
        ((welcome, _),) = wire.server.outgoing()
        assert decode(welcome).header.minor == 0
        session = decode(welcome).header.session
        events = wire.give_server(encode(Command(1, CommandCode.STOP), Header(session, 2, 0, minor=9)))
        assert dropped_causes(events) == ["session.wrong_minor"]

    def test_a_capability_is_granted_only_if_both_have_it(self) -> None:
        wire = Wire(server=a_server(capabilities=0)).connect()
        with pytest.raises(errors.RequestRefused) as caught:
            wire.client.submit(ReferencePath(0, (IDENTITY,), 0.0, 0.0), wire.now_ns)
        assert caught.value.cause == "refused.not_negotiated"

    def test_a_path_that_was_not_negotiated_is_refused_by_the_server_too(self) -> None:
        wire = Wire(client=ReferenceClient(7, capabilities=0)).connect()
        path = encode(
            ReferencePath(5, (IDENTITY,), 0.0, 0.0), Header(wire.server.session or 0, 500, wire.now_ns)
        )
        assert wire.give_server(path) == []
        assert Reason.NOT_NEGOTIATED in [
            decode(data).message.reason
            for data, _ in wire.server.outgoing()
            if kind_of(data) == "Acknowledgement"
        ]

    def test_a_second_client_is_refused_and_gets_in_once_the_first_has_left(self) -> None:
        wire = Wire().connect()
        second = ReferenceClient(99)
        second.connect(wire.now_ns)
        events = [wire.give_server(data, "elsewhere") for data in second.outgoing()]
        assert dropped_causes(events[0]) == ["session.occupied"]
        refusal = next(data for data, source in wire.server.outgoing() if source == "elsewhere")
        assert second.receive(refusal, wire.now_ns) == [ConnectionDelayed(Reason.SESSION_OCCUPIED)]
        assert wire.server.link_alive(wire.server_ns)
        wire.client.disconnect(wire.now_ns)
        wire.run(5)
        wire.now_ns += 200 * MS
        second.tick(wire.now_ns)
        for data in second.outgoing():
            wire.give_server(data, "elsewhere")
        for data, source in wire.server.outgoing():
            assert source == "elsewhere"
            second.receive(data, wire.now_ns)
        assert second.connected


class TestClosing:
    def test_bye_of_the_client_ends_the_session_at_once(self) -> None:
        wire = Wire().connect()
        session = wire.server.session
        assert wire.client.disconnect(wire.now_ns) == [SessionLost(Reason.SHUTDOWN, ())]
        wire.run(2)
        assert wire.server_events[-1] == SessionClosed(session or 0, Reason.SHUTDOWN)
        assert wire.client.disconnect(wire.now_ns) == []

    def test_bye_of_the_server_reaches_the_client_with_its_reason(self) -> None:
        wire = Wire().connect()
        wire.server.close(wire.server_ns)
        wire.run(3)
        assert [e for e in wire.client_events if isinstance(e, SessionLost)] == [
            SessionLost(Reason.SHUTDOWN, ())
        ]
        assert wire.server.close(wire.server_ns) == []

    def test_silence_ends_the_session_on_both_sides_within_the_timeout(self) -> None:
        wire = Wire().connect().run(500)
        wire.loses = lambda direction, data: True
        cut_ns = wire.now_ns
        while wire.server.link_alive(wire.server_ns):
            wire.step()
        assert TIMEOUT_MS - 51 <= (wire.now_ns - cut_ns) // MS <= TIMEOUT_MS + 1
        wire.run(60)
        assert not wire.client.connected
        assert isinstance(wire.client_events[-1], SessionLost)
        assert wire.server_events[-1] == SessionClosed(
            next(e.session for e in wire.server_events if isinstance(e, SessionOpened)), Reason.LINK_TIMEOUT
        )

    @pytest.mark.parametrize(("lost", "survives"), [(4, True), (5, False)])
    def test_four_heartbeats_lost_in_a_row_are_survived_and_five_are_not(
        self, lost: int, survives: bool
    ) -> None:
        wire = Wire().connect().run(500)
        victims = []

        def loses(direction: str, data: bytes) -> bool:
            if direction == "up" and len(victims) < lost:
                victims.append(data)
                return True
            return False

        wire.loses = loses
        wire.run(lost * 50 + 60)
        assert len(victims) == lost
        assert wire.server.link_alive(wire.server_ns) == survives
        if survives:
            assert (wire.server.statistics.lost, wire.server.statistics.longest_gap) == (4, 4)

    def test_the_server_tells_a_deaf_client_that_it_gave_up(self) -> None:
        wire = Wire().connect()
        wire.loses = lambda direction, data: direction == "up"
        wire.run(TIMEOUT_MS + 20)
        assert wire.client_events[-1] == SessionLost(Reason.LINK_TIMEOUT, ())

    def test_the_link_stays_up_for_minutes(self) -> None:
        wire = Wire(step_ns=5 * MS).connect().run(120_000)
        assert wire.client.connected
        assert wire.server.statistics.dropped == wire.client.statistics.dropped == 0
        assert wire.server.statistics.lost == wire.client.statistics.lost == 0


class TestRestarts:
    def test_a_restarted_client_at_the_same_address_takes_over_and_old_requests_do_not(self) -> None:
        wire = Wire(answer=None).connect()
        old_session = wire.server.session
        wire.client.submit(MOVE, wire.now_ns)
        (move,) = wire.client.outgoing(wire.now_ns)
        wire.client = ReferenceClient(8)
        wire.connect()
        assert SessionClosed(old_session or 0, Reason.PEER_RESTARTED) in wire.server_events
        assert dropped_causes(wire.give_server(move)) == ["session.unknown"]
        assert wire.requests() == []

    def test_a_restarted_client_at_another_address_waits_for_the_timeout(self) -> None:
        wire = Wire().connect()
        wire.client = ReferenceClient(8)
        wire.source = "vision, new port"
        wire.client.connect(wire.now_ns)
        wire.run(TIMEOUT_MS + 200)
        assert wire.client.connected
        assert ConnectionDelayed(Reason.SESSION_OCCUPIED) in wire.client_events
        closed = [e for e in wire.server_events if isinstance(e, SessionClosed)]
        assert [e.reason for e in closed] == [Reason.LINK_TIMEOUT]

    def test_a_restarted_controller_says_so_and_executes_nothing_of_the_time_before(self) -> None:
        wire = Wire(answer=None).connect()
        asked = wire.client.submit(MOVE, wire.now_ns)
        wire.run(10)
        assert len(wire.requests()) == 1
        wire.server = a_server(boot_id=BOOT + 1)
        wire.run(100)
        assert len(wire.requests()) == 1
        assert wire.client_events[-1] == SessionLost(Reason.UNKNOWN_SESSION, (asked,))
        assert not wire.client.connected
        wire.connect().run(100)
        assert len(wire.requests()) == 1
        assert wire.client.welcome is not None
        assert wire.client.welcome.boot_id == BOOT + 1

    def test_the_client_does_not_reconnect_by_itself(self) -> None:
        wire = Wire().connect()
        wire.server.close(wire.server_ns)
        wire.run(2000)
        assert len(wire.sessions()) == 1
        with pytest.raises(errors.LinkLost) as caught:
            wire.client.submit(STOP, wire.now_ns)
        assert caught.value.cause == "link.not_connected"

    def test_a_recorded_hello_opens_nothing_later(self) -> None:
        wire = Wire().connect().run(50)
        hello = wire.sent_up[0]
        assert dropped_causes(wire.give_server(hello)) == ["sequence.duplicate"]
        wire.client.disconnect(wire.now_ns)
        wire.run(5)
        assert dropped_causes(wire.give_server(hello)) == ["session.hello_replayed"]
        assert wire.server.session is None

    def test_a_hello_that_was_delayed_past_the_next_one_does_not_take_over(self) -> None:
        wire = Wire()
        wire.client.connect(wire.now_ns)
        (delayed,) = wire.client.outgoing(wire.now_ns)
        wire.now_ns += 10 * MS
        wire.connect()
        assert dropped_causes(wire.give_server(delayed)) == ["session.hello_replayed"]
        assert wire.server.link_alive(wire.server_ns)

    def test_connecting_anew_gives_the_old_session_and_its_requests_up(self) -> None:
        wire = Wire(answer=None).connect()
        wire.client.submit(MOVE, wire.now_ns)
        wire.run(10)
        assert len(wire.requests()) == 1
        wire.connect().run(300)
        assert len(wire.requests()) == 1
        assert answers(wire) == []
        assert wire.client.connected

    def test_ids_of_two_runs_of_a_client_differ(self) -> None:
        def first_id(nonce: int) -> int:
            wire = Wire(client=ReferenceClient(nonce)).connect()
            return wire.client.submit(STOP, wire.now_ns)

        assert first_id(7) != first_id(8)
        assert first_id(2**64 - 1) < 2**53


class TestRequests:
    def test_one_request_one_execution_one_answer(self) -> None:
        wire = Wire().connect()
        asked = [wire.client.submit(request, wire.now_ns) for request in (ENABLE, MOVE, STOP)]
        wire.run(100)
        assert wire.requests() == [
            ENABLE._replace(command_id=asked[0]),
            MOVE._replace(command_id=asked[1]),
            STOP._replace(command_id=asked[2]),
        ]
        assert answers(wire) == [Acknowledgement(i, Reason.ACCEPTED, 0.0, 0.0) for i in asked]

    def test_a_request_is_resent_under_its_id_until_it_is_answered(self) -> None:
        wire = Wire().connect()
        refused: list[bytes] = []

        def loses(direction: str, data: bytes) -> bool:
            if kind_of(data) == "Command" and len(refused) < 3:
                refused.append(data)
                return True
            return False

        wire.loses = loses
        asked = wire.client.submit(STOP, wire.now_ns)
        wire.run(200)
        assert len(refused) == 3
        assert len({decode(data).header.sequence for data in refused}) == 3
        assert wire.requests() == [STOP._replace(command_id=asked)]
        assert [a.command_id for a in answers(wire)] == [asked]

    def test_a_lost_answer_is_repeated_and_not_executed_again(self) -> None:
        wire = Wire(answer=Reason.UNREACHABLE).connect()
        lost: list[bytes] = []

        def loses(direction: str, data: bytes) -> bool:
            if kind_of(data) == "Acknowledgement" and len(lost) < 4:
                lost.append(data)
                return True
            return False

        wire.loses = loses
        asked = wire.client.submit(MOVE, wire.now_ns)
        wire.run(300)
        assert len(wire.requests()) == 1
        assert answers(wire) == [Acknowledgement(asked, Reason.UNREACHABLE, 0.0, 0.0)]

    def test_one_datagram_a_hundred_times_has_one_effect(self) -> None:
        wire = Wire().connect()
        wire.client.submit(MOVE, wire.now_ns)
        (move,) = wire.client.outgoing(wire.now_ns)
        events = [wire.give_server(move) for _ in range(100)]
        assert len(wire.requests()) == 1
        assert [dropped_causes(e) for e in events[1:]] == [["sequence.duplicate"]] * 99
        assert wire.server.statistics.duplicated == 99

    def test_a_request_is_not_answered_before_the_controller_has_decided(self) -> None:
        wire = Wire(answer=None).connect()
        asked = wire.client.submit(MOVE, wire.now_ns)
        wire.run(150)
        assert len(wire.requests()) == 1
        assert answers(wire) == []
        wire.server.acknowledge(Acknowledgement(asked, Reason.JOINT_LIMIT, 1.7, 1.6), wire.server_ns)
        wire.run(10)
        assert answers(wire) == [Acknowledgement(asked, Reason.JOINT_LIMIT, 1.7, 1.6)]

    def test_a_motion_cannot_overtake_the_stop_that_was_to_end_it(self) -> None:
        wire = Wire().connect()
        lost: list[bytes] = []

        def loses(direction: str, data: bytes) -> bool:
            if kind_of(data) == "ReferencePose" and not lost:
                lost.append(data)
                return True
            return False

        wire.loses = loses
        moved = wire.client.submit(MOVE, wire.now_ns)
        stopped = wire.client.submit(STOP, wire.now_ns)
        wire.run(200)
        assert wire.requests() == [STOP._replace(command_id=stopped)]
        assert Acknowledgement(moved, Reason.OVERTAKEN, float(moved), float(stopped)) in answers(wire)

    def test_an_id_with_another_content_is_refused(self) -> None:
        wire = Wire().connect()
        session = wire.server.session or 0
        send = partial(Header, session)
        wire.give_server(encode(Command(5, CommandCode.ENABLE), send(100, wire.now_ns)))
        wire.give_server(encode(Command(5, CommandCode.STOP), send(101, wire.now_ns)))
        replies = [
            decode(data).message for data, _ in wire.server.outgoing() if kind_of(data) == "Acknowledgement"
        ]
        assert replies == [
            Acknowledgement(5, Reason.ACCEPTED, 0.0, 0.0),
            Acknowledgement(5, Reason.REPEATED_COMMAND_ID, 0.0, 0.0),
        ]
        assert len(wire.requests()) == 1

    @pytest.mark.parametrize(
        ("request_", "ignored"),
        [
            (ENABLE._replace(command_id=5), range(52, 56)),
            (ReferencePath(5, (IDENTITY,), 0.0, 0.0), [*range(52, 56), *range(56 + 56, 40 + 1360)]),
        ],
        ids=["Command", "ReferencePath"],
    )
    def test_padding_and_unused_waypoints_do_not_make_another_request(
        self, request_: Command | ReferencePath, ignored: Sequence[int]
    ) -> None:
        wire = Wire().connect()
        plain = bytearray(encode(request_, Header(wire.server.session or 0, 100, wire.now_ns)))
        wire.give_server(bytes(plain))
        for n, place in enumerate([ignored[0], ignored[-1], *ignored[:: max(len(ignored) // 7, 1)]]):
            dirty = bytearray(plain)
            dirty[place] = 0xA5
            wire.give_server(with_number(bytes(dirty), 24, "I", 101 + n))
        replies = [decode(d).message for d, _ in wire.server.outgoing() if kind_of(d) == "Acknowledgement"]
        assert len(replies) > 4
        assert set(replies) == {Acknowledgement(5, Reason.ACCEPTED, 0.0, 0.0)}
        assert wire.requests() == [request_]

    def test_a_heartbeat_s_own_time_is_repeated_as_it_came(self) -> None:
        wire = Wire().connect()
        session = wire.server.session or 0
        for n, sent_ns in enumerate((0, 1, 2**64 - 1)):
            wire.give_server(encode(Heartbeat(sent_ns), Header(session, 100 + n, wire.now_ns)))
        replies = [m for d, _ in wire.server.outgoing() if isinstance(m := decode(d).message, HeartbeatReply)]
        assert [reply.sent_ns for reply in replies] == [0, 1, 2**64 - 1]

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

    def test_what_no_request_can_say_is_answered_by_the_session(self) -> None:
        wire = Wire().connect()
        command = encode(Command(5, CommandCode.STOP), Header(wire.server.session or 0, 100, wire.now_ns))
        assert wire.give_server(with_number(command, 48, "I", 77)) == []
        replies = [
            decode(data).message for data, _ in wire.server.outgoing() if kind_of(data) == "Acknowledgement"
        ]
        assert replies == [Acknowledgement(5, Reason.UNKNOWN_COMMAND, 77.0, 0.0)]

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
