"""What an ADS device answers: values, refusals by return code, and bounds for clients that ask too much."""

import struct
from typing import Any

import pytest

from controller_st.ads_device import HANDLES, NOTIFICATIONS, PORT, SUMMED, AdsClient, AdsDevice
from controller_st.ads_frames import MAX_FRAME, AdsError, AmsAddress, AmsFrame, StreamBroken, cut
from structured_text.program import CompiledProgram

COUNTER = """
TYPE
E_Kind : (Soft := 3, Hard := 7) INT;
ST_Part : STRUCT
    fGain : LREAL := 2.5;
    aGrid : ARRAY[1..2, 0..2] OF INT := [10, 11, 12, 20, 21, 22];
END_STRUCT;
END_TYPE

PROGRAM MAIN
VAR
    nCount : UDINT;
    xOn : BOOL := TRUE;
    eKind : E_Kind := E_Kind.Soft;
    afSix : ARRAY[0..5] OF LREAL := [0.5, 1.5, 2.5, 3.5, 4.5, 5.5];
    stPart : ST_Part;
END_VAR
nCount := nCount + 1;
END_PROGRAM
"""
DEVICE, CLIENT = AmsAddress(b"\x7f\0\0\1\1\1", PORT), AmsAddress(b"\x0a\0\0\1\1\1", 32_000)
HANDLE, VALUE, RELEASE, DATA, SUM_READ, SUM_WRITE = 0xF003, 0xF005, 0xF006, 0x4040, 0xF080, 0xF081


class GroupRequest:
    """A device, and one client of it."""

    def __init__(self, writable: bool = False) -> None:
        self.program = CompiledProgram({"counter.st": COUNTER})
        self.main = self.program.memory.MAIN
        self.device, self.client = AdsDevice(self.program.memory, writable=writable), AdsClient()

    def ask(
        self, command: int, form: str, *values: Any, data: bytes = b"", now_ns: int = 0
    ) -> tuple[int, bytes]:
        """Return code, and what follows it."""
        frame = AmsFrame(DEVICE, CLIENT, command, 4, 0, 9, struct.pack("<" + form, *values) + data)
        answer = self.device.answer(self.client, frame, now_ns)
        assert (answer.target, answer.source, answer.invoke_id, answer.flags) == (CLIENT, DEVICE, 9, 5)
        return struct.unpack_from("<I", answer.data)[0], answer.data[4:]

    def read(self, group: int, offset: int, size: int) -> tuple[int, bytes]:
        code, rest = self.ask(2, "III", group, offset, size)
        return code, rest[4:]

    def handle(self, name: str) -> int:
        code, rest = self.ask(9, "IIII", HANDLE, 0, 4, len(name), data=name.encode())
        assert code == 0, AdsError(code)
        return int(struct.unpack("<I", rest[4:])[0])

    def write(self, group: int, offset: int, value: bytes) -> int:
        return self.ask(3, "III", group, offset, len(value), data=value)[0]


def test_a_variable_is_read_by_handle_and_by_place_until_it_is_released() -> None:
    asked = GroupRequest()
    handle = asked.handle("main.STPART.agrid[2,1]")
    assert asked.read(VALUE, handle, 2) == (0, struct.pack("<h", 21))
    symbol = asked.device.table.find("MAIN.afSix")
    assert symbol is not None
    assert asked.read(DATA, symbol.offset + 8, 8) == (0, struct.pack("<d", 1.5))
    assert asked.write(RELEASE, 0, struct.pack("<I", handle)) == 0
    assert asked.read(VALUE, handle, 2)[0] == AdsError.SYMBOL_NOT_FOUND


@pytest.mark.parametrize(
    "name",
    [
        "MAIN.nothing",
        "MAIN.stPart.aGrid[3,1]",
        "MAIN.afSix[0,0]",
        "MAIN..xOn",
        "",
        "MAIN.xOn[",
        f"MAIN.afSix[{'1' * 5000}]",
    ],
)
def test_an_unknown_name_is_no_symbol(name: str) -> None:
    asked = GroupRequest()
    code, _ = asked.ask(9, "IIII", HANDLE, 0, 4, len(name), data=name.encode())
    assert code == AdsError.SYMBOL_NOT_FOUND


def test_nothing_is_written_unless_it_is_allowed() -> None:
    asked = GroupRequest()
    assert (
        asked.write(VALUE, asked.handle("MAIN.stPart.fGain"), struct.pack("<d", 3.0))
        == AdsError.INVALID_ACCESS
    )
    assert asked.main.stPart.fGain == 2.5


