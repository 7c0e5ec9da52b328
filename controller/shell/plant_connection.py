"""One Modbus TCP connection to the plant: one request under way, its answer or nothing."""

import asyncio
import time
from typing import cast

from pymodbus.pdu import DecodePDU, ModbusPDU

from foundation.modbus import PlaceLost, StreamFramer, decoded


class PlantConnection(asyncio.Protocol):
    """Sends a request and waits for the frame that repeats its transaction number; any other is left.

    So a late or repeated answer is never taken for that to the next request.
    """

    def __init__(self, unit_id: int) -> None:
        self._unit_id = unit_id
        self._transaction = 0
        self._framer = StreamFramer(DecodePDU(is_server=False))
        self._held = b""
        self._transport: asyncio.Transport | None = None
        self._answer: asyncio.Future[ModbusPDU | None] | None = None
        self._expires_s = 0.0
        self._alarm: asyncio.TimerHandle | None = None
        self._loop = asyncio.get_running_loop()

    async def ask(self, request: ModbusPDU, within_s: float) -> ModbusPDU | None:
        """The answer, None if it is none that pymodbus would send; ``request`` gets its number here.

        Raises TimeoutError, or ConnectionError when the connection has ended.
        """
        if self._transport is None or self._transport.is_closing():
            raise ConnectionError("the plant has closed the connection")
        self._transaction = (self._transaction + 1) & 0xFFFF
        answer: asyncio.Future[ModbusPDU | None] = self._loop.create_future()
        self._answer = answer
        self._expires_s = time.monotonic() + within_s
        if self._alarm is None:
            self._look_at_clock()
        request.dev_id, request.transaction_id = self._unit_id, self._transaction
        self._transport.write(self._framer.buildFrame(request))
        try:
            return await answer
        finally:
            self._answer = None

    def close(self) -> None:
        """Close the connection at once."""
        if self._transport is not None:
            self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The plant has accepted."""
        self._transport = cast(asyncio.Transport, transport)  # uvloop's is of no class of asyncio's

    def data_received(self, data: bytes) -> None:
        """Some bytes of an answer, or of several."""
        self._held += data
        try:
            while (frame := self._framer.decode(self._held))[0]:
                used, unit, transaction, pdu = frame
                self._held = self._held[used:]
                waits = self._answer is not None and not self._answer.done()
                if waits and (transaction, unit) == (self._transaction, self._unit_id):
                    assert self._answer is not None
                    self._answer.set_result(decoded(self._framer.decoder, pdu))
        except PlaceLost as lost:
            self._fail(ConnectionError(str(lost)))
            self.close()

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection has ended."""
        self._transport = None
        if self._alarm is not None:
            self._alarm.cancel()
        self._fail(ConnectionError(str(exc or "the plant has closed the connection")))

    def _look_at_clock(self) -> None:
        # One timer that looks again when the answer would be late, instead of one for every request.
        self._alarm = None
        if self._answer is None or self._answer.done():
            return
        left_s = self._expires_s - time.monotonic()
        if left_s > 0.0:
            self._alarm = self._loop.call_later(left_s, self._look_at_clock)
        else:
            self._fail(TimeoutError("no answer in time"))

    def _fail(self, error: Exception) -> None:
        if self._answer is not None and not self._answer.done():
            self._answer.set_exception(error)
