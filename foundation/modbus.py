"""Modbus TCP by pymodbus, as strict as either end of the fieldbus needs it: frames of a stream, and PDUs."""

import struct

from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.diag_message import DiagnosticBase

MAX_PDU_BYTES = 253
_LENGTH_ENDS = 6  # and counts what follows it, the unit id first


class PlaceLost(Exception):
    """A frame header makes no sense, so the place in the stream is lost."""

    def __init__(self, header: bytes) -> None:
        super().__init__(f"frame header {header.hex()} refused")


class StreamFramer(FramerSocket):
    """pymodbus' framer for streams: it waits for ever behind a bad header, and may cut a byte too much."""

    def decode(self, data: bytes) -> tuple[int, int, int, bytes]:
        """Bytes used, unit id, transaction number and PDU of the first frame; 0 used: not whole yet.

        Raises PlaceLost.
        """
        length = int.from_bytes(data[2:_LENGTH_ENDS], "big")  # above it stands the protocol number, 0
        if len(data) >= _LENGTH_ENDS and not 2 <= length <= MAX_PDU_BYTES + 1:
            raise PlaceLost(data[:_LENGTH_ENDS])
        return super().decode(data[: _LENGTH_ENDS + length])


def decoded(decoder: DecodePDU, data: bytes) -> ModbusPDU | None:
    """What a PDU says; None where pymodbus cannot decode it, or where its length is not what it says.

    Not by ``decoder.decode``, which takes trailing bytes, writes a line for each PDU that it refuses, and
    renders each other one as text.
    """
    framed = b"\0" + data  # behind a unit id, as on a serial line, where a sum of two bytes follows
    try:
        kind = decoder.lookupPduClass(framed)
        if kind is None:
            return None
        if kind.calculateRtuFrameSize(framed) != len(framed) + 2 and not issubclass(kind, DiagnosticBase):
            return None  # an echo may have any length
        pdu = ExceptionResponse(data[0]) if kind is ExceptionResponse else kind()
        pdu.decode(data[1:])
    except (ModbusException, ValueError, LookupError, struct.error):
        return None
    return pdu


def encoded(pdu: ModbusPDU) -> bytes:
    """The bytes of a PDU, the function code first."""
    return pdu.function_code.to_bytes(1, "big") + pdu.encode()
