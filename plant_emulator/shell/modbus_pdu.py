"""Modbus PDUs as pymodbus reads and writes them: what a request asks, what its answer is."""

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

MAX_WRITE_BITS = 1968  # pymodbus takes 2000, as for reading; of words a frame holds no more than 123
_HEAD_BYTES = 6  # of a write: function code, address, quantity or value, byte count
_SERVED = {*COUPLER_MAP.reads, *COUPLER_MAP.writes, modbus.DIAGNOSTICS}
_DECODER = DecodePDU(is_server=True)


def request_of(data: bytes) -> Request:
    """What a request PDU (not empty) asks; its ``code`` where function, quantities or lengths are refused."""
    function = data[0]
    sub_function = int.from_bytes(data[1:3], "big") if function == modbus.DIAGNOSTICS and data[2:] else 0
    if function not in _SERVED or sub_function not in modbus.SUB_FUNCTIONS:
        return Request(function, modbus.ILLEGAL_FUNCTION)
    decoded_pdu = decoded(_DECODER, data)
    if isinstance(decoded_pdu, ReadWriteMultipleRegistersRequest):
        if decoded_pdu.write_byte_count == 2 * decoded_pdu.write_count <= 2 * decoded_pdu.MAX_WRITE_COUNT:
            reads = Span(decoded_pdu.read_address, decoded_pdu.read_count)
            writes = Span(decoded_pdu.write_address, decoded_pdu.write_count)
            return Request(function, 0, reads, writes, decoded_pdu.write_registers)
    elif isinstance(decoded_pdu, DiagnosticBase):
        if encoded(decoded_pdu) == data and (words := _data_of(decoded_pdu)):
            return Request(function, values=(sub_function, *words))
    elif decoded_pdu is not None and function in COUPLER_MAP.reads:
        return Request(function, 0, Span(decoded_pdu.address, decoded_pdu.count))
    elif decoded_pdu is not None:
        values = decoded_pdu.bits or decoded_pdu.registers
        counted = 1 <= len(values) <= MAX_WRITE_BITS and decoded_pdu.count in (0, len(values))
        if counted and encoded(decoded_pdu)[:_HEAD_BYTES] == data[:_HEAD_BYTES]:
            return Request(function, 0, None, Span(decoded_pdu.address, len(values)), values)
    return Request(function, modbus.ILLEGAL_VALUE)


def answer_to(request: Request, code: int, read: Sequence[int]) -> bytes:
    """The response PDU: the exception ``code``, or with 0 what was read or that all was written."""
    if code:
        return encoded(ExceptionResponse(request.function, code))
    if request.function == modbus.DIAGNOSTICS:
        answer = DiagnosticBase(list(read))
        answer.sub_function_code = request.values[0]
        return encoded(answer)
    address, count = request.writes or (0, 0)
    words = read or request.values
    bits = cast(Sequence[bool], words)  # the same, of the function codes that have them
    kind = DecodePDU.pdu_table[request.function][1]
    return encoded(kind(address=address, count=count, bits=bits, registers=words))


def _data_of(decoded_pdu: DiagnosticBase) -> tuple[int, ...]:
    data = decoded_pdu.message
    if isinstance(data, bytes) and len(data) % 2 == 0:  # the echo
        return struct.unpack(f">{len(data) // 2}H", data)
    return (0,) if data == 0 else ()
