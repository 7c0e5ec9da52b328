"""The plant's fieldbus face: a bus coupler's process image over Modbus TCP. pymodbus lives in this file only.

The transport and the strict validation are our own; pymodbus decodes sound requests, runs them on the process
image and encodes the answers. Its own server is not used: it answers malformed requests wrongly, and slowly.
"""

import asyncio
import socket
import struct
from collections.abc import Callable, Sequence
from typing import Any, cast

from pymodbus.constants import ExcCodes
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU

from plant_emulator.core.coupler.image import COUPLER_MAP, CouplerImage
from plant_emulator.core.coupler.modbus_requests import (
    CLEAR_COUNTERS,
    COUNT_EXCEPTIONS,
    COUNT_FRAMING_ERRORS,
    DIAGNOSTICS,
    ECHO,
    ILLEGAL_VALUE,
    READ_COILS,
    READ_DISCRETE,
    READ_STATUS,
    WRITE_COIL,
    WRITE_COILS,
    WRITING,
    exception_for,
    written,
)
from plant_emulator.core.coupler.watchdog import CouplerWatchdog
from plant_emulator.shell.coupler_connection import CouplerConnection
from protocol.coupler_registers import IDENTIFICATION
from protocol.process_image import ValveImage

_BIT_FUNCTIONS = (READ_COILS, READ_DISCRETE, WRITE_COIL, WRITE_COILS)
_CENTRED = ValveImage(0, 0, (0.0,) * 6)


class CouplerStatistics:
    """Counts since the start: exchanges answered, exceptions returned, images refused, connections seen."""

    def __init__(self) -> None:
        self.requests = 0
        self.exceptions = 0
        self.torn_images = 0
        self.connections = 0
        self.framing_errors = 0
        self.watchdog_expiries = 0

    def as_dict(self) -> dict[str, int]:
        """The counts by name."""
        return dict(vars(self))


