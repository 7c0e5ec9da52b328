"""The header of a stereo frame: a stream that lost its place is noticed at once."""

import struct
from zlib import crc32

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import FrameRefused, RequestRefused
from protocol.stereo_frame import HEADER_BYTES, FrameHeader, decode_header, encode_header

HEADER = FrameHeader(7, 123_456_789_000, 123_466_789_000, 1280, 720, 8000, 0)
GOLDEN = (
    "4c525346" "0100" "3400" "0700000000000000" "081a99be1c000000" "88b031bf1c000000"
    + "00050000" "d0020000" "401f0000" "00000000"
)  # fmt: skip

u64 = st.integers(0, 2**64 - 1)
u32 = st.integers(0, 2**32 - 1)
side = st.integers(1, 4096)


def cause_of(data: bytes) -> str:
    with pytest.raises(FrameRefused) as caught:
        decode_header(data)
    return caught.value.cause


def patched(offset: int, code: str, value: int) -> bytes:
    data = bytearray(encode_header(HEADER))
    struct.pack_into("<" + code, data, offset, value)
    return bytes(data[:-4]) + struct.pack("<I", crc32(data[:-4]))


@given(st.builds(FrameHeader, u64, u64, u64, side, side, u32, u32))
def test_a_header_comes_back_as_it_was_sent(header: FrameHeader) -> None:
    assert decode_header(encode_header(header)) == header


def test_the_bytes_on_the_stream_are_these() -> None:
    covered = bytes.fromhex(GOLDEN)
    assert encode_header(HEADER) == covered + struct.pack("<I", crc32(covered))
    assert HEADER.payload_bytes == 1_843_200


def test_every_flipped_bit_and_every_wrong_length_is_refused() -> None:
    data = encode_header(HEADER)
    for bit in range(8 * HEADER_BYTES):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << bit % 8
        assert cause_of(bytes(flipped)).startswith("frame.")
    for length in [*range(HEADER_BYTES), HEADER_BYTES + 1]:
        assert cause_of((data + b"\0")[:length]) == "frame.bad_length"


@pytest.mark.parametrize(
    ("offset", "code", "value", "cause"),
    [
        (0, "I", 0, "frame.bad_magic"),
        (4, "H", 2, "frame.wrong_version"),
        (6, "H", 64, "frame.bad_length"),
        (32, "I", 0, "frame.bad_size"),
        (36, "I", 4097, "frame.bad_size"),
    ],
)
def test_each_fault_has_its_cause(offset: int, code: str, value: int, cause: str) -> None:
    assert cause_of(patched(offset, code, value)) == cause


def test_a_frame_of_impossible_size_is_not_sent() -> None:
    with pytest.raises(RequestRefused):
        encode_header(HEADER._replace(width=0))
    with pytest.raises(RequestRefused):
        encode_header(HEADER._replace(exposure_us=-1))
