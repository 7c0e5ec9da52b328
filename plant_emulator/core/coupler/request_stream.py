"""One master's bytes cut into Modbus TCP requests, and answers put into frames."""

import struct
from typing import NamedTuple

from plant_emulator.core.coupler.modbus_requests import MAX_PDU_BYTES

_MBAP = struct.Struct(">HHHB")
_BEFORE_LENGTH = 6  # the length counts what follows it, the unit id first


class Request(NamedTuple):
    """A whole request: its transaction number, the unit id it names, and the PDU."""

    transaction: int
    unit: int
    pdu: bytes


class PlaceLost(Exception):
    """A frame header makes no sense, so the place in the stream is lost. ``header``: its seven bytes."""

    def __init__(self, header: bytes) -> None:
        super().__init__(f"frame header {header.hex()} refused")


class RequestStream:
    """Holds what has come and is not yet a whole request, or not yet taken."""

    def __init__(self) -> None:
        self._data = b""
        self._at = 0

    def __len__(self) -> int:
        """Bytes held."""
        return len(self._data) - self._at

    def add(self, data: bytes) -> None:
        """Append what the socket gave."""
        self._data = self._data[self._at :] + data
        self._at = 0

    def next(self) -> Request | None:
        """The oldest whole request, which is taken; None when none is whole. Raises PlaceLost."""
        data, at = self._data, self._at
        if len(data) - at < _MBAP.size:
            return None
        transaction, protocol, length, unit = _MBAP.unpack_from(data, at)
        if protocol != 0 or not 2 <= length <= MAX_PDU_BYTES + 1:
            raise PlaceLost(data[at : at + _MBAP.size])
        end = at + _BEFORE_LENGTH + length
        if len(data) < end:
            return None
        self._at = end
        return Request(transaction, unit, data[at + _MBAP.size : end])


def framed(request: Request, response: bytes) -> bytes:
    """The frame that carries the response PDU to ``request``."""
    return _MBAP.pack(request.transaction, 0, len(response) + 1, request.unit) + response
