"""What the scan gets of what the client asked for: stops first, the rest bounded."""

from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.core.arrivals import A_CYCLE, Arrivals, stop_of
from controller.core.arrivals import WAITING as MOST_ARRIVALS
from controller.core.inbox import WAITING, Inbox
from protocol.datagram import Header, encode
from protocol.faults import CommandCode, Reason
from protocol.pose import IDENTITY
from protocol.reference_messages import (
    STOPS,
    Command,
    ReferencePath,
    ReferencePose,
    Request,
    StreamedPose,
)
from protocol.session_events import RequestReceived, SessionClosed, StreamedPoseReceived

SESSION = 77
CODES = [*CommandCode]


def received(codes: Sequence[CommandCode]) -> list[RequestReceived]:
    return [RequestReceived(Command(i + 1, code)) for i, code in enumerate(codes)]


def ids(requests: Sequence[Request]) -> list[int]:
    return [request.command_id for request in requests]


def test_a_stop_is_handed_over_at_once_and_what_waited_is_overtaken() -> None:
    inbox = Inbox()
    asked = [CommandCode.RESET, CommandCode.ENABLE, CommandCode.STOP, CommandCode.START_STREAM]
    refused = inbox.put(list(received(asked)))
    assert [(a.command_id, a.reason, a.value, a.limit) for a in refused] == [
        (1, Reason.OVERTAKEN, 1.0, 3.0),
        (2, Reason.OVERTAKEN, 2.0, 3.0),
    ]
    assert ids(inbox.take(True)[0]) == [3, 4]


def test_a_full_queue_gives_up_its_oldest() -> None:
    inbox = Inbox()
    refused = inbox.put(list(received([CommandCode.RESET] * (WAITING + 3))))
    assert [(a.command_id, a.limit) for a in refused] == [(1, 65.0), (2, 66.0), (3, 67.0)]
    handed = [each for _ in range(20) for each in ids(inbox.take(True)[0])]
    assert handed == list(range(4, WAITING + 4))


def test_a_reference_overtakes_those_that_wait_and_no_command() -> None:
    inbox = Inbox()
    pose, path = ReferencePose(1, IDENTITY, 0.0), ReferencePath(3, (IDENTITY,), 0.0, 0.0)
    enable, end = Command(2, CommandCode.ENABLE), Command(5, CommandCode.END_STREAM)
    events = [RequestReceived(r) for r in (pose, enable, path, pose._replace(command_id=4), end)]
    assert [a.command_id for a in inbox.put(list(events))] == [1, 3]
    assert ids(inbox.take(True)[0]) == [2, 4, 5]


def streamed(stream_id: int, number: int) -> StreamedPoseReceived:
    return StreamedPoseReceived(StreamedPose(stream_id, number, 0, IDENTITY), 0, 0)


@pytest.mark.parametrize(
    ("came", "newest"),
    [
        ([(7, 1), (7, 2)], (7, 2)),
        ([(7, 5), (7, 4), (7, 4)], (7, 5)),
        ([(7, 2**32 - 1), (7, 0)], (7, 0)),
        ([(7, 0), (7, 2**32 - 1)], (7, 0)),
        ([(7, 5), (8, 1)], (8, 1)),
    ],
)
def test_of_streamed_references_the_newest_by_number_is_judged(
    came: list[tuple[int, int]], newest: tuple[int, int]
) -> None:
    inbox = Inbox()
    inbox.put([streamed(*each) for each in came])
    assert inbox.take_streamed() == streamed(*newest)
    assert inbox.take_streamed() is None


def test_of_too_many_stops_one_goes_that_is_said_again_later() -> None:
    inbox = Inbox()
    once = [CommandCode.DISABLE, CommandCode.EMERGENCY_STOP]
    inbox.put(list(received([*once, *[CommandCode.STOP] * (WAITING - 1)])))
    handed = ids(inbox.take(True)[0])
    assert handed == [1, 2, *range(4, WAITING + 2)]


def test_stops_of_a_session_that_ended_are_obeyed_and_nothing_else_of_it() -> None:
    inbox = Inbox()
    asked = received([CommandCode.EMERGENCY_STOP, CommandCode.EMERGENCY_RELEASE])
    assert inbox.put([*asked, SessionClosed(1, Reason.SHUTDOWN), SessionClosed(2, Reason.SHUTDOWN)]) == []
    assert inbox.take(True) == ((asked[0].message,), False)
    assert inbox.take(True) == ((), True)


@given(st.lists(st.lists(st.sampled_from(CODES), max_size=150), max_size=6))
def test_every_request_has_one_fate_and_no_stop_misses_its_scan(batches: list[list[CommandCode]]) -> None:
    inbox = Inbox()
    fates: list[int] = []
    asked = 0
    for codes in batches:
        events = [RequestReceived(Command(asked + i + 1, code)) for i, code in enumerate(codes)]
        asked += len(codes)
        refused = inbox.put(list(events))
        handed, _ = inbox.take(True)
        fates += [*(a.command_id for a in refused), *ids(handed)]
        assert {code for code in codes if code in STOPS} == {
            r.code for r in handed if isinstance(r, Command) and r.code in STOPS
        }
        assert ids(handed) == sorted(ids(handed))
    while rest := inbox.take(True)[0]:
        fates += ids(rest)
    assert sorted(fates) == list(range(1, asked + 1))


def test_a_datagram_that_says_it_is_a_stop_is_seen_to_be_one() -> None:
    for code in CommandCode:
        data = encode(Command(5, code), Header(SESSION, 1, 0))
        assert stop_of(data, SESSION) == ((code, 5) if code in STOPS else None)
        assert stop_of(data, SESSION + 1) is None
        assert stop_of(data, None) is None
        assert stop_of(data[:40], SESSION) is None
    other = encode(ReferencePose(CommandCode.STOP, IDENTITY, 0.0), Header(SESSION, 1, 0))
    assert stop_of(other, SESSION) is None


@given(st.lists(st.sampled_from([*STOPS, *[CommandCode.ENABLE] * 60]), max_size=900))
def test_the_newest_of_each_stop_is_in_the_next_slice(codes: list[CommandCode]) -> None:
    arrivals = Arrivals()
    left_out = 0
    for i, code in enumerate(codes):
        left_out += arrivals.put(encode(Command(i + 1, code), Header(SESSION, i, 0)), i, SESSION)
    assert len(arrivals) + left_out == len(codes)
    assert len(arrivals) <= MOST_ARRIVALS + len(STOPS)
    taken = [number for _, number in arrivals.take(A_CYCLE) if isinstance(number, int)]
    assert taken == sorted(taken)
    for code in STOPS & set(codes):
        assert len(codes) - 1 - codes[::-1].index(code) in taken


def test_a_repetition_does_not_push_out_the_newer_stop_before_it() -> None:
    arrivals = Arrivals()
    for command_id in [*range(20, 20 + A_CYCLE), 3]:
        code = CommandCode.STOP if command_id in (3, 40) else CommandCode.ENABLE
        arrivals.put(encode(Command(command_id, code), Header(SESSION, 1, 0)), command_id, SESSION)
    assert [command_id for _, command_id in arrivals.take(A_CYCLE)] == [40]
