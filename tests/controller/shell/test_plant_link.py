"""The fieldbus client on loopback: one exchange a call, never a blind repetition, reconnection by itself."""

import asyncio
import contextlib
import io
import socket
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest

from controller.config import PlantLinkConfig
from controller.shell.plant_link import PlantLink
from foundation.event_log import EventLog
from protocol.process_image import (
    SensorImage,
    ValveImage,
    decode_sensors,
    encode_sensors,
    encode_valves,
)
from tests.controller.shell.plant_server import PlantServer, plant_server

pytestmark = pytest.mark.realtime

SENSORS = SensorImage(7, 0, 1, (0,) * 6, ((60.0, 60.0),) * 6, 190.0, 10.0, 40.0)
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
        for _ in range(10):
            assert await link.exchange(WORDS) is None
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


Bend = Callable[[bytes], bytes]


@asynccontextmanager
async def bent_coupler(bends: list[Bend]) -> AsyncIterator[tuple[int, list[bytes]]]:
    """A coupler whose n-th answer goes through the n-th of ``bends``: its port, and what it was asked."""
    asked: list[bytes] = []
    serving: list[asyncio.Task[None]] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        serving.append(task)
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                head = await reader.readexactly(7)
                pdu = await reader.readexactly(int.from_bytes(head[4:6], "big") - 1)
                asked.append(pdu)
                sound = encode_sensors(SENSORS._replace(echo_cycle=int.from_bytes(pdu[10:12], "big")))
                answer = head[:4] + b"\0\x53" + head[6:7] + b"\x17\x50" + struct.pack(">40H", *sound)
                bend = bends[len(asked) - 1] if len(asked) <= len(bends) else bytes
                writer.write(bend(answer))
        writer.close()
        with contextlib.suppress(ConnectionError):
            await writer.wait_closed()

    async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
        yield server.sockets[0].getsockname()[1], asked
        await asyncio.wait_for(asyncio.gather(*serving), 2.0)


def _with_pdu(answer: bytes, pdu: bytes) -> bytes:
    return answer[:4] + struct.pack(">H", len(pdu) + 1) + answer[6:7] + pdu


HOSTILE: dict[str, Bend] = {
    "the next number": lambda a: struct.pack(">H", int.from_bytes(a[:2], "big") + 1) + a[2:],
    "number 0": lambda a: b"\0\0" + a[2:],
    "another unit": lambda a: a[:6] + b"\2" + a[7:],
    "another protocol": lambda a: a[:2] + b"\0\1" + a[4:],
    "function code 3": lambda a: a[:7] + b"\3" + a[8:],
    "function code 4": lambda a: a[:7] + b"\4" + a[8:],
    "function code 99": lambda a: a[:7] + b"\x63" + a[8:],
    "the answer to a write": lambda a: _with_pdu(a, bytes.fromhex("10 0800 000C")),
    "an exception of another": lambda a: _with_pdu(a, b"\x83\2"),
    "an exception without code": lambda a: _with_pdu(a, b"\x97"),
    "a byte count too low": lambda a: a[:8] + b"\x4e" + a[9:],
    "a byte count too high": lambda a: a[:8] + b"\x52" + a[9:],
    "one word less": lambda a: _with_pdu(a, b"\x17\x4e" + a[9:-2]),
    "one word more": lambda a: _with_pdu(a, b"\x17\x52" + a[9:] + bytes(2)),
    "a byte behind the words": lambda a: _with_pdu(a, a[7:] + b"\0"),
    "a byte behind an exception": lambda a: _with_pdu(a, b"\x97\2\0"),
    "no word": lambda a: _with_pdu(a, b"\x17\0"),
    "a length of 0": lambda a: a[:4] + bytes(2) + a[6:],
    "a length beyond all frames": lambda a: a[:4] + b"\xff\xff" + a[6:],
    "a part": lambda a: a[:40],
    "noise": lambda a: b"\xff" * 300,
    "zeros": lambda a: bytes(300),
}


@pytest.mark.parametrize("bend", HOSTILE.values(), ids=HOSTILE)
async def test_what_is_no_answer_to_the_exchange_is_not_taken_nor_written_again(bend: Bend) -> None:
    async with bent_coupler([bytes, bend]) as (port, asked):
        link = _link(port, timeout_ms=80.0)
        link.start()
        await _connected(link)
        assert isinstance(await link.exchange(encode_valves(ValveImage(1, 0, (0.0,) * 6))), list)
        assert await link.exchange(encode_valves(ValveImage(2, 0, (0.0,) * 6))) is None
        assert link.failures.total() == 1
        await _connected(link, times=2)
        words = await link.exchange(encode_valves(ValveImage(3, 0, (0.0,) * 6)))
        assert isinstance(words, list)
        assert decode_sensors(words).echo_cycle == 3
        await link.close()
    assert [int.from_bytes(pdu[10:12], "big") for pdu in asked] == [1, 2, 3]
