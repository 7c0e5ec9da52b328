"""Where pymodbus alone is not strict enough, and what is made of it: frames of a stream, and PDUs."""

import struct

import pytest
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse
from pymodbus.pdu.register_message import ReadWriteMultipleRegistersResponse

from foundation.modbus import PlaceLost, StreamFramer, decoded, encoded

REQUESTS, RESPONSES = DecodePDU(is_server=True), DecodePDU(is_server=False)
SHORT = bytes.fromhex("0001 0000 0002 01 07")
WORDS = ReadWriteMultipleRegistersResponse(registers=list(range(40)))


def test_a_frame_of_one_byte_takes_none_of_the_next() -> None:
    behind = SHORT + SHORT[:1]
    assert FramerSocket(REQUESTS).decode(behind) == (9, 1, 1, b"\7\0"), "pymodbus has mended it"
    assert StreamFramer(REQUESTS).decode(behind) == (8, 1, 1, b"\7")


@pytest.mark.parametrize("header", ["0001 0001 0006", "0001 0000 0001", "0001 0000 00FF"])
def test_a_header_that_makes_no_sense_is_refused_as_soon_as_it_is_whole(header: str) -> None:
    bad = bytes.fromhex(header)
    with pytest.raises(PlaceLost, match=bad.hex()):
        StreamFramer(REQUESTS).decode(bad)
    assert StreamFramer(REQUESTS).decode(bad[:-1])[0] == 0


def test_frames_are_cut_wherever_pieces_end() -> None:
    framer = StreamFramer(RESPONSES)
    pdus = [encoded(WORDS), b"\7", b"\x97\6", bytes(253)]
    stream = b"".join(framer.encode(pdu, 247, number) for number, pdu in enumerate(pdus, 65_532))
    for size in (1, 2, 7, 8, 9, 50, len(stream)):
        held, found = b"", []
        for at in range(0, len(stream), size):
            held += stream[at : at + size]
            while (frame := framer.decode(held))[0]:
                held = held[frame[0] :]
                found.append(frame[1:])
        assert found == [(247, number, pdu) for number, pdu in enumerate(pdus, 65_532)]
        assert held == b""


def test_a_pdu_is_decoded_with_its_own_length_alone() -> None:
    sound = encoded(WORDS)
    found = decoded(RESPONSES, sound)
    assert isinstance(found, ReadWriteMultipleRegistersResponse)
    assert found.registers == list(range(40))
    refusal = decoded(RESPONSES, b"\x97\6")
    assert isinstance(refusal, ExceptionResponse)
    assert (refusal.function_code, refusal.exception_code) == (0x97, 6)
    for data in (
        sound + b"\0",
        sound[:-1],
        b"\x97",
        b"\x97\6\0",
        b"\x17",
        b"\x63\0",
        sound[:1] + b"\x4f" + sound[2:],
    ):
        assert decoded(RESPONSES, data) is None, data.hex()


def test_a_request_may_not_lie_about_its_length() -> None:
    assert decoded(REQUESTS, struct.pack(">BHH", 3, 0, 40)) is not None
    assert decoded(REQUESTS, struct.pack(">BHHH", 3, 0, 40, 0)) is None
    assert decoded(REQUESTS, struct.pack(">BHHB", 16, 0x800, 1, 4) + bytes(2)) is None
