"""Streamed references through both ends of a session: neither repeated nor acknowledged, refused by name."""

import pytest

from protocol.client_session import ReferenceClient
from protocol.datagram import Header, decode, encode
from protocol.errors import LinkLost, RequestRefused
from protocol.faults import CommandCode, Reason
from protocol.pose import Pose
from protocol.reference_messages import (
    CAPABILITY_PATHS,
    Command,
    ReferencePath,
    ReferencePose,
    StreamedPose,
    StreamRefused,
)
from protocol.session_events import StreamedPoseReceived, StreamRefusedReceived
from tests.protocol.wire import MS, Wire, a_server

POSE = Pose((4.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0))
REFUSAL = StreamRefused(9, 4, Reason.TOO_FAR, 0.7, 0.5)


def arrived(wire: Wire) -> list[StreamedPoseReceived]:
    return [event for event in wire.server_events if isinstance(event, StreamedPoseReceived)]


def settled() -> Wire:
    """A connected wire whose fastest transit is known."""
    wire = Wire().connect()
    wire.run(100)
    return wire


def test_a_reference_goes_once_and_is_not_acknowledged() -> None:
    wire = settled()
    wire.client.stream(StreamedPose(9, 4, wire.now_ns, POSE), wire.now_ns)
    wire.run(500)
    assert [event.message.number for event in arrived(wire)] == [4]
    streamed = [data for data in wire.sent_up if isinstance(decode(data).message, StreamedPose)]
    assert len(streamed) == 1


def test_its_times_are_told_on_the_servers_clock() -> None:
    wire = settled()
    measured_ns = wire.now_ns - 40 * MS
    wire.client.stream(StreamedPose(9, 4, measured_ns, POSE), wire.now_ns)
    sent_ns = wire.now_ns
    wire.run(20)
    (event,) = arrived(wire)
    # one way is not known without a common clock: the least transit counts as none
    assert event.left_ns == pytest.approx(sent_ns + wire.offset_ns + wire.up_ns, abs=2 * MS)
    assert event.left_ns - event.measured_ns == pytest.approx(40 * MS, abs=2 * MS)  # sent a step later


def test_a_refusal_reaches_the_client() -> None:
    wire = settled()
    wire.server.refuse_streamed(REFUSAL, wire.server_ns)
    wire.run(20)
    assert StreamRefusedReceived(REFUSAL) in wire.client_events


@pytest.mark.parametrize("code", [CommandCode.START_STREAM, CommandCode.END_STREAM])
def test_commands_of_streams_need_the_capability_on_both_sides(code: CommandCode) -> None:
    wire = Wire(server=a_server(capabilities=CAPABILITY_PATHS)).connect()
    with pytest.raises(RequestRefused) as caught:
        wire.client.submit(Command(0, code), wire.now_ns)
    assert caught.value.cause == "refused.not_negotiated"
    assert code.name in str(caught.value)
    wire.give_server(encode(Command(5, code), Header(wire.server.session or 0, 1000, wire.now_ns)))
    answers = [decode(data).message for data, _ in wire.server.outgoing(wire.server_ns)]
    assert [getattr(answer, "reason", None) for answer in answers] == [Reason.NOT_NEGOTIATED]


def test_a_pose_and_a_stop_need_no_capability() -> None:
    wire = Wire(server=a_server(capabilities=0)).connect()
    for request in (ReferencePose(0, POSE, 0.0), Command(0, CommandCode.STOP)):
        wire.client.submit(request, wire.now_ns)
    with pytest.raises(RequestRefused, match="takes no ReferencePath"):
        wire.client.submit(ReferencePath(0, (POSE,), 0.0, 0.0), wire.now_ns)


def test_a_reference_needs_a_session_and_must_fit_its_fields() -> None:
    client = ReferenceClient(7)
    with pytest.raises(LinkLost) as lost:
        client.stream(StreamedPose(9, 4, 0, POSE), 0)
    assert lost.value.cause == "link.not_connected"
    wire = settled()
    with pytest.raises(RequestRefused) as refused:
        wire.client.stream(StreamedPose(9, 2**32, 0, POSE), wire.now_ns)
    assert refused.value.cause == "refused.not_encodable"
