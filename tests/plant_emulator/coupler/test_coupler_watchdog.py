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
from protocol import coupler_registers
from protocol.process_image import CONTROL_ENABLE, SensorImage, ValveImage, encode_sensors, encode_valves

pytestmark = pytest.mark.realtime

MS = 1_000_000
SENSORS = encode_sensors(SensorImage(7, 9, 0b0101, (1, 2, 3, 4, 5, 6), ((1.0, 2.0),) * 6, 190.0, 10.0, 40.0))
IMAGE = ValveImage(3, CONTROL_ENABLE, (0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
WRITE = struct.pack(">BHHB12H", 16, 0x800, 12, 24, *encode_valves(IMAGE))


class Bench:
    """A coupler without sockets, and a clock to turn; masters are names."""

    def __init__(self, release_ns: int = 60_000 * MS) -> None:
        self.written: list[ValveImage] = []
        self.now_ns = 5 * MS
        self.coupler = Coupler(lambda: SENSORS, self.written.append, release_ns, lambda: self.now_ns)

    def ask(self, request: str | bytes, master: str = "a", after_ms: float = 0.0) -> str:
        """The answer in hexadecimal, after the clock has moved on."""
        self.now_ns += round(after_ms * MS)
        pdu = bytes.fromhex(request) if isinstance(request, str) else request
        return self.coupler.answer(master, 1, pdu).hex()

    def word(self, address: int, master: str = "reader") -> int:
        """One register, read with function code 3."""
        return int(self.ask(struct.pack(">BHH", 3, address, 1), master)[4:], 16)

    @property
    def expired(self) -> bool:
        return self.word(coupler_registers.STATUS) == 0x8000

    def reset(self, master: str = "a") -> None:
        assert self.ask("06 1121 BECF", master) == "061121becf"
        assert self.ask("06 1121 AFFE", master) == "061121affe"


def test_diagnostics_count_modulo_65536() -> None:
    bench = Bench()
    bench.ask("08 000A 0000")
    bench.coupler.statistics.requests += 0xFFFE
    assert bench.ask("08 000B 0000") == "08000bffff"
    assert bench.ask("08 000E 0000") == "08000e0000"


def test_the_first_write_arms_and_expiry_latches_to_the_nanosecond() -> None:
    bench = Bench()
    assert not bench.expired
    bench.now_ns += 10_000 * MS
    assert not bench.expired
    assert bench.ask(WRITE) == "100800000c"
    bench.now_ns += 1000 * MS - 1
    assert not bench.expired
    assert len(bench.written) == 1
    bench.now_ns += 1
    assert bench.expired
    assert bench.written[1:] == [ValveImage(0, 0, (0.0,) * 6)]
    assert bench.coupler.statistics.watchdog_expiries == 1
    for request in ("01 0000 0001", "02 0000 0001", "03 0000 0001", "04 0000 0001", "05 0000 0000",
                    "06 080C 0000", "0F 0000 0001 01 00", "10 080C 0001 02 0000",
                    "17 0000 0001 080C 0001 02 0000"):  # fmt: skip
        function = int(request[:2], 16)
        assert bench.ask(request) == f"{function | 0x80:02x}04"
    assert bench.expired
    assert len(bench.written) == 2


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
