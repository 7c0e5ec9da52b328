"""The coupler over real sockets, driven by two independent Modbus clients and by raw bytes."""

import asyncio
import socket
import struct
from collections.abc import AsyncIterator
from typing import NamedTuple

import pytest
from pyModbusTCP.client import ModbusClient

from plant_emulator.shell.coupler import Coupler
from protocol.process_image import (
    CONTROL_ENABLE,
    SensorImage,
    ValveImage,
    decode_sensors,
    encode_sensors,
    encode_valves,
)

pytestmark = pytest.mark.realtime

SENSORS = SensorImage(
    plant_cycle=70_001,
    echo_cycle=17,
    status=3,
    encoder_counts=(-1, 2, -70_000, 65_536, 0, 123_456),
    pressures_bar=((100.0, 50.25),) * 6,
    supply_bar=190.0,
    return_bar=10.0,
    oil_temperature_degc=-3.5,
)
VALVES = ValveImage(controller_cycle=17, control=CONTROL_ENABLE, valves=(0.5, -0.25, 1.0, -1.0, 0.0, 0.125))
RELEASE_NS = 1_000_000_000


class Bench(NamedTuple):
    """A coupler that listens, what it was told, and a clock to turn."""

    coupler: Coupler
    port: int
    written: list[ValveImage]
    clock: list[int]
    silent: list[bool]


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    written: list[ValveImage] = []
    clock, silent = [0], [False]
    coupler = Coupler(
        lambda: encode_sensors(SENSORS), written.append, RELEASE_NS, lambda: clock[0], lambda: silent[0]
    )
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        _, port = await coupler.start(bound)
        yield Bench(coupler, port, written, clock, silent)
        await coupler.stop()


def same_sensors(words: list[int]) -> bool:
    """Whether ``words`` are those of SENSORS, the cycle counter modulo 2^16."""
    return decode_sensors(words) == decode_sensors(encode_sensors(SENSORS))


def close_valves(image: ValveImage) -> bool:
    """Whether ``image`` is VALVES to the resolution of a word."""
    near = all(abs(a - b) < 1e-4 for a, b in zip(image.valves, VALVES.valves, strict=True))
    return near and image[:2] == VALVES[:2]


async def test_separate_reads_and_writes_with_pymodbustcp(bench: Bench) -> None:
    """Masters without FC 23 use FC 3 or 4 and FC 16; this client shares no code with the coupler."""

    def talk() -> tuple[list[int] | None, list[int] | None, bool | None, list[int] | None, int]:
        client = ModbusClient("127.0.0.1", bench.port, timeout=1.0, auto_open=True)
        inputs, holding = client.read_input_registers(0, 40), client.read_holding_registers(0, 40)
        wrote = client.write_multiple_registers(0x800, encode_valves(VALVES))
        both = client.write_read_multiple_registers(0x800, encode_valves(VALVES), 0, 40)
        client.read_holding_registers(0, 42)
        exception = client.last_except
        client.close()
        return inputs, holding, wrote, both, exception

    inputs, holding, wrote, both, exception = await asyncio.to_thread(talk)
    for words in (inputs, holding, both):
        assert words is not None
        assert same_sensors(words)
    assert wrote
    assert [close_valves(image) for image in bench.written] == [True, True]
    assert exception == 2


class Raw:
    """A master that sends exactly the bytes it is told to."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.transaction = 0

    async def ask(self, pdu: bytes, unit: int = 1) -> bytes:
        """The response PDU to ``pdu``."""
        self.transaction += 1
        self.writer.write(struct.pack(">HHHB", self.transaction, 0, len(pdu) + 1, unit) + pdu)
        transaction, protocol, length, echoed = struct.unpack(">HHHB", await self.reader.readexactly(7))
        assert (transaction, protocol, echoed) == (self.transaction, 0, unit)
        return await self.reader.readexactly(length - 1)

    async def close(self) -> None:
        """Hang up."""
        self.writer.close()
        await self.writer.wait_closed()


async def connected(bench: Bench) -> Raw:
    """A connected raw master."""
    return Raw(*await asyncio.open_connection("127.0.0.1", bench.port))


def whole(image: ValveImage) -> bytes:
    """FC 16 with a whole image."""
    return struct.pack(">BHHB12H", 16, 0x800, 12, 24, *encode_valves(image))


async def test_a_silent_coupler_swallows_whole_requests_and_keeps_its_place(bench: Bench) -> None:
    master = await connected(bench)
    write, read = whole(VALVES), bytes.fromhex("0300000001")
    await master.ask(read)
    bench.silent[0] = True
    frames = [struct.pack(">HHHB", 9, 0, len(pdu) + 1, 1) + pdu for pdu in (write, read, read)]
    master.writer.write(frames[0] + frames[1] + frames[2][:6])  # the last one comes in two pieces
    with pytest.raises(TimeoutError):
        await asyncio.wait_for(master.reader.read(1), 0.1)
    assert bench.written == []
    assert bench.coupler.statistics.requests == 1
    bench.silent[0] = False
    master.writer.write(frames[2][6:])  # it speaks again when the request is whole: this one is answered
    assert (await master.reader.readexactly(11))[:2] == b"\x00\x09"
    await master.ask(write)
    assert close_valves(bench.written[0])
    await master.close()
