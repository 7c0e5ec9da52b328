"""The link to the plant: one FC 23 exchange a cycle over Modbus TCP.

Never a retry: an answer that was lost does not mean that the write was, so the cycle counters in the
images decide. After a failed exchange the connection is dropped, for a late answer must not be taken for
the next one.
"""

import asyncio
import contextlib
import itertools
import time
from collections import Counter
from collections.abc import Sequence
from typing import cast

from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadWriteMultipleRegistersRequest,
    ReadWriteMultipleRegistersResponse,
    WriteSingleRegisterRequest,
)

from controller.config import PlantLinkConfig
from controller.core.plant_watch import PlantRefusal
from foundation import clock
from foundation.event_log import EventLog
from foundation.modbus import PlaceLost, StreamFramer, decoded
from foundation.periods import DurationHistogram
from protocol.coupler_registers import RESET_WORDS, WATCHDOG_RESET
from protocol.process_image import INPUT_ADDRESS, INPUT_WORDS, OUTPUT_ADDRESS


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
        self._expires_ns = 0
        self._alarm: clock.Cancellable | None = None
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
        self._expires_ns = clock.now_ns() + round(1e9 * within_s)
        if self._alarm is None:
            self._look_at_clock()
        request.dev_id, request.transaction_id = self._unit_id, self._transaction
        self._transport.write(self._framer.buildFrame(request))
        try:
            return await answer
        finally:
            self._answer = None

    def give_up(self) -> None:
        """Wait no longer: the plant leaves what it was asked unanswered."""
        self._fail(TimeoutError("the plant leaves it unanswered"))

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
        if clock.now_ns() < self._expires_ns:
            self._alarm = clock.current().call_at(self._expires_ns, self._look_at_clock)
        else:
            self._fail(TimeoutError("no answer in time"))

    def _fail(self, error: Exception) -> None:
        if self._answer is not None and not self._answer.done():
            self._answer.set_exception(error)


_WATCHDOG_EXPIRED = 4
_CONNECT_S = 5.0
_EXCHANGE = ReadWriteMultipleRegistersResponse.function_code


class PlantLink:
    """A connection that is kept up in the background.

    ``failures``: failed exchanges by cause; ``round_trip``: of the successful ones; ``connections``: made
    so far.
    """

    def __init__(self, config: PlantLinkConfig, log: EventLog) -> None:
        self.failures: Counter[str] = Counter()
        self.round_trip = DurationHistogram()
        self.connections = 0
        self._config = config
        self._timeout_s = config.timeout_ms * 1e-3
        self._log = log
        self._connection: PlantConnection | None = None
        self._connecting: asyncio.Task[None] | None = None
        self._closing = False

    def start(self) -> None:
        """Begin to connect; needs a running loop."""
        self._connecting = asyncio.ensure_future(self._connect())

    async def close(self) -> None:
        """Close the connection and stop connecting."""
        self._closing = True
        if self._connecting is not None:
            self._connecting.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._connecting
            self._connecting = None
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    async def connected(self) -> None:
        """Return once there is a connection, after _CONNECT_S without one."""
        if self._connecting is not None:
            await asyncio.wait([self._connecting], timeout=_CONNECT_S)

    def give_up(self) -> None:
        """Wait no longer for an answer."""
        if self._connection is not None:
            self._connection.give_up()

    async def exchange(self, valve_words: Sequence[int]) -> list[int] | PlantRefusal | None:
        """The plant's words after it took ``valve_words``; None or a refusal when not, and counted."""
        connection = self._connection
        if connection is None:
            self.failures["not_connected"] += 1
            return None
        began_ns = time.monotonic_ns()
        request = ReadWriteMultipleRegistersRequest(INPUT_ADDRESS, INPUT_WORDS, OUTPUT_ADDRESS, valve_words)
        try:
            answer = await connection.ask(request, self._timeout_s)
        except TimeoutError as error:
            self._drop("timeout", str(error))
            return None
        except OSError as error:
            self._drop("connection", str(error))
            return None
        if isinstance(answer, ExceptionResponse) and answer.function_code == _EXCHANGE | 0x80:
            # The coupler answered, so the connection is sound: 6 means that another master owns the outputs.
            code = answer.exception_code
            self._failed(f"exception_{code}", f"the coupler answered exception {code}")
            if code == _WATCHDOG_EXPIRED:
                await self._reset_coupler(connection)
            return PlantRefusal(code)
        if not isinstance(answer, ReadWriteMultipleRegistersResponse) or len(answer.registers) != INPUT_WORDS:
            came = f"{len(answer.registers)} of {answer.function_code}" if answer else "no sound answer"
            self._drop("wrong_answer", f"{came}: wanted {INPUT_WORDS} words of function code {_EXCHANGE}")
            return None
        self.round_trip.add(time.monotonic_ns() - began_ns)
        return list(answer.registers)

    async def _reset_coupler(self, connection: PlantConnection) -> None:
        # Moves nothing: the plant's motion watchdog and our own fault stay latched above the coupler's.
        try:
            for word in RESET_WORDS:
                request = WriteSingleRegisterRequest(address=WATCHDOG_RESET, registers=[word])
                await connection.ask(request, self._timeout_s)
        except OSError as error:  # a TimeoutError is one too
            self._drop("reset", str(error))
            return
        self._log.write("coupler_watchdog_reset", "warning", cause="plant_link.coupler_watchdog")

    def _failed(self, cause: str, detail: str) -> None:
        self.failures[cause] += 1
        fields = {"cause": f"plant_link.{cause}", "detail": detail, "count": self.failures[cause]}
        self._log.write_repeated(cause, "plant_exchange_failed", "warning", **fields)

    def _drop(self, cause: str, detail: str) -> None:
        self._failed(cause, detail)
        if self._connection is not None:
            self._connection.close()
            self._connection = None
        if self._connecting is None or self._connecting.done():
            self._connecting = asyncio.ensure_future(self._connect())

    async def _connect(self) -> None:
        where = f"{self._config.host}:{self._config.port}"
        for attempt in itertools.count():
            if self._closing:
                return
            with contextlib.suppress(OSError), clock.current().holding():
                self._connection = await self._connected()
                self.connections += 1
                self._log.write("plant_connected", address=where, connections=self.connections)
                return
            if attempt == 0:
                self._log.write("plant_unreachable", "warning", cause="plant_link.unreachable", address=where)
            pause_s = self._config.reconnect_ms * 1e-3
            await (clock.sleep(pause_s) if self.connections else asyncio.sleep(pause_s))

    async def _connected(self) -> PlantConnection:
        async with asyncio.timeout(self._timeout_s):
            _, connection = await asyncio.get_running_loop().create_connection(
                lambda: PlantConnection(self._config.unit_id), self._config.host, self._config.port
            )
        return connection
