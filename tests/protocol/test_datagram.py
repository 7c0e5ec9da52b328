"""The codec of the reference link: what goes in comes out, and nothing that was touched on the way."""

import json
import math
import struct
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conformance.wire import resealed, with_number
from protocol.datagram import Datagram, Header, decode, encode
from protocol.datagram_layout import (
    HEADER_BYTES,
    MAX_DATAGRAM_BYTES,
    PAYLOADS,
    TRAILER,
    TRAILER_BYTES,
    Kind,
    offsets,
    size_of,
)
from protocol.errors import DatagramRefused, RequestRefused
from protocol.faults import Reason
from protocol.pose import Pose
from protocol.reference_messages import (
    Acknowledgement,
    Bye,
    Hello,
    Message,
    ReferencePath,
    ReferencePose,
    UnusableRequest,
)
from tests.protocol.sample_messages import HEADER, MESSAGES, POSE
from tests.protocol.strategies import headers, messages

GOLDEN = json.loads(Path(__file__).with_name("golden_datagrams.json").read_text())
by_name = pytest.mark.parametrize("message", MESSAGES, ids=lambda m: type(m).__name__)


def cause_of(datagram: bytes) -> str:
    with pytest.raises(DatagramRefused) as caught:
        decode(datagram)
    return caught.value.cause


@settings(max_examples=300)
@given(messages, headers)
def test_every_message_comes_back_as_it_was_sent(message: Message, header: Header) -> None:
    assert decode(encode(message, header)) == Datagram(header, message)


@by_name
def test_the_bytes_on_the_wire_are_these(message: Message) -> None:
    golden = bytes.fromhex(GOLDEN[type(message).__name__])
    assert encode(message, HEADER) == golden
    assert decode(golden) == Datagram(HEADER, message)


def test_a_datagram_fits_an_ethernet_frame_unfragmented() -> None:
    largest = max(HEADER_BYTES + size_of(fields) for fields in PAYLOADS.values())
    assert largest + TRAILER_BYTES == MAX_DATAGRAM_BYTES <= 1472


def test_numbers_sit_at_a_multiple_of_their_size() -> None:
    assert HEADER_BYTES % 8 == 0
    for fields in (*PAYLOADS.values(), TRAILER):
        assert size_of(fields) % 8 == 0
        for field, offset in zip(fields, offsets(fields), strict=True):
            of_one = 1 if field.code.endswith("s") else field.size // field.count
            assert offset % of_one == 0


@by_name
def test_every_flipped_bit_is_refused(message: Message) -> None:
    datagram = encode(message, HEADER)
    for bit in range(8 * len(datagram)):
        flipped = bytearray(datagram)
        flipped[bit // 8] ^= 1 << bit % 8
        assert cause_of(bytes(flipped)).startswith("datagram.")


@pytest.mark.parametrize(
    ("offset", "code", "value", "cause"),
    [
        (0, "I", 0x4B4C5253, "datagram.bad_magic"),
        (4, "B", 0, "datagram.wrong_major"),
        (4, "B", 2, "datagram.wrong_major"),
        (6, "B", 0, "datagram.unknown_kind"),
        (6, "B", 13, "datagram.unknown_kind"),
        (6, "B", Kind.WELCOME, "datagram.wrong_payload_length"),
        (8, "H", 1 << 8, "datagram.bad_length"),
        (8, "H", 1 << 9, "datagram.unknown_critical_flag"),
        (8, "H", 1 << 15, "datagram.unknown_critical_flag"),
        (HEADER_BYTES, "Q", 0, "datagram.bad_value"),
        (HEADER_BYTES + 24, "I", 60_001, "datagram.bad_value"),
    ],
)
def test_each_fault_has_its_cause(offset: int, code: str, value: int, cause: str) -> None:
    hello = encode(Hello(1, 2, 3, 4), HEADER)
    assert cause_of(with_number(hello, offset, code, value)) == cause


def test_a_payload_of_another_length_is_told_with_its_own() -> None:
    with pytest.raises(DatagramRefused, match=r"payload of 35 bytes: the header says 32"):
        decode(encode(Hello(1, 2, 3, 4), HEADER) + bytes(3))


@pytest.mark.parametrize("minor", [0, 1, 255])
def test_a_newer_minor_version_and_unknown_optional_flags_are_read(minor: int) -> None:
    header = HEADER._replace(minor=minor, flags=0x00FF)
    assert decode(encode(MESSAGES[0], header)) == Datagram(header, MESSAGES[0])


@pytest.mark.parametrize("odd", [math.nan, math.inf, -math.inf, 5e-324, -0.0])
def test_odd_floats_are_carried_so_that_the_controller_can_refuse_them_by_reason(odd: float) -> None:
    sent = ReferencePose(1, Pose((odd, 0.0, 0.0), (1.0, 0.0, 0.0, odd)), odd)
    got = decode(encode(sent, HEADER)).message
    assert isinstance(got, ReferencePose)
    assert [struct.pack("<d", x) for x in (got.X_BT_ref.p_m[0], got.X_BT_ref.q_wxyz[3], got.duration_s)] == [
        struct.pack("<d", odd)
    ] * 3


@pytest.mark.parametrize("kind", [Kind.ACKNOWLEDGEMENT, Kind.STATE, Kind.BYE], ids=lambda k: k.name)
def test_an_enumeration_beyond_its_members_is_refused(kind: Kind) -> None:
    message = next(m for m in MESSAGES if m.__class__.__name__.upper() == kind.name)
    fields = PAYLOADS[kind]
    for field, offset in zip(fields, offsets(fields), strict=True):
        if field.enum is not None:
            assert cause_of(with_number(encode(message, HEADER), HEADER_BYTES + offset, field.code, 999)) == (
                "datagram.bad_value"
            )


@pytest.mark.parametrize(
    ("message", "header", "named"),
    [
        (Hello(0, 0, 0, 0), HEADER, "client_nonce = 0"),
        (Hello(1, 0, 0, 60_001), HEADER, "state_period_ms = 60001"),
        (Hello(2**64, 0, 0, 0), HEADER, "client_nonce"),
        (Acknowledgement(-1, Reason.ACCEPTED, 0.0, 0.0), HEADER, "command_id = -1"),
        (ReferencePath(1, (), 0.0, 0.0), HEADER, "0 waypoints"),
        (ReferencePath(1, (POSE,) * 25, 0.0, 0.0), HEADER, "25 waypoints"),
        (Bye(Reason.SHUTDOWN), HEADER._replace(sequence=2**32), "4294967296"),
        (Bye(Reason.SHUTDOWN), HEADER._replace(sent_ns=-1), "sent_ns=-1"),
    ],
)
def test_what_does_not_fit_is_refused_before_it_is_sent(message: Message, header: Header, named: str) -> None:
    with pytest.raises(RequestRefused, match=named) as caught:
        encode(message, header)
    assert caught.value.cause == "refused.not_encodable"


@settings(max_examples=500)
@given(st.sampled_from(MESSAGES), st.data())
def test_noise_behind_a_right_crc_decodes_or_is_refused(message: Message, data: st.DataObject) -> None:
    datagram = bytearray(encode(message, HEADER))
    for _ in range(data.draw(st.integers(1, 4))):
        datagram[data.draw(st.integers(0, len(datagram) - 1))] = data.draw(st.integers(0, 255))
    try:
        got = decode(resealed(bytes(datagram)))
    except DatagramRefused:
        return
    if not isinstance(got.message, UnusableRequest):
        assert len(encode(got.message, got.header)) == len(datagram)
