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

from pymodbus.pdu import ExceptionResponse
from pymodbus.pdu.register_message import (
    ReadWriteMultipleRegistersRequest,
    ReadWriteMultipleRegistersResponse,
    WriteSingleRegisterRequest,
)

from controller.config import PlantLinkConfig
from controller.core.plant_watch import PlantRefusal
from controller.shell.plant_connection import PlantConnection
from foundation.event_log import EventLog
from foundation.periods import DurationHistogram
from protocol.coupler_registers import RESET_WORDS, WATCHDOG_RESET
from protocol.process_image import INPUT_ADDRESS, INPUT_WORDS, OUTPUT_ADDRESS

_WATCHDOG_EXPIRED = 4
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
            self._dropped("timeout", str(error))
            return None
        except OSError as error:
            self._dropped("connection", str(error))
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
            self._dropped("wrong_answer", f"{came}: wanted {INPUT_WORDS} words of function code {_EXCHANGE}")
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
            self._dropped("reset", str(error))
            return
        self._log.write("coupler_watchdog_reset", "warning", cause="plant_link.coupler_watchdog")

    def _failed(self, cause: str, detail: str) -> None:
        self.failures[cause] += 1
        fields = {"cause": f"plant_link.{cause}", "detail": detail, "count": self.failures[cause]}
        self._log.write_repeated(cause, "plant_exchange_failed", "warning", **fields)

    def _dropped(self, cause: str, detail: str) -> None:
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
            with contextlib.suppress(OSError):
                self._connection = await self._connected()
                self.connections += 1
                self._log.write("plant_connected", address=where, connections=self.connections)
                return
            if attempt == 0:
                self._log.write("plant_unreachable", "warning", cause="plant_link.unreachable", address=where)
            await asyncio.sleep(self._config.reconnect_ms * 1e-3)

    async def _connected(self) -> PlantConnection:
        async with asyncio.timeout(self._timeout_s):
            _, connection = await asyncio.get_running_loop().create_connection(
                lambda: PlantConnection(self._config.unit_id), self._config.host, self._config.port
            )
        return connection