class Coupler:
    """Serves the newest sensor words and hands whole valve images on; one master at a time may write.

    ``sensor_words``: called for each read of the inputs, returns INPUT_WORDS words. ``on_valves``: called
    with each whole image that a master wrote, and with a centred one when the watchdog expires.
    ``release_ns``: a master that has not written for so long loses the outputs to whoever writes next.
    ``clock_ns``: a monotonic clock. ``silent``: while it returns True, requests are neither answered nor
    carried out, and connections stay open. ``report``: called as ``EventLog.write``, with what happens.
    """

    def __init__(
        self,
        sensor_words: Callable[[], Sequence[int]],
        on_valves: Callable[[ValveImage], None],
        release_ns: int,
        clock_ns: Callable[[], int],
        silent: Callable[[], bool] = lambda: False,
        report: Callable[..., None] = lambda *_event, **_fields: None,
    ) -> None:
        self.statistics = CouplerStatistics()
        self._on_valves = on_valves
        self._clock_ns = clock_ns
        self.silent = silent
        self._report = report
        self._watchdog = CouplerWatchdog(release_ns)
        self._image = CouplerImage(sensor_words, self._watchdog)
        self._decoder = DecodePDU(is_server=True)
        self._asking: object = None
        self._counted_from = dict(vars(self.statistics))
        self._connections: set[CouplerConnection] = set()
        self._server: asyncio.Server | None = None
        self._alarm: asyncio.TimerHandle | None = None

    async def start(self, bound: socket.socket) -> tuple[str, int]:
        """Listen on a bound socket; returns its address. Raises OSError when somebody listens there."""
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: CouplerConnection(self), sock=bound)
        host, port = bound.getsockname()
        return str(host), int(port)

    async def stop(self) -> None:
        """Close the listener and every connection."""
        if self._alarm is not None:
            self._alarm.cancel()
            self._alarm = None
        if self._server is not None:
            self._server.close()
        for connection in tuple(self._connections):
            connection.close()
        if self._server is not None:
            await self._server.wait_closed()

    def answer(self, master: object, unit: int, pdu: bytes) -> bytes:
        """The response PDU to a request PDU; ``master`` is any object that stands for its connection."""
        self.statistics.requests += 1
        now_ns = self._clock_ns()
        self._look_at_watchdog(now_ns)
        function = pdu[0]
        code = exception_for(pdu, COUPLER_MAP)
        if code == 0 and function == DIAGNOSTICS:
            self._watchdog.obeyed(master, False, now_ns)
            return self._diagnosed(pdu)
        writes = function in WRITING
        owns = code == 0 and _is_image(pdu, function, writes)
        if owns:
            code = self._watchdog.refusal(master, writes, now_ns)
        self._asking = master
        response = self._executed(pdu, unit) if code == 0 else _exception(function, code)
        if response.isError():
            self.statistics.exceptions += 1
        else:
            self._watchdog.obeyed(master, owns and writes, now_ns)
            if owns and writes and self._alarm is None:
                self._set_alarm(now_ns)
        return bytes([response.function_code]) + response.encode()

    async def async_getValues(
        self, device_id: int, func_code: int, address: int, count: int
    ) -> Sequence[int]:
        """Words or bits of the process image; called by pymodbus's requests, after validation."""
        if func_code in _BIT_FUNCTIONS:
            return self._image.bits(func_code, address, count)
        return self._image.words(address, count, self._clock_ns())

    async def async_setValues(
        self, device_id: int, func_code: int, address: int, values: Sequence[int]
    ) -> ExcCodes | None:
        """Write; called by pymodbus's requests, after validation. A whole image acts at once."""
        if func_code in _BIT_FUNCTIONS:
            self._image.write_bits(address, [bool(value) for value in values])
            return None
        if address >= IDENTIFICATION:
            code = self._configured(address, values)
        else:
            code, image, torn = self._image.write(address, values)
            self.statistics.torn_images += torn
            if image is not None:
                self._on_valves(image)
        return ExcCodes(code) if code else None

    def lost_its_place(self, header: bytes) -> None:
        """Count a frame header that made no sense; its connection ends."""
        self.statistics.framing_errors += 1
        if self.statistics.framing_errors.bit_count() == 1:  # 1, 2, 4, … : a flood fills no disk
            fields = {"cause": "coupler.framing", "detail": f"frame header {header.hex()} refused"}
            self._report("frame_refused", "warning", **fields, count=self.statistics.framing_errors)

    def connected(self, connection: CouplerConnection) -> None:
        """A master has connected."""
        self._connections.add(connection)
        self.statistics.connections += 1

    def disconnected(self, connection: CouplerConnection) -> None:
        """A master has gone; the outputs keep their words until a watchdog acts."""
        self._connections.discard(connection)
        self._watchdog.gone(connection)

    def _configured(self, address: int, values: Sequence[int]) -> int:
        now_ns = self._clock_ns()
        # Each of these registers is a block of its own, so exactly one word comes.
        code = self._watchdog.configure(self._asking, address, values[0], now_ns)
        # The pending alarm was set by the old time.
        if self._alarm is not None:
            self._alarm.cancel()
            self._set_alarm(now_ns)
        return code

    def _look_at_watchdog(self, now_ns: int) -> None:
        if not self._watchdog.look(now_ns):
            return
        why = f"nothing written for {self._watchdog.time_ms} ms, outputs at zero"
        self._report("watchdog_expired", "warning", cause="coupler.watchdog", detail=why)
        self.statistics.watchdog_expiries += 1
        self._image.clear_outputs()
        self._on_valves(_CENTRED)

    def _set_alarm(self, now_ns: int) -> None:
        # One timer that looks again when the watchdog would expire, instead of one for every telegram.
        self._alarm = None
        if self._server is None or not self._watchdog.armed:
            return
        delay_s = max(self._watchdog.expires_at_ns() - now_ns, 1_000_000) * 1e-9
        self._alarm = asyncio.get_running_loop().call_later(delay_s, self._alarmed)

    def _alarmed(self) -> None:
        now_ns = self._clock_ns()
        self._look_at_watchdog(now_ns)
        self._set_alarm(now_ns)

    def _diagnosed(self, pdu: bytes) -> bytes:
        sub_function = int.from_bytes(pdu[1:3], "big")
        if sub_function in (ECHO, CLEAR_COUNTERS):
            if sub_function == CLEAR_COUNTERS:
                self._counted_from = dict(vars(self.statistics))
            return pdu
        name = {COUNT_EXCEPTIONS: "exceptions", COUNT_FRAMING_ERRORS: "framing_errors"}.get(
            sub_function, "requests"
        )
        count = getattr(self.statistics, name) - self._counted_from[name]
        return pdu[:3] + struct.pack(
            ">H", self._image.status() if sub_function == READ_STATUS else count & 0xFFFF
        )

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


def _is_image(pdu: bytes, function: int, writes: bool) -> bool:
    """Whether a sound request concerns terminals and not the coupler's own registers."""
    if function in _BIT_FUNCTIONS:
        return True
    return (written(pdu).address if writes else int.from_bytes(pdu[1:3], "big")) < IDENTIFICATION


def _exception(function_code: int, code: int) -> ModbusPDU:
    return ExceptionResponse(function_code & 0x7F, code)
