"""Strict validation of Modbus requests: which exception a request deserves before anything acts on it.

Modbus application protocol V1.1b3, section 6.
"""

import struct
from typing import NamedTuple

ILLEGAL_FUNCTION = 1
ILLEGAL_ADDRESS = 2
ILLEGAL_VALUE = 3
WATCHDOG_EXPIRED = 4
OWNED_BY_ANOTHER = 6

READ_COILS = 1
READ_DISCRETE = 2
READ_HOLDING = 3
READ_INPUT = 4
WRITE_COIL = 5
WRITE_SINGLE = 6
DIAGNOSTICS = 8
WRITE_COILS = 15
WRITE_MULTIPLE = 16
READ_WRITE_MULTIPLE = 23
WRITING = frozenset((WRITE_COIL, WRITE_SINGLE, WRITE_COILS, WRITE_MULTIPLE, READ_WRITE_MULTIPLE))

MAX_READ = 125
MAX_WRITE = 123
MAX_WRITE_OF_23 = 121
MAX_READ_BITS = 2000
MAX_WRITE_BITS = 1968
FORM_BYTES = 10  # function, addresses, quantities and byte count of the longest head, that of 23
_COIL_WORDS = (0x0000, 0xFF00)

# Sub-functions of DIAGNOSTICS (section 6.8); all but the echo take one word that must be zero.
ECHO = 0
READ_STATUS = 2
CLEAR_COUNTERS = 10
COUNT_MESSAGES = 11
COUNT_FRAMING_ERRORS = 12
COUNT_EXCEPTIONS = 13
COUNT_ADDRESSED = 14
_SUB_FUNCTIONS = (
    READ_STATUS,
    CLEAR_COUNTERS,
    COUNT_MESSAGES,
    COUNT_FRAMING_ERRORS,
    COUNT_EXCEPTIONS,
    COUNT_ADDRESSED,
)


class Span(NamedTuple):
    """Registers or bits from ``address`` on."""

    address: int
    words: int


class RegisterMap(NamedTuple):
    """What each function code may reach; a request must lie within one span.

    ``reads`` holds the function codes 1 to 4 and 23, ``writes`` 5, 6, 15, 16 and 23.
    """

    reads: dict[int, tuple[Span, ...]]
    writes: dict[int, tuple[Span, ...]]


def exception_for(pdu: bytes, registers: RegisterMap) -> int:
    """The exception code that a request (function code first, not empty) deserves; 0 when it is sound.

    The order of the checks is the standard's: function, then quantities and lengths, then addresses. Only the
    first FORM_BYTES and the length decide.
    """
    function, body = pdu[0], pdu[1:]
    if function == READ_WRITE_MULTIPLE:
        if len(body) < 4:
            return ILLEGAL_VALUE
        also = _write(body[4:], MAX_WRITE_OF_23, registers.writes[function])
        return _read(body[:4], MAX_READ, registers.reads[function], also=also)
    if function in registers.reads:
        limit = MAX_READ_BITS if function in (READ_COILS, READ_DISCRETE) else MAX_READ
        return _read(body, limit, registers.reads[function])
    if function in (WRITE_SINGLE, WRITE_COIL):
        if len(body) != 4:
            return ILLEGAL_VALUE
        address, word = struct.unpack(">HH", body)
        if function == WRITE_COIL and word not in _COIL_WORDS:
            return ILLEGAL_VALUE
        return _within(Span(address, 1), registers.writes[function])
    if function == WRITE_MULTIPLE:
        return _write(body, MAX_WRITE, registers.writes[function])
    if function == WRITE_COILS:
        return _write_bits(body, registers.writes[function])
    return _diagnostics(body) if function == DIAGNOSTICS else ILLEGAL_FUNCTION


def written(pdu: bytes) -> Span:
    """The registers or bits that a sound writing request changes."""
    if pdu[0] in (WRITE_SINGLE, WRITE_COIL):
        return Span(int.from_bytes(pdu[1:3], "big"), 1)
    return Span(*struct.unpack_from(">HH", pdu, 5 if pdu[0] == READ_WRITE_MULTIPLE else 1))


def read(pdu: bytes) -> Span:
    """The registers or bits that a sound reading request asks for."""
    return Span(*struct.unpack_from(">HH", pdu, 1))


def _read(body: bytes, limit: int, allowed: tuple[Span, ...], also: int = 0) -> int:
    if len(body) != 4:
        return ILLEGAL_VALUE
    span = Span(*struct.unpack(">HH", body))
    if also == ILLEGAL_VALUE or not 1 <= span.words <= limit:
        return ILLEGAL_VALUE
    return also or _within(span, allowed)


def _write(body: bytes, limit: int, allowed: tuple[Span, ...]) -> int:
    if len(body) < 5:
        return ILLEGAL_VALUE
    address, count, byte_count = struct.unpack_from(">HHB", body)
    if not 1 <= count <= limit or byte_count != 2 * count or len(body) != 5 + byte_count:
        return ILLEGAL_VALUE
    return _within(Span(address, count), allowed)


def _write_bits(body: bytes, allowed: tuple[Span, ...]) -> int:
    if len(body) < 5:
        return ILLEGAL_VALUE
    address, count, byte_count = struct.unpack_from(">HHB", body)
    if not 1 <= count <= MAX_WRITE_BITS or byte_count != (count + 7) // 8 or len(body) != 5 + byte_count:
        return ILLEGAL_VALUE
    return _within(Span(address, count), allowed)


def _diagnostics(body: bytes) -> int:
    if len(body) < 2:
        return ILLEGAL_VALUE
    sub_function = int.from_bytes(body[:2], "big")
    if sub_function == ECHO:
        return 0 if len(body) >= 4 and len(body) % 2 == 0 else ILLEGAL_VALUE
    if sub_function not in _SUB_FUNCTIONS:
        return ILLEGAL_FUNCTION
    return 0 if body[2:] == b"\0\0" else ILLEGAL_VALUE


def _within(span: Span, allowed: tuple[Span, ...]) -> int:
    for whole in allowed:
        if whole.address <= span.address and span.address + span.words <= whole.address + whole.words:
            return 0
    return ILLEGAL_ADDRESS
