"""Requests to the coupler and its answers, between pymodbus' PDUs and what the core is asked."""

import struct
from collections.abc import Sequence
from typing import cast

from pymodbus.pdu import DecodePDU, ExceptionResponse
from pymodbus.pdu.diag_message import DiagnosticBase
from pymodbus.pdu.register_message import ReadWriteMultipleRegistersRequest

from foundation.modbus import decoded, encoded
from plant_emulator.core.coupler import modbus_requests as modbus
from plant_emulator.core.coupler.image import COUPLER_MAP
from plant_emulator.core.coupler.modbus_requests import Request, Span

# Of function codes 15 and 16: pymodbus takes 2000 bits, as for reading, and any number of words.
MAX_WRITE_BITS, MAX_WRITE = 1968, 123
_SERVED = {*COUPLER_MAP.reads, *COUPLER_MAP.writes, modbus.DIAGNOSTICS}
_REQUESTS, _RESPONSES = DecodePDU(is_server=True), DecodePDU(is_server=False)


def request_of(data: bytes) -> Request:
    """What a request PDU (not empty) asks; its ``code`` where function, quantities or lengths are refused."""
    function = data[0]
    sub_function = int.from_bytes(data[1:3], "big") if function == modbus.DIAGNOSTICS and data[2:] else 0
    if function not in _SERVED or sub_function not in modbus.SUB_FUNCTIONS:
        return Request(function, modbus.ILLEGAL_FUNCTION)
    asked = decoded(_REQUESTS, data)
    if isinstance(asked, ReadWriteMultipleRegistersRequest):
        reads, writes = (
            Span(asked.read_address, asked.read_count),
            Span(asked.write_address, asked.write_count),
        )
        return Request(function, 0, reads, writes, asked.write_registers)
    if isinstance(asked, DiagnosticBase):
        return _diagnostics(asked)
    if asked is not None and function in COUPLER_MAP.reads:
        return Request(function, 0, Span(asked.address, asked.count))
    values = [] if asked is None else asked.bits or asked.registers
    if asked is None or not 1 <= len(values) <= (MAX_WRITE_BITS if asked.bits else MAX_WRITE):
        return Request(function, modbus.ILLEGAL_VALUE)
    return Request(function, 0, None, Span(asked.address, len(values)), values)


def answer_to(request: Request, code: int, read: Sequence[int]) -> bytes:
    """The response PDU: the exception ``code``, or with 0 what was read or that all was written."""
    if code:
        return encoded(ExceptionResponse(request.function, code))
    sub_function = request.values[0] if request.function == modbus.DIAGNOSTICS else 0
    kind = _RESPONSES.lookupPduClass(bytes((0, request.function, 0, sub_function)))
    assert kind is not None
    if issubclass(kind, DiagnosticBase):
        return encoded(kind(list(read)))
    address, count = request.writes or (0, 0)
    words = read or request.values
    bits = cast(Sequence[bool], words)  # the same, of the function codes that have them
    return encoded(kind(address=address, count=count, bits=bits, registers=words))


def _diagnostics(asked: DiagnosticBase) -> Request:
    data = asked.message
    if isinstance(data, bytes) and data and len(data) % 2 == 0:  # the echo
        words = struct.unpack(f">{len(data) // 2}H", data)
    elif data == 0:
        words = (0,)
    else:
        return Request(modbus.DIAGNOSTICS, modbus.ILLEGAL_VALUE)
    return Request(modbus.DIAGNOSTICS, values=(asked.sub_function_code, *words))
