"""Modbus TCP by pymodbus, as strict as either end of the fieldbus needs it: frames of a stream, and PDUs."""

import logging
import struct

from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU

MAX_PDU_BYTES = 253
WRITE_COILS = 15
_HEADER_BYTES = 7
_BEFORE_LENGTH = 6  # the length counts what follows it, the unit id first

# It tells of every frame that a stranger bends; what that does to an exchange, both ends count and report.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL)


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
        length = int.from_bytes(data[2:_BEFORE_LENGTH], "big")  # above it stands the protocol number, 0
        if len(data) >= _HEADER_BYTES and not 2 <= length <= MAX_PDU_BYTES + 1:
            raise PlaceLost(data[:_HEADER_BYTES])
        return super().decode(data[: _BEFORE_LENGTH + length])


def decoded(decoder: DecodePDU, data: bytes) -> ModbusPDU | None:
    """What a PDU says; None where pymodbus cannot decode it, or would send other bytes to say so.

    It takes trailing bytes, and counts that lie. Bits behind the last coil mean nothing, so they may differ.
    """
    pdu = decoder.decode(data)
    try:
        sent = b"" if pdu is None else encoded(pdu)
    except (ValueError, struct.error):  # a quantity or a value that it would not send
        return None
    compared = len(data) - (data[0] == WRITE_COILS)
    return pdu if len(sent) == len(data) and sent[:compared] == data[:compared] else None


def encoded(pdu: ModbusPDU) -> bytes:
    """The bytes of a PDU, the function code first. Raises ValueError for a quantity beyond its limits."""
    return pdu.function_code.to_bytes(1, "big") + pdu.encode()
