"""The coupler's watchdog and ownership with a clock to turn; its registers, bits and diagnostics in full."""

import asyncio
import io
import socket
import struct
from collections.abc import Callable

import pytest

from controller.config import PlantLinkConfig
from controller.core.plant_watch import PlantRefusal
from controller.shell.plant_link import PlantLink
from foundation.event_log import EventLog
from plant_emulator.core.coupler.image import COUPLER_MAP
from plant_emulator.core.coupler.modbus_requests import Span
from plant_emulator.shell.coupler import Coupler
from protocol import coupler_registers
from protocol.process_image import CONTROL_ENABLE, SensorImage, ValveImage, encode_sensors, encode_valves

pytestmark = pytest.mark.realtime

MS = 1_000_000
SENSORS = encode_sensors(SensorImage(7, 9, 0b0101, (1, 2, 3, 4, 5, 6), ((1.0, 2.0),) * 6, 190.0, 10.0, 40.0))
IMAGE = ValveImage(3, CONTROL_ENABLE, (0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
WRITE = struct.pack(">BHHB12H", 16, 0x800, 12, 24, *encode_valves(IMAGE))
READ = bytes.fromhex("03 0000 0001")


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


def test_the_table_holds_the_published_addresses() -> None:
    rows = {row.name: (row.address, row.words, row.writable) for row in coupler_registers.COUPLER_TABLE}
    assert rows == {
        "identification": (0x1000, 7, False),
        "status": (0x100C, 1, False),
        "analog_output_bits": (0x1010, 1, False),
        "analog_input_bits": (0x1011, 1, False),
        "digital_output_bits": (0x1012, 1, False),
        "digital_input_bits": (0x1013, 1, False),
        "watchdog_left_ms": (0x1020, 1, False),
        "watchdog_time_ms": (0x1120, 1, True),
        "watchdog_reset": (0x1121, 1, True),
        "watchdog_trigger": (0x1122, 1, True),
    }
    assert Span(0x1010, 4) in COUPLER_MAP.reads[3]
    assert Span(0x1120, 3) in COUPLER_MAP.reads[3]


def test_its_own_registers_at_start() -> None:
    bench = Bench()
    answer = bytes.fromhex(bench.ask("03 1000 0007"))
    words = struct.unpack(">7H", answer[2:])
    assert struct.pack("<7H", *words) == b"LONGREACH-9100"
    assert bench.ask("03 1010 0004") == "0308" + "00c0" + "0280" + "0010" + "0010"
    assert bench.ask("04 1120 0003") == "0406" + "03e8" + "0000" + "0001"
    assert bench.ask("03 100C 0001") == "03020000"
    assert bench.ask("03 1020 0001") == "03020000"
    assert bench.ask("03 1007 0001") == "8302"
    assert bench.ask("06 1000 0000") == "8602"
    assert bench.ask("17 1000 0002 080C 0001 02 0000") == "17044f4c474e"


def test_digital_terminals_lie_behind_the_analog_ones() -> None:
    bench = Bench()
    assert bench.ask("02 0000 0010") == "02020500"
    assert bench.ask("02 0002 0003") == "020101"
    assert bench.ask("03 0027 0002") == f"0304{SENSORS[-1]:04x}0005"
    assert bench.ask("05 0009 FF00") == "050009ff00"
    assert bench.ask("0F 0001 0003 01 FD") == "0f00010003"
    assert bench.ask("01 0000 0010") == "01020a02"
    assert bench.ask("03 080C 0001") == "0302020a"
    assert bench.ask("05 0009 0000") == "0500090000"
    assert bench.ask("06 080C 8001") == "06080c8001"
    assert bench.ask("01 0000 0010") == "01020180"
    assert bench.written == []
    assert bench.coupler.statistics.torn_images == 0


def test_diagnostics_echo_and_count() -> None:
    bench = Bench()
    assert bench.ask("08 0000 A537 1234") == "080000a5371234"
    assert bench.ask("08 000A 0000") == "08000a0000"
    assert bench.ask("63") == "e301"
    assert bench.ask("03 0000 0000") == "8303"
    assert bench.ask("08 000D 0000") == "08000d0002"
    assert bench.ask("08 000B 0000") == "08000b0004"
    assert bench.ask("08 000C 0000") == "08000c0000"
    assert bench.ask("08 0002 0000") == "0800020000"
    bench.ask(WRITE)
    bench.now_ns += 1000 * MS
    assert bench.ask("08 0002 0000") == "0800028000"


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


def _reset_by(*words: int, masters: str = "aaaa") -> Callable[[Bench], None]:
    def run(bench: Bench) -> None:
        for word, master in zip(words, masters, strict=False):
            bench.ask(struct.pack(">BHH", 6, 0x1121, word), master)

    return run


@pytest.mark.parametrize(
    ("attempt", "works"),
    [
        (_reset_by(0xBECF, 0xAFFE), True),
        (_reset_by(0xAFFE, 0xBECF, 0xAFFE), True),
        (_reset_by(0xBECF, 0xBECF, 0xAFFE), True),
        (_reset_by(0xBECF), False),
        (_reset_by(0xAFFE), False),
        (_reset_by(0xAFFE, 0xBECF), False),
        (_reset_by(0xBECF, 0x0000, 0xAFFE), False),
        (_reset_by(0xBECF, 0xAFFE, masters="ab"), False),
    ],
)
def test_only_the_two_words_in_order_from_one_master_reset(
    attempt: Callable[[Bench], None], works: bool
) -> None:
    bench = Bench()
    bench.ask(WRITE)
    bench.now_ns += 1000 * MS
    assert bench.expired
    attempt(bench)
    assert bench.expired is not works


def test_after_a_reset_outputs_are_zero_and_the_next_write_arms_again() -> None:
    bench = Bench()
    bench.ask("06 080C 0001")
    bench.now_ns += 1000 * MS
    assert bench.expired
    bench.reset("b")
    assert bench.ask("03 0800 000D") == "031a" + "00" * 26
    bench.now_ns += 5000 * MS
    assert not bench.expired
    assert bench.ask(WRITE, "b")[:2] == "10"
    bench.now_ns += 1000 * MS
    assert bench.expired


def test_the_time_is_set_only_while_inactive() -> None:
    bench = Bench()
    assert bench.ask("06 1120 0064") == "0611200064"
    bench.ask(WRITE)
    assert bench.ask("06 1120 0000") == "8604"
    assert bench.word(0x1120) == 100
    assert bench.word(0x1020) == 100
    bench.now_ns += 60 * MS
    assert bench.word(0x1020) == 40
    bench.now_ns += 40 * MS
    assert bench.expired
    assert bench.ask("06 1120 0000") == "8604"
    bench.reset()
    assert bench.ask("06 1120 0000") == "0611200000"
    bench.ask(WRITE)
    bench.now_ns += 70_000 * MS
    assert not bench.expired


def test_only_the_owner_retriggers_and_the_trigger_register_decides_by_what() -> None:
    bench = Bench()
    bench.ask(WRITE)
    for _ in range(5):
        bench.ask(READ, after_ms=900)
    assert not bench.expired
    bench.ask(READ, "b", after_ms=900)
    bench.now_ns += 100 * MS
    assert bench.expired
    bench.reset()
    assert bench.ask("06 1122 0002") == "8603"
    assert bench.ask("06 1122 0000") == "0611220000"
    bench.ask(WRITE)
    bench.ask(READ, after_ms=900)
    bench.now_ns += 100 * MS
    assert bench.expired


def test_a_refused_telegram_neither_owns_nor_retriggers() -> None:
    bench = Bench()
    assert bench.ask("10 0802 0001 02 8000") == "9003"
    bench.now_ns += 2000 * MS
    assert not bench.expired
    assert bench.ask(WRITE, "b")[:2] == "10"
    bench.ask("10 0802 0001 02 8000", "b", after_ms=900)
    bench.now_ns += 100 * MS
    assert bench.expired


@pytest.mark.parametrize(
    "request_hex",
    [
        "06 0802 8000",
        "10 0807 0001 02 8000",
        "17 0000 0001 0802 0002 04 0000 8000",
        "10 0800 0003 06 000900008000",
    ],
)
def test_the_impossible_command_is_refused_when_it_comes_also_in_a_torn_image(request_hex: str) -> None:
    bench = Bench()
    bench.ask("06 0800 270F")  # the cycle at the start, not the one at the end: torn from here on
    refused = f"{int(request_hex[:2], 16) | 0x80:02x}03"
    assert bench.ask(request_hex) == refused
    assert bench.ask("03 0800 000C") == "0318270f" + "0000" * 11
    assert bench.written == []
    # The word that makes the image whole is not blamed for the refused one, and the image acts.
    assert bench.ask("06 080B 270F") == "06080b270f"
    assert bench.written == [ValveImage(0x270F, 0, (0.0,) * 6)]


@pytest.mark.parametrize("address", [0x0800, 0x0801, 0x0808, 0x080A, 0x080B, 0x080C])
def test_outside_the_spools_the_same_word_is_like_any_other(address: int) -> None:
    bench = Bench()
    assert bench.ask(f"06 {address:04X} 8000") == f"06{address:04x}8000"
    assert bench.ask("06 0802 8001") == "0608028001"


def test_a_second_master_is_told_six_and_changes_nothing() -> None:
    bench = Bench()
    bench.ask(WRITE, "a")
    data = ("05 0000 FF00", "06 080C 0001", "0F 0000 0001 01 01", "10 080C 0001 02 0001")
    own = ("17 0000 0001 080C 0001 02 0001", "06 1121 BECF", "06 1120 0000", "06 1122 0000")
    for request in data + own:
        assert bench.ask(request, "b") == f"{int(request[:2], 16) | 0x80:02x}06"
    assert bench.ask("03 080C 0001", "b") == "03020000"
    assert len(bench.written) == 1


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


def test_the_published_vector_gives_the_published_answer() -> None:
    coupler = Coupler(lambda: [0x0038, 0x3F0B] + [0] * 38, lambda image: None, MS, lambda: 0)
    answer = coupler.answer("a", 1, bytes.fromhex("17 0000 0002 0800 0002 04 3FFF 7FFF"))
    assert answer == bytes.fromhex("17 04 0038 3F0B")
