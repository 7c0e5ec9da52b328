"""Which exception each malformed Modbus request deserves."""

import struct

import pytest

from plant_emulator.core.modbus_requests import RegisterMap, Span, exception_for, writes

MAP = RegisterMap(readable=(Span(0, 40), Span(0x800, 12)), writable=(Span(0x800, 12),))


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
    (b"\x17\x00", 3),
    (b"\x17", 3),
    (b"\x03", 3),
    (b"\x10", 3),
    *(
        (bytes([function, 0, 0, 0, 1]), 1)
        for function in (0, 1, 2, 5, 7, 8, 15, 22, 24, 43, 99, 127, 128, 131, 255)
    ),
]


@pytest.mark.parametrize("pdu", SOUND, ids=bytes.hex)
def test_sound_requests_pass(pdu: bytes) -> None:
    assert exception_for(pdu, MAP) == 0
    assert writes(pdu) == (pdu[0] in (6, 16, 23))


@pytest.mark.parametrize(
    ("pdu", "code"), REFUSED, ids=lambda value: value.hex()[:24] if isinstance(value, bytes) else None
)
def test_unsound_requests_are_refused(pdu: bytes, code: int) -> None:
    assert exception_for(pdu, MAP) == code