def test_only_whole_numbers_and_truths_are_written() -> None:
    asked = GroupRequest(writable=True)
    place = asked.device.table.find("MAIN.afSix[2]")
    assert place is not None
    for name, value, code in (
        ("MAIN.stPart.fGain", struct.pack("<d", 3.0), 0),
        ("MAIN.stPart.fGain", b"\1\2", AdsError.INVALID_SIZE),
        ("MAIN.xOn", b"\0", 0),
        ("MAIN.xOn", b"\2", AdsError.INVALID_DATA),
        ("MAIN.eKind", b"\x09\0", AdsError.INVALID_DATA),
        ("MAIN.stPart", bytes(24), AdsError.INVALID_DATA),
    ):
        assert asked.write(VALUE, asked.handle(name), value) == code, name
    assert asked.write(DATA, place.offset, struct.pack("<d", -1.0)) == 0
    assert asked.write(DATA, place.offset + 4, struct.pack("<d", -1.0)) == AdsError.INVALID_OFFSET
    assert (asked.main.stPart.fGain, asked.main.xOn, asked.main.eKind) == (3.0, False, 3)
    assert asked.main.afSix.numbers.tolist() == [0.5, 1.5, -1.0, 3.5, 4.5, 5.5]


def test_a_sum_answers_each_part_and_a_part_that_fails_leaves_the_others_in_place() -> None:
    asked = GroupRequest(writable=True)
    gain = asked.handle("MAIN.stPart.fGain")
    heads = struct.pack("<9I", VALUE, gain, 8, VALUE, 999, 4, VALUE, asked.handle("MAIN.xOn"), 1)
    code, rest = asked.ask(9, "IIII", SUM_READ, 3, 25, len(heads), data=heads)
    assert (code, rest[4:]) == (
        0, struct.pack("<3Id4sB", 0, AdsError.SYMBOL_NOT_FOUND, 0, 2.5, b"\0" * 4, 1)
    )  # fmt: skip
    written = struct.pack("<6Id", VALUE, gain, 8, VALUE, 999, 4, 5.0)
    code, rest = asked.ask(9, "IIII", SUM_WRITE, 2, 8, len(written), data=written)
    assert (code, rest[4:]) == (0, struct.pack("<II", 0, AdsError.INVALID_SIZE))
    assert asked.main.stPart.fGain == 5.0


def test_a_notification_comes_at_its_period_or_when_the_value_has_changed() -> None:
    asked = GroupRequest()
    count = asked.handle("MAIN.nCount")
    for mode in (3, 4):
        assert asked.ask(6, "IIIIII16x", VALUE, count, 4, mode, 0, 100_000)[0] == 0
    assert asked.ask(6, "IIIIII16x", VALUE, count, 4, 1, 0, 0)[0] == AdsError.SERVICE_NOT_SUPPORTED
    sizes = []
    for now_ms in (0, 5, 10, 20):
        if now_ms == 20:
            asked.program.run("MAIN")
        frame = asked.device.due(asked.client, now_ms * 1_000_000, 1_700_000_000_000_000_000)
        sizes.append(0 if frame is None else struct.unpack_from("<I", frame.data, 16)[0])
    assert sizes == [2, 0, 1, 2]
    assert frame is not None
    (stamp,) = struct.unpack_from("<Q", frame.data, 8)
    assert stamp == 133_444_736_000_000_000  # 14 November 2023, in 100 ns since 1601
    assert asked.ask(7, "I", 99)[0] == AdsError.INVALID_NOTIFICATION


def test_a_client_that_asks_for_ever_more_is_refused() -> None:
    asked = GroupRequest()
    handles = [asked.handle("MAIN.xOn") for _ in range(HANDLES)]
    assert asked.ask(9, "IIII", HANDLE, 0, 4, 8, data=b"MAIN.xOn")[0] == AdsError.NO_MEMORY
    for _ in range(NOTIFICATIONS):
        assert asked.ask(6, "IIIIII16x", VALUE, handles[0], 1, 3, 0, 0)[0] == 0
    assert asked.ask(6, "IIIIII16x", VALUE, handles[0], 1, 3, 0, 0)[0] == AdsError.NO_MEMORY
    many = struct.pack("<III", VALUE, handles[0], 1) * (SUMMED + 1)
    assert asked.ask(9, "IIII", SUM_READ, SUMMED + 1, 4, len(many), data=many)[0] == AdsError.INVALID_SIZE
    for group, offset, size, code in (
        (DATA, 0, 4_000_000_000, AdsError.INVALID_SIZE),
        (DATA, 4_294_967_295, 8, AdsError.INVALID_OFFSET),
        (0x1234, 0, 4, AdsError.INVALID_GROUP),
    ):
        assert asked.read(group, offset, size)[0] == code
    assert asked.ask(99, "")[0] == AdsError.SERVICE_NOT_SUPPORTED
    assert asked.ask(2, "I", 1)[0] == AdsError.INVALID_SIZE
    assert asked.client.refused == 8


def test_frames_are_cut_from_a_stream_and_what_is_none_ends_it() -> None:
    frame = AmsFrame(DEVICE, CLIENT, 4, 4, 0, 1, b"abc")
    stream = bytearray(frame.packed * 2)
    last = stream.pop()
    assert cut(stream) == frame
    assert cut(stream) is None
    stream.append(last)
    assert (cut(stream), bytes(stream)) == (frame, b"")
    for wrong in (struct.pack("<HI", 0, MAX_FRAME + 1), struct.pack("<HI", 0, 31), b"GET / HTTP/1.1"):
        with pytest.raises(StreamBroken):
            cut(bytearray(wrong))
