"""The plant's fieldbus face: a bus coupler's process image over Modbus TCP. pymodbus lives in this file only.

The transport and the strict validation are our own; pymodbus decodes sound requests, runs them on the process
image and encodes the answers. Its own server is not used: it answers malformed requests wrongly, and slowly.
"""

import asyncio
import logging
import socket
import struct
from collections.abc import Callable, Sequence
from typing import Any, cast

from pymodbus.constants import ExcCodes
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU

from plant_emulator.core.modbus_requests import (
    ILLEGAL_VALUE,
    MAX_PDU_BYTES,
    OWNED_BY_ANOTHER,
    RegisterMap,
    Span,
    exception_for,
    writes,
)
from protocol.errors import ImageRefused
from protocol.process_image import (
    INPUT_ADDRESS,
    INPUT_WORDS,
    OUTPUT_ADDRESS,
    OUTPUT_WORDS,
    ValveImage,
    decode_valves,
)

_MBAP = struct.Struct(">HHHB")
_MAP = RegisterMap(
    readable=(Span(INPUT_ADDRESS, INPUT_WORDS), Span(OUTPUT_ADDRESS, OUTPUT_WORDS)),
    writable=(Span(OUTPUT_ADDRESS, OUTPUT_WORDS),),
)
log = logging.getLogger(__name__)


class CouplerStatistics:
    """Counts since the start: exchanges answered, exceptions returned, images refused, connections seen."""

    def __init__(self) -> None:
        self.requests = 0
        self.exceptions = 0
        self.torn_images = 0
        self.connections = 0
        self.framing_errors = 0

    def as_dict(self) -> dict[str, int]:
        """The counts by name."""
        return dict(vars(self))


class Coupler:
    """Serves the newest sensor words and hands whole valve images on; one master at a time may write.

    ``sensor_words``: called for each read of the inputs, returns INPUT_WORDS words. ``on_valves``: called
    with each whole image that a master wrote. ``release_ns``: a master that has not written for so long
    loses the outputs to whoever writes next. ``clock_ns``: a monotonic clock.
    """

    def __init__(
        self,
        sensor_words: Callable[[], Sequence[int]],
        on_valves: Callable[[ValveImage], None],
        release_ns: int,
        clock_ns: Callable[[], int],
    ) -> None:
        self.statistics = CouplerStatistics()
        self._sensor_words = sensor_words
        self._on_valves = on_valves
        self._release_ns = release_ns
        self._clock_ns = clock_ns
        self._outputs = [0] * OUTPUT_WORDS
        self._decoder = DecodePDU(is_server=True)
        self._writer: object | None = None
        self._written_ns = 0
        self._connections: set[_Connection] = set()
        self._server: asyncio.Server | None = None

    async def start(self, bound: socket.socket) -> tuple[str, int]:
        """Listen on a bound socket; returns its address. Raises OSError when somebody listens there."""
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: _Connection(self), sock=bound)
        host, port = bound.getsockname()
        return str(host), int(port)

    async def stop(self) -> None:
        """Close the listener and every connection."""
        if self._server is not None:
            self._server.close()
        for connection in tuple(self._connections):
            connection.close()
        if self._server is not None:
            await self._server.wait_closed()

    def answer(self, master: object, unit: int, pdu: bytes) -> bytes:
        """The response PDU to a request PDU; ``master`` is any object that stands for its connection."""
        self.statistics.requests += 1
        code = exception_for(pdu, _MAP)
        if code == 0 and writes(pdu) and not self._may_write(master):
            code = OWNED_BY_ANOTHER
        response = self._executed(pdu, unit) if code == 0 else _exception(pdu[0], code)
        self.statistics.exceptions += response.isError()
        return bytes([response.function_code]) + response.encode()

    async def async_getValues(self, device_id: int, func_code: int, address: int, count: int) -> list[int]:
        """Words of the process image; called by pymodbus's requests, after validation."""
        if address >= OUTPUT_ADDRESS:
            return self._outputs[address - OUTPUT_ADDRESS :][:count]
        return list(self._sensor_words()[address - INPUT_ADDRESS :][:count])

    async def async_setValues(
        self, device_id: int, func_code: int, address: int, values: Sequence[int]
    ) -> ExcCodes | None:
        """Write outputs; called by pymodbus's requests, after validation. A whole image acts at once."""
        outputs = list(self._outputs)
        start = address - OUTPUT_ADDRESS
        outputs[start : start + len(values)] = values
        try:
            image = decode_valves(outputs)
        except ImageRefused as refusal:
            if refusal.cause != "image.torn":
                return ExcCodes(ILLEGAL_VALUE)
            self._outputs = outputs
            self.statistics.torn_images += 1
            return None
        self._outputs = outputs
        self._on_valves(image)
        return None

    def connected(self, connection: "_Connection") -> None:
        """A master has connected."""
        self._connections.add(connection)
        self.statistics.connections += 1

    def disconnected(self, connection: "_Connection") -> None:
        """A master has gone; the outputs keep their words until the plant's watchdog acts."""
        self._connections.discard(connection)
        if self._writer is connection:
            self._writer = None

    def _may_write(self, master: object) -> bool:
        now = self._clock_ns()
        owned = self._writer is not None and now - self._written_ns < self._release_ns
        if owned and self._writer is not master:
            return False
        self._writer, self._written_ns = master, now
        return True

    def _executed(self, pdu: bytes, unit: int) -> ModbusPDU:
        request = self._decoder.decode(pdu)
        if request is None:
            return _exception(pdu[0], ILLEGAL_VALUE)
        # The process image never waits, so the coroutine ends at its first step: no task, no detour.
        execution = request.datastore_update(cast(Any, self), unit)
        try:
            execution.send(None)
        except StopIteration as finished:
            return cast(ModbusPDU, finished.value)
        raise RuntimeError("a Modbus request waited inside the process image")


class _Connection(asyncio.Protocol):
    """One master's TCP connection: frames in, frames out, order kept."""

    def __init__(self, coupler: Coupler) -> None:
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
                log.warning("coupler: frame header %s refused, connection closed", self._buffer[:7].hex())
                self._coupler.statistics.framing_errors += 1
                self._buffer.clear()
                self._close_after(answers)
                return
            end = _MBAP.size - 1 + length
            if len(self._buffer) < end:
                break
            pdu = bytes(self._buffer[_MBAP.size : end])
            del self._buffer[:end]
            response = self._coupler.answer(self, unit, pdu)
            answers += _MBAP.pack(transaction, 0, len(response) + 1, unit) + response
        if answers and self._transport is not None:
            self._transport.write(bytes(answers))

    def _close_after(self, answers: bytearray) -> None:
        if self._transport is not None:
            if answers:
                self._transport.write(bytes(answers))
            self._transport.close()


def _exception(function_code: int, code: int) -> ModbusPDU:
    return ExceptionResponse(function_code & 0x7F, code)
