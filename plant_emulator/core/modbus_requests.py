"""Strict validation of Modbus requests: which exception a request deserves before anything acts on it.

pymodbus checks some of this, answers some of it under a wrong function code and lets some of it pass, so
every request is judged here first. Modbus application protocol V1.1b3, section 6.
"""

import struct
from typing import NamedTuple

ILLEGAL_FUNCTION = 1
ILLEGAL_ADDRESS = 2
ILLEGAL_VALUE = 3
OWNED_BY_ANOTHER = 6

READ_HOLDING = 3
READ_INPUT = 4
WRITE_SINGLE = 6
WRITE_MULTIPLE = 16
READ_WRITE_MULTIPLE = 23

MAX_READ = 125
MAX_WRITE = 123
MAX_WRITE_OF_23 = 121
MAX_PDU_BYTES = 253


class Span(NamedTuple):
    """Registers from ``address`` on."""

    address: int
    words: int


class RegisterMap(NamedTuple):
    """Which spans may be read and which written; a request must lie within one of them."""

    readable: tuple[Span, ...]
    writable: tuple[Span, ...]


def exception_for(pdu: bytes, registers: RegisterMap) -> int:
    """The exception code that a request (function code first, not empty) deserves; 0 when it is sound.

    The order of the checks is the standard's: function, then quantities and lengths, then addresses.
    """
    function, body = pdu[0], pdu[1:]
    if function in (READ_HOLDING, READ_INPUT):
        return _read(body, registers)
    if function == WRITE_SINGLE:
        if len(body) != 4:
            return ILLEGAL_VALUE
        return _within(Span(struct.unpack_from(">H", body)[0], 1), registers.writable)
    if function == WRITE_MULTIPLE:
        return _write(body, MAX_WRITE, registers)
    if function == READ_WRITE_MULTIPLE:
        if len(body) < 4:
            return ILLEGAL_VALUE
        return _read(body[:4], registers, also=_write(body[4:], MAX_WRITE_OF_23, registers))
    return ILLEGAL_FUNCTION


def writes(pdu: bytes) -> bool:
    """Whether a sound request changes outputs."""
    return pdu[0] in (WRITE_SINGLE, WRITE_MULTIPLE, READ_WRITE_MULTIPLE)


def _read(body: bytes, registers: RegisterMap, also: int = 0) -> int:
    if len(body) != 4:
        return ILLEGAL_VALUE
    span = Span(*struct.unpack(">HH", body))
    if also == ILLEGAL_VALUE or not 1 <= span.words <= MAX_READ:
        return ILLEGAL_VALUE
    return also or _within(span, registers.readable)


def _write(body: bytes, limit: int, registers: RegisterMap) -> int:
    if len(body) < 5:
        return ILLEGAL_VALUE
    address, count, byte_count = struct.unpack_from(">HHB", body)
    if not 1 <= count <= limit or byte_count != 2 * count or len(body) != 5 + byte_count:
        return ILLEGAL_VALUE
    return _within(Span(address, count), registers.writable)


def _within(span: Span, allowed: tuple[Span, ...]) -> int:
    for whole in allowed:
        if whole.address <= span.address and span.address + span.words <= whole.address + whole.words:
            return 0
    return ILLEGAL_ADDRESS
