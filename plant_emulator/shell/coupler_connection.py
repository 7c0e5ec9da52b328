"""One master's TCP connection to the coupler: Modbus TCP frames in, frames out, order kept."""

import asyncio
import struct
from typing import Protocol, cast

from plant_emulator.core.coupler.modbus_requests import MAX_PDU_BYTES

_MBAP = struct.Struct(">HHHB")


class Answers(Protocol):
    """The coupler as its connections see it."""

    def silent(self) -> bool:
        """Whether requests are to be swallowed at present."""
        ...

    def answer(self, master: object, unit: int, pdu: bytes) -> bytes:
        """The response PDU to a request PDU."""
        ...

    def lost_its_place(self, header: bytes) -> None:
        """Count a frame header that made no sense."""
        ...

    def connected(self, connection: "CouplerConnection") -> None:
        """A master has connected."""
        ...

    def disconnected(self, connection: "CouplerConnection") -> None:
        """A master has gone."""
        ...


class CouplerConnection(asyncio.Protocol):
    """Cuts the stream into requests and sends their answers; a silent coupler swallows whole requests."""

    def __init__(self, coupler: Answers) -> None:
        self._coupler = coupler
        self._buffer = bytearray()
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._coupler.connected(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._coupler.disconnected(self)

    def close(self) -> None:
        """Close the connection at once."""
        if self._transport is not None:
            self._transport.abort()

    def data_received(self, data: bytes) -> None:
        self._buffer += data
        answers = bytearray()
        while len(self._buffer) >= _MBAP.size:
            transaction, protocol, length, unit = _MBAP.unpack_from(self._buffer)
            if protocol != 0 or not 2 <= length <= MAX_PDU_BYTES + 1:
                # The place in the stream is lost and cannot be found again.
                self._coupler.lost_its_place(bytes(self._buffer[: _MBAP.size]))
                self._buffer.clear()
                self._close_after(answers)
                return
            end = _MBAP.size - 1 + length
            if len(self._buffer) < end:
                break
            pdu = bytes(self._buffer[_MBAP.size : end])
            del self._buffer[:end]
            if self._coupler.silent():
                continue
            response = self._coupler.answer(self, unit, pdu)
            answers += _MBAP.pack(transaction, 0, len(response) + 1, unit) + response
        if answers and self._transport is not None:
            self._transport.write(bytes(answers))

    def _close_after(self, answers: bytearray) -> None:
        if self._transport is not None:
            if answers:
                self._transport.write(bytes(answers))
            self._transport.close()
