"""A small plant behind pymodbus's own server: six integrators in real time, and misbehaviour on the wire."""

import asyncio
import math
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from protocol.process_image import (
    CONTROL_ENABLE,
    OUTPUT_ADDRESS,
    STATUS_SUPPLY_ON,
    STATUS_VALVES_ENABLED,
    SensorImage,
    ValveImage,
    decode_valves,
    encode_sensors,
)
from tests.controller.obedient_plant import START_DEG, counts

_SPEEDS = (2.67, 2.12, 2.16, 8.2, 8.2, 8.2)
_DEADBAND = 0.005  # as the controller compensates


class PlantServer(ModbusTcpServer):
    """``written``: every valve image that arrived. The fields below it are the misbehaviour."""

    def __init__(self, port: int = 0) -> None:
        registers = SimData(0, count=1, datatype=DataType.REGISTERS)
        super().__init__(SimDevice(0, [registers]), address=("127.0.0.1", port))
        self.context = self  # requests read and write through the two methods below
        self.written: list[ValveImage] = []
        self.answer_delay_s = 0.0
        self.exception: ExcCodes | None = None
        self._q = [math.radians(angle) for angle in START_DEG]
        self._cycle = 0
        self._moved_at_s = time.monotonic()

    @property
    def port(self) -> int:
        return int(self.transport.sockets[0].getsockname()[1])  # type: ignore[union-attr]

    async def async_getValues(
        self, device_id: int, func_code: int, address: int, count: int = 1
    ) -> list[int]:
        delay_s, self.answer_delay_s = self.answer_delay_s, 0.0
        if delay_s:
            await asyncio.sleep(delay_s)
        return encode_sensors(self._image())[address : address + count]

    async def async_setValues(
        self, device_id: int, func_code: int, address: int, values: Sequence[int]
    ) -> ExcCodes | None:
        assert address == OUTPUT_ADDRESS
        if self.exception is not None:
            return self.exception
        self._move()
        self.written.append(decode_valves(values))
        return None

    def _enabled(self) -> bool:
        return bool(self.written and self.written[-1].control & CONTROL_ENABLE)

    def _move(self) -> None:
        now_s = time.monotonic()
        dt_s, self._moved_at_s = now_s - self._moved_at_s, now_s
        if self._enabled():
            openings = [math.copysign(max(abs(u) - _DEADBAND, 0.0), u) for u in self.written[-1].valves]
            self._q = [q + u * v * dt_s for q, u, v in zip(self._q, openings, _SPEEDS, strict=True)]

    def _image(self) -> SensorImage:
        self._cycle += 1
        status = STATUS_SUPPLY_ON | (STATUS_VALVES_ENABLED if self._enabled() else 0)
        echo = self.written[-1].controller_cycle if self.written else 0
        pressures = ((60.0, 60.0),) * 6
        return SensorImage(self._cycle, echo, status, counts(tuple(self._q)), pressures, 190.0, 10.0, 40.0)


@asynccontextmanager
async def plant_server(port: int = 0) -> AsyncIterator[PlantServer]:
    """A serving PlantServer."""
    server = PlantServer(port)
    await server.serve_forever(background=True)
    try:
        yield server
    finally:
        await server.shutdown()
