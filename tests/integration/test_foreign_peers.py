"""Masters that others wrote drive our coupler: libmodbus through ``mbpoll``, and pyModbusTCP.

``mbpoll`` is a Debian package of that name; without it those tests are skipped and say so.
"""

import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator

import pytest
from pyModbusTCP.client import ModbusClient

from protocol.process_image import CONTROL_ENABLE, SensorImage, ValveImage, encode_sensors, encode_valves
from tests.conformance.couplers import ThreadedCoupler
from tests.support.pages import commands_of

pytestmark = pytest.mark.realtime

VALVES = ValveImage(17, CONTROL_ENABLE, (0.5, -0.25, 1.0, -1.0, 0.0, 0.125))
PUBLISHED_INPUTS = [0x0038, 0x3F0B]
PUBLISHED_OUTPUTS = [0x3FFF, 0x7FFF]

needs_mbpoll = pytest.mark.skipif(
    shutil.which("mbpoll") is None, reason="mbpoll is not installed: apt-get install mbpoll"
)


class PublishedCoupler(ThreadedCoupler):
    """Our coupler with the inputs of the published exchange."""

    def sensors(self) -> list[int]:
        """The input image; its first words are not those of this plant."""
        return [*PUBLISHED_INPUTS, *super().sensors()[2:]]


class StillCoupler(ThreadedCoupler):
    """Our coupler with inputs that stand still, so that two readings of them are the same."""

    def sensors(self) -> list[int]:
        """The input image, with supply on and the watchdog tripped."""
        return encode_sensors(SensorImage(7, 9, 5, (1, 2, 3, 4, 5, 6), ((1.0, 2.0),) * 6, 190.0, 10.0, 40.0))


@pytest.fixture
def coupler() -> Iterator[ThreadedCoupler]:
    with StillCoupler() as serving:
        yield serving


def mbpoll(coupler: ThreadedCoupler, *arguments: str) -> subprocess.CompletedProcess[str]:
    """One poll, or one write."""
    command = ["mbpoll", "-0", "-1", "-p", str(coupler.port), "-o", "2", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=20.0, check=False)


def values(done: subprocess.CompletedProcess[str]) -> list[int]:
    """The values that mbpoll prints as ``[address]: value``."""
    assert done.returncode == 0, done.stdout + done.stderr
    return [int(text, 0) for text in re.findall(r"^\[\d+\]:\s+(\S+)", done.stdout, re.MULTILINE)]


@needs_mbpoll
def test_libmodbus_reads_inputs_by_both_function_codes_and_outputs(coupler: ThreadedCoupler) -> None:
    words = coupler.sensors()
    for table in ("3:hex", "4:hex"):
        assert values(mbpoll(coupler, "-t", table, "-r", "0", "-c", "40", "127.0.0.1")) == words
    outputs = mbpoll(coupler, "-t", "4:hex", "-r", str(0x800), "-c", "12", "127.0.0.1")
    assert values(outputs) == [0] * 12


@needs_mbpoll
def test_the_lines_of_the_page_read_the_inputs(coupler: ThreadedCoupler) -> None:
    whole, counts = [line for line in commands_of("protocol.md", "Annex D") if line.startswith("mbpoll ")]

    def said(line: str) -> list[int]:
        arguments = shlex.split(line.replace("-p 1502", f"-p {coupler.port}"))
        return values(subprocess.run(arguments, capture_output=True, text=True, timeout=20.0, check=False))

    assert said(whole) == coupler.sensors()
    assert said(counts) == [1, 2, 3, 4, 5, 6]


@needs_mbpoll
def test_libmodbus_reads_32_bit_counts_low_word_first(coupler: ThreadedCoupler) -> None:
    done = mbpoll(coupler, "-t", "3:int", "-r", "4", "-c", "6", "127.0.0.1")
    assert values(done) == [1, 2, 3, 4, 5, 6]


@needs_mbpoll
def test_libmodbus_writes_a_whole_image_and_reads_it_back(coupler: ThreadedCoupler) -> None:
    words = [str(word) for word in encode_valves(VALVES)]
    written = mbpoll(coupler, "-t", "4", "-r", str(0x800), "127.0.0.1", "--", *words)
    assert "Written 12 references" in written.stdout, written.stdout + written.stderr
    assert [image.controller_cycle for image in coupler.written] == [17]
    assert coupler.written[0].valves == pytest.approx(VALVES.valves, abs=4e-5)
    back = mbpoll(coupler, "-t", "4:hex", "-r", str(0x800), "-c", "12", "127.0.0.1")
    assert values(back) == encode_valves(VALVES)


@needs_mbpoll
def test_libmodbus_reads_digital_inputs_and_switches_a_digital_output(coupler: ThreadedCoupler) -> None:
    assert values(mbpoll(coupler, "-t", "1", "-r", "0", "-c", "4", "127.0.0.1")) == [1, 0, 1, 0]
    assert "Written 1 references" in mbpoll(coupler, "-t", "0", "-r", "1", "127.0.0.1", "1").stdout
    assert values(mbpoll(coupler, "-t", "0", "-r", "0", "-c", "3", "127.0.0.1")) == [0, 1, 0]


@needs_mbpoll
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("-t", "4", "-r", str(0x700), "-c", "1"), "Illegal data address"),
        (("-t", "4", "-r", "0", "-c", "42"), "Illegal data address"),
        (("-t", "3", "-r", str(0x800), "-c", "1"), "Illegal data address"),
    ],
)
def test_libmodbus_is_told_what_is_wrong(
    coupler: ThreadedCoupler, arguments: tuple[str, ...], said: str
) -> None:
    done = mbpoll(coupler, *arguments, "127.0.0.1")
    assert said in done.stdout + done.stderr


def test_the_published_exchange_gives_the_published_answer_to_pymodbustcp() -> None:
    with PublishedCoupler() as coupler:
        client = ModbusClient("127.0.0.1", coupler.port, timeout=2.0, auto_open=True)
        assert client.write_read_multiple_registers(0x800, PUBLISHED_OUTPUTS, 0, 2) == PUBLISHED_INPUTS
        assert client.custom_request(bytes.fromhex("17 0000 0002 0800 0002 04 3FFF 7FFF")) == bytes.fromhex(
            "17 04 00 38 3F 0B"
        )
        assert client.read_holding_registers(0x800, 2) == PUBLISHED_OUTPUTS
        client.close()


def test_pymodbustcp_drives_an_exchange_every_cycle(coupler: ThreadedCoupler) -> None:
    client = ModbusClient("127.0.0.1", coupler.port, timeout=2.0, auto_open=True)
    for cycle in range(1, 51):
        image = encode_valves(VALVES._replace(controller_cycle=cycle))
        assert client.write_read_multiple_registers(0x800, image, 0, 40) == coupler.sensors()
    assert [image.controller_cycle for image in coupler.written] == list(range(1, 51))
    client.close()
