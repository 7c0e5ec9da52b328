"""The fieldbus client on loopback: one exchange a call, never a blind repetition, reconnection by itself."""

import asyncio
import io
import socket
import time
from collections.abc import AsyncIterator

import pytest
from pymodbus.constants import ExcCodes

from controller.config import PlantLinkConfig
from controller.core.plant_watch import PlantRefusal
from controller.shell.plant_link import PlantLink
from foundation.event_log import EventLog
from protocol.process_image import ValveImage, decode_sensors, encode_valves
from tests.controller.shell.plant_server import PlantServer, plant_server

pytestmark = pytest.mark.realtime

WORDS = encode_valves(ValveImage(7, 0, (0.0,) * 6))


def _link(port: int, timeout_ms: float = 60.0) -> PlantLink:
    config = PlantLinkConfig(host="127.0.0.1", port=port, unit_id=1, timeout_ms=timeout_ms, reconnect_ms=30.0)
    return PlantLink(config, EventLog("controller", io.StringIO()))


@pytest.fixture
async def server() -> AsyncIterator[PlantServer]:
    async with plant_server() as serving:
        yield serving


async def _connected(link: PlantLink, times: int = 1) -> None:
    async with asyncio.timeout(3.0):
        while link.connections < times:  # noqa: ASYNC110 - the link has no event to wait for
            await asyncio.sleep(0.005)


async def test_an_exchange_writes_and_reads_once(server: PlantServer) -> None:
    link = _link(server.port)
    link.start()
    await _connected(link)
    for cycle in range(1, 6):
        words = await link.exchange(encode_valves(ValveImage(cycle, 1, (0.1, -0.2, 0.3, 0.0, 0.5, -1.0))))
        assert words is not None
        assert decode_sensors(words).echo_cycle == cycle
    assert [image.controller_cycle for image in server.written] == [1, 2, 3, 4, 5]
    assert server.written[-1].valves == pytest.approx((0.1, -0.2, 0.3, 0.0, 0.5, -1.0), abs=2e-5)
    assert link.round_trip.count == 5
    assert not link.failures
    await link.close()


async def test_without_a_plant_calls_fail_at_once_and_are_counted() -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        link = _link(unused.getsockname()[1])
        link.start()
        began_s = time.monotonic()
        for _ in range(10):
            assert await link.exchange(WORDS) is None
        assert time.monotonic() - began_s < 0.05
        assert link.failures == {"not_connected": 10}
        await link.close()


async def test_a_plant_that_comes_later_is_found(server: PlantServer) -> None:
    port = server.port
    await server.shutdown()
    link = _link(port)
    link.start()
    await asyncio.sleep(0.1)
    assert await link.exchange(WORDS) is None
    async with plant_server(port):
        await _connected(link)
        assert await link.exchange(WORDS) is not None
        await link.close()


async def test_a_lost_answer_is_not_answered_by_a_second_write(server: PlantServer) -> None:
    link = _link(server.port, timeout_ms=50.0)
    link.start()
    await _connected(link)
    server.answer_delay_s = 0.12
    began_s = time.monotonic()
    assert await link.exchange(encode_valves(ValveImage(41, 0, (0.0,) * 6))) is None
    assert time.monotonic() - began_s < 0.1
    assert link.failures["timeout"] == 1
    await _connected(link, times=2)
    words = await link.exchange(encode_valves(ValveImage(42, 0, (0.0,) * 6)))
    assert isinstance(words, list)
    assert decode_sensors(words).echo_cycle == 42
    await asyncio.sleep(0.15)  # the late answer meets a closed connection
    words = await link.exchange(encode_valves(ValveImage(43, 0, (0.0,) * 6)))
    assert words is not None
    assert decode_sensors(words).echo_cycle == 43
    assert [image.controller_cycle for image in server.written] == [41, 42, 43]
    await link.close()


async def test_an_exception_response_is_counted_by_its_code_and_keeps_the_connection(
    server: PlantServer,
) -> None:
    link = _link(server.port)
    link.start()
    await _connected(link)
    server.exception = ExcCodes.DEVICE_BUSY
    assert await link.exchange(WORDS) == PlantRefusal(6)
    assert link.failures == {"exception_6": 1}
    server.exception = None
    assert await link.exchange(WORDS) is not None
    assert link.connections == 1
    await link.close()


async def test_a_plant_that_goes_away_is_noticed_and_found_again(server: PlantServer) -> None:
    port = server.port
    link = _link(port)
    link.start()
    await _connected(link)
    assert await link.exchange(WORDS) is not None
    await server.shutdown()
    assert await link.exchange(WORDS) is None
    assert link.failures.total() >= 1
    async with plant_server(port):
        await _connected(link, times=2)
        assert await link.exchange(WORDS) is not None
        await link.close()
