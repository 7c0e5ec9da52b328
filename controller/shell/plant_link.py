"""The link to the plant: one FC 23 exchange a cycle over Modbus TCP. pymodbus lives in this file only.

Never a retry: an answer that was lost does not mean that the write was, so the cycle counters in the
images decide. After a failed exchange the connection is dropped, for a late answer must not be taken for
the next one.
"""

import asyncio
import contextlib
import itertools
import logging
import time
from collections import Counter
from collections.abc import Sequence

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException

from controller.config import PlantLinkConfig
from controller.core.plant_watch import PlantRefusal
from foundation.durations import DurationHistogram
from foundation.event_log import EventLog
from protocol.coupler_registers import RESET_WORDS, WATCHDOG_RESET
from protocol.process_image import INPUT_ADDRESS, INPUT_WORDS, OUTPUT_ADDRESS

_EXCHANGE = 23
_WATCHDOG_EXPIRED = 4
# pymodbus logs every failure once more, in lines of its own; they are counted and logged here.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL + 1)


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
        self._log = log
        self._client: AsyncModbusTcpClient | None = None
        self._connecting: asyncio.Task[None] | None = None
        self._closing = False

    def start(self) -> None:
        """Begin to connect; needs a running loop."""
        self._connecting = asyncio.ensure_future(self._connect())

    async def close(self) -> None:
        """Close the connection and stop connecting."""
        self._closing = True  # pymodbus's connect() may swallow the cancellation
        if self._connecting is not None:
            self._connecting.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._connecting
            self._connecting = None
        if self._client is not None:
            self._client.close()
            self._client = None

    async def exchange(self, valve_words: Sequence[int]) -> list[int] | PlantRefusal | None:
        """The plant's words after it took ``valve_words``; None or a refusal when not, and counted."""
        client = self._client
        if client is None:
            self.failures["not_connected"] += 1
            return None
        began_ns = time.monotonic_ns()
        try:
            response = await client.readwrite_registers(
                read_address=INPUT_ADDRESS,
                read_count=INPUT_WORDS,
                write_address=OUTPUT_ADDRESS,
                values=list(valve_words),
                device_id=self._config.unit_id,
            )
        except (ModbusException, OSError) as error:
            late = time.monotonic_ns() - began_ns >= 1e6 * self._config.timeout_ms
            self._dropped("timeout" if late else "connection", str(error))
            return None
        if response.transaction_id == 0 or response.function_code & 0x7F != _EXCHANGE:
            # pymodbus numbers its requests from 1 on, but takes an answer numbered 0, or to another function
            # code, for the one it waits for.
            whose = f"number {response.transaction_id}, function code {response.function_code}"
            self._dropped("foreign_answer", f"{whose}: no answer to the exchange")
            return None
        if response.isError():
            # The coupler answered, so the connection is sound: 6 means that another master owns the outputs.
            self._failed(f"exception_{response.exception_code}", str(response))
            if response.exception_code == _WATCHDOG_EXPIRED:
                await self._reset_coupler(client)
            return PlantRefusal(response.exception_code)
        if len(response.registers) != INPUT_WORDS:
            self._dropped("wrong_length", f"{len(response.registers)} words, wanted {INPUT_WORDS}")
            return None
        self.round_trip.add(time.monotonic_ns() - began_ns)
        return list(response.registers)

    async def _reset_coupler(self, client: AsyncModbusTcpClient) -> None:
        # Moves nothing: the plant's motion watchdog and our own fault stay latched above the coupler's.
        try:
            for word in RESET_WORDS:
                await client.write_register(WATCHDOG_RESET, word, device_id=self._config.unit_id)
        except (ModbusException, OSError) as error:
            self._dropped("reset", str(error))
            return
        self._log.write("coupler_watchdog_reset", "warning", cause="plant_link.coupler_watchdog")

    def _failed(self, cause: str, detail: str) -> None:
        self.failures[cause] += 1
        fields = {"cause": f"plant_link.{cause}", "detail": detail, "count": self.failures[cause]}
        self._log.write_repeated(cause, "plant_exchange_failed", "warning", **fields)

    def _dropped(self, cause: str, detail: str) -> None:
        self._failed(cause, detail)
        if self._client is not None:
            self._client.close()
            self._client = None
        if self._connecting is None or self._connecting.done():
            self._connecting = asyncio.ensure_future(self._connect())

    async def _connect(self) -> None:
        where = f"{self._config.host}:{self._config.port}"
        for attempt in itertools.count():
            if self._closing:
                return
            client = AsyncModbusTcpClient(
                self._config.host,
                port=self._config.port,
                timeout=self._config.timeout_ms * 1e-3,
                retries=0,
                reconnect_delay=0,
            )
            try:
                connected = await client.connect()
            except BaseException:
                client.close()
                raise
            if connected:
                self._client = client
                self.connections += 1
                self._log.write("plant_connected", address=where, connections=self.connections)
                return
            client.close()
            if attempt == 0:
                self._log.write("plant_unreachable", "warning", cause="plant_link.unreachable", address=where)
            await asyncio.sleep(self._config.reconnect_ms * 1e-3)
