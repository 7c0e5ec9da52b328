"""Which exception each malformed Modbus request deserves."""

import struct

import pytest

from plant_emulator.core.coupler.modbus_requests import RegisterMap, Span
from plant_emulator.shell.coupler_connection import request_of

IN, OUT, CONFIGURATION = Span(0, 40), Span(0x800, 12), Span(0x1120, 3)
MAP = RegisterMap(
    reads={1: (Span(0, 16),), 2: (Span(0, 9),), 3: (IN, OUT, CONFIGURATION), 4: (IN,), 23: (IN, OUT)},
    writes={5: (Span(0, 16),), 6: (OUT, CONFIGURATION), 15: (Span(0, 16),), 16: (OUT,), 23: (OUT,)},
)


def read(function: int, address: int, count: int) -> bytes:
    """A read request."""
    return struct.pack(">BHH", function, address, count)


def write(address: int, words: list[int], *, count: int | None = None, size: int | None = None) -> bytes:
    """An FC 16 request; ``count`` and ``size`` may lie."""
    number = len(words) if count is None else count
    head = struct.pack(">BHHB", 16, address, number, 2 * len(words) if size is None else size)
    return head + struct.pack(f">{len(words)}H", *words)


def exchange(reads: tuple[int, int], address: int, words: list[int], *, count: int | None = None) -> bytes:
    """An FC 23 request; ``count`` may lie."""
    number = len(words) if count is None else count
    head = struct.pack(">BHHHHB", 23, *reads, address, number, 2 * len(words))
    return head + struct.pack(f">{len(words)}H", *words)


SOUND = [
    read(3, 0, 40),
    read(4, 39, 1),
    read(3, 0x800, 12),
    struct.pack(">BHH", 6, 0x80B, 7),
    write(0x800, [0] * 12),
    exchange((0, 40), 0x800, [0] * 12),
    read(3, 0x1120, 3),
    read(1, 0, 16),
    read(2, 8, 1),
    bytes.fromhex("05 000F FF00"),
    bytes.fromhex("05 0000 0000"),
    bytes.fromhex("06 1121 BECF"),
    bytes.fromhex("0F 0000 0010 02 FFFF"),
    bytes.fromhex("0F 0003 0001 01 FE"),
    bytes.fromhex("08 0000 1234"),
    bytes.fromhex("08 0000 1234 5678"),
    *(bytes([8, 0, sub, 0, 0]) for sub in (2, 10, 11, 12, 13, 14)),
]
REFUSED = [
    (read(3, 0, 0), 3),
    (read(3, 0, 126), 3),
    (read(3, 0, 41), 2),
    (read(4, 40, 1), 2),
    (read(3, 39, 2), 2),
    (read(3, 0x7FF, 1), 2),
    (read(3, 0xFFFF, 2), 2),
    (read(3, 0, 1)[:-1], 3),
    (read(3, 0, 1) + b"\0", 3),
    (struct.pack(">BHH", 6, 0, 7), 2),
    (struct.pack(">BH", 6, 0x800), 3),
    (write(0x800, []), 3),
    (write(0x800, [0] * 13), 2),
    (write(0x7FF, [0]), 2),
    (write(0, [0]), 2),
    (write(0x800, [0], count=2), 3),
    (write(0x800, [0, 0], size=2), 3),
    (write(0x800, [0] * 12)[:-1], 3),
    (write(0x800, [0] * 12) + b"\0", 3),
    (exchange((0, 0), 0x800, [0]), 3),
    (exchange((0, 126), 0x800, [0]), 3),
    (exchange((0, 40), 0x800, [0] * 122), 3),
    (exchange((0, 40), 0x800, [0], count=0), 3),
    (exchange((0, 40), 0x80C, [0]), 2),
    (exchange((1, 40), 0x800, [0]), 2),
    (exchange((0, 40), 0x800, [0])[:-1], 3),
    (read(4, 0x800, 1), 2),
    (exchange((0, 40), 0x1120, [0]), 2),
    (write(0x1120, [0]), 2),
    (read(1, 0, 0), 3),
    (read(1, 0, 2001), 3),
    (read(1, 0, 2000), 2),
    (read(1, 0, 17), 2),
    (read(2, 9, 1), 2),
    (bytes.fromhex("05 0000 1234"), 3),
    (bytes.fromhex("05 0000 00FF"), 3),
    (bytes.fromhex("05 0010 FF00"), 2),
    (bytes.fromhex("05 0000 FF"), 3),
    (bytes.fromhex("0F 0000 0000 00"), 3),
    (bytes.fromhex("0F 0000 0009 01 FF"), 3),
    (bytes.fromhex("0F 0000 0008 02 FFFF"), 3),
    (bytes.fromhex("0F 0000 0008 01"), 3),
    (bytes.fromhex("0F 0000 0008"), 3),
    (bytes.fromhex("0F 0009 0008 01 FF"), 2),
    (struct.pack(">BHHB", 15, 0, 1969, 247) + bytes(247), 3),
    (b"\x08\x00", 3),
    (bytes.fromhex("08 0000"), 3),
    (bytes.fromhex("08 0000 12"), 3),
    (bytes.fromhex("08 0001 0000"), 1),
    (bytes.fromhex("08 0002 0001"), 3),
    (bytes.fromhex("08 000B 0000 0000"), 3),
    (bytes.fromhex("08 0063 0000"), 1),
    (b"\x17\x00", 3),
    (b"\x17", 3),
    (b"\x03", 3),
    (b"\x10", 3),
    *((bytes([function, 0, 0, 0, 1]), 1) for function in (0, 7, 22, 24, 43, 99, 127, 128, 131, 255)),
]


@pytest.mark.parametrize("pdu", SOUND, ids=bytes.hex)
def test_sound_requests_pass(pdu: bytes) -> None:
    assert MAP.exception_for(request_of(pdu)) == 0


@pytest.mark.parametrize(
    ("pdu", "span"),
    [
        (write(0x800, [0] * 12), Span(0x800, 12)),
        (exchange((0, 40), 0x802, [0] * 6), Span(0x802, 6)),
        (bytes.fromhex("06 1121 BECF"), Span(0x1121, 1)),
        (bytes.fromhex("05 000F FF00"), Span(15, 1)),
        (bytes.fromhex("0F 0003 0005 01 FE"), Span(3, 5)),
    ],
    ids=lambda value: value.hex() if isinstance(value, bytes) else None,
)
def test_what_a_request_changes(pdu: bytes, span: Span) -> None:
    assert request_of(pdu).writes == span


@pytest.mark.parametrize(
    ("pdu", "code"), REFUSED, ids=lambda value: value.hex()[:24] if isinstance(value, bytes) else None
)
def test_unsound_requests_are_refused(pdu: bytes, code: int) -> None:
    assert MAP.exception_for(request_of(pdu)) == code
