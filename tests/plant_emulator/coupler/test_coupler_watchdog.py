"""The coupler's watchdog and ownership with a clock to turn; its registers, bits and diagnostics in full."""

import asyncio
import io
import socket
import struct

import pytest

from controller.config import PlantLinkConfig
from controller.core.plant_watch import PlantRefusal
from controller.shell.plant_link import PlantLink
from foundation.event_log import EventLog
from plant_emulator.shell.coupler import Coupler
from protocol.process_image import CONTROL_ENABLE, SensorImage, ValveImage, encode_sensors, encode_valves

pytestmark = pytest.mark.realtime

MS = 1_000_000
SENSORS = encode_sensors(SensorImage(7, 9, 0b0101, (1, 2, 3, 4, 5, 6), ((1.0, 2.0),) * 6, 190.0, 10.0, 40.0))
IMAGE = ValveImage(3, CONTROL_ENABLE, (0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
WRITE = struct.pack(">BHHB12H", 16, 0x800, 12, 24, *encode_valves(IMAGE))


async def test_outputs_go_to_zero_without_any_telegram_and_sooner_after_a_shorter_time() -> None:
    written: list[ValveImage] = []
    loop = asyncio.get_running_loop()
    coupler = Coupler(lambda: SENSORS, written.append, MS, lambda: round(loop.time() * 1e9))
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        await coupler.start(bound)
        coupler.answer("a", 1, WRITE)  # sets an alarm in 1000 ms
        for request in ("06 1121 BECF", "06 1121 AFFE", "06 1120 0032"):
            coupler.answer("a", 1, bytes.fromhex(request))
        coupler.answer("a", 1, WRITE)
        async with asyncio.timeout(0.7):
            while coupler.statistics.watchdog_expiries == 0:  # noqa: ASYNC110 - no event tells of it
                await asyncio.sleep(0.01)
        assert written[-1] == ValveImage(0, 0, (0.0,) * 6)
        await coupler.stop()


async def test_the_controller_finds_its_way_back_after_an_expiry() -> None:
    written: list[ValveImage] = []
    clock = [0]
    coupler = Coupler(lambda: SENSORS, written.append, 1000 * MS, lambda: clock[0])
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        _, port = await coupler.start(bound)
        config = PlantLinkConfig(host="127.0.0.1", port=port, unit_id=1, timeout_ms=500.0, reconnect_ms=30.0)
        link = PlantLink(config, EventLog("controller", io.StringIO()))
        link.start()
        async with asyncio.timeout(3.0):
            while link.connections < 1:  # noqa: ASYNC110 - the link has no event to wait for
                await asyncio.sleep(0.005)
        assert await link.exchange(encode_valves(IMAGE)) == SENSORS
        clock[0] += 5000 * MS  # the controller was suspended
        assert await link.exchange(encode_valves(IMAGE)) == PlantRefusal(4)
        assert link.failures == {"exception_4": 1}
        assert written[-1] == ValveImage(0, 0, (0.0,) * 6)
        assert await link.exchange(encode_valves(IMAGE)) == SENSORS
        assert link.connections == 1
        await link.close()
        await coupler.stop()
