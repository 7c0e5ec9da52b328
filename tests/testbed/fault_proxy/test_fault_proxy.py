"""The fault proxy: fates by seed, exact statistics, datagrams and streams over real sockets."""

import asyncio
import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any, cast

import numpy as np
import pytest

from conformance.case import CaseOutcome
from conformance.runner import run_coupler
from protocol.errors import ConfigurationError
from testbed.fault_proxy.faults import Event, FaultLine, Faults
from testbed.fault_proxy.proxy import FaultProxy, Route, TcpProxy, UdpProxy
from tests.conformance.couplers import ThreadedCoupler

pytestmark = pytest.mark.realtime

PACKETS = [index.to_bytes(4, "big") * 8 for index in range(4000)]
MS = 1_000_000


def run(faults: Faults, seed: int = 5) -> tuple[list[list[tuple[int, bytes]]], dict[Event, int]]:
    line = FaultLine(faults, seed, 0)
    return [[(d.delay_ns, d.data) for d in line.fate(data, 0)] for data in PACKETS], line.counts


def test_without_faults_all_passes_at_once() -> None:
    fates, counts = run(Faults())
    assert fates == [[(0, data)] for data in PACKETS]
    assert counts[Event.PASSED] == len(PACKETS)
    assert sum(counts.values()) == len(PACKETS)


def test_the_same_seed_is_the_same_fate_and_another_is_not() -> None:
    faults = Faults(loss=0.1, jitter_ms=5.0, duplicate=0.05, corrupt=0.05)
    assert run(faults) == run(faults)
    assert run(faults)[0] != run(faults, seed=6)[0]
    other_way = FaultLine(faults, 5, 1)
    assert [[tuple(d) for d in other_way.fate(data, 0)] for data in PACKETS] != run(faults)[0]


def test_one_kind_of_fault_does_not_shift_another() -> None:
    lost = [not fate for fate in run(Faults(loss=0.1))[0]]
    assert lost == [not fate for fate in run(Faults(loss=0.1, duplicate=0.5, corrupt=0.3, jitter_ms=9.0))[0]]


@pytest.mark.parametrize(
    ("name", "event"),
    [
        ("loss", Event.LOST),
        ("duplicate", Event.DUPLICATED),
        ("reorder", Event.REORDERED),
        ("truncate", Event.TRUNCATED),
        ("corrupt", Event.CORRUPTED),
    ],
)
def test_rates_are_those_wanted(name: str, event: Event) -> None:
    fates, counts = run(Faults(**cast("dict[str, Any]", {name: 0.2})))
    assert counts[event] == pytest.approx(0.2 * len(PACKETS), abs=4.0 * np.sqrt(0.16 * len(PACKETS)))
    assert sum(len(fate) for fate in fates) == (len(PACKETS) - counts[Event.LOST] + counts[Event.DUPLICATED])


def test_bursts_have_their_length() -> None:
    fates, counts = run(Faults(burst=0.005, burst_length=4))
    runs, length = [], 0
    for fate in fates:
        if not fate:
            length += 1
        elif length:
            runs.append(length)
            length = 0
    assert len(runs) > 5
    assert all(length % 4 == 0 for length in runs)
    assert counts[Event.LOST_IN_BURST] == sum(not fate for fate in fates)


def test_a_corrupted_packet_differs_in_one_bit_and_a_cut_one_is_a_beginning() -> None:
    for fate, data in zip(run(Faults(corrupt=1.0))[0], PACKETS, strict=True):
        changed = int.from_bytes(fate[0][1], "big") ^ int.from_bytes(data, "big")
        assert changed.bit_count() == 1
    for fate, data in zip(run(Faults(truncate=1.0))[0], PACKETS, strict=True):
        assert data.startswith(fate[0][1])
        assert len(fate[0][1]) < len(data)


def test_delay_jitter_and_reordering_add_up() -> None:
    delays = [
        fate[0][0] for fate in run(Faults(delay_ms=10.0, jitter_ms=4.0, reorder=0.5, reorder_ms=50.0))[0]
    ]
    plain = [delay for delay in delays if delay <= 14 * MS]
    late = [delay for delay in delays if delay > 14 * MS]
    assert min(plain) >= 10 * MS
    assert max(plain) - min(plain) > 3.5 * MS
    assert all(60 * MS <= delay <= 64 * MS for delay in late)
    assert 0.4 < len(late) / len(delays) < 0.6


def test_half_open_swallows_everything_from_its_time_on() -> None:
    line = FaultLine(Faults(half_open_after_ms=100.0), 1, 0)
    assert len(line.fate(b"x", 100 * MS - 1)) == 1
    assert line.fate(b"x", 100 * MS) == []
    assert line.counts[Event.SWALLOWED] == 1
    assert FaultLine(Faults(half_open_after_ms=0.0), 1, 0).fate(b"x", 0) == []


@pytest.mark.parametrize("wrong", [{"loss": 1.1}, {"corrupt": -0.1}, {"delay_ms": -1.0}, {"burst_length": 0}])
def test_impossible_faults_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError):
        Faults(**wrong)


class Echo(asyncio.DatagramProtocol):
    """Sends every datagram back, and remembers from whom it came."""

    def __init__(self) -> None:
        self.sources: list[Any] = []

    def connection_made(self, transport: Any) -> None:
        self.transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self.sources.append(addr)
        self.transport.sendto(data, addr)


@asynccontextmanager
async def udp_through(up: Faults, down: Faults | None = None) -> AsyncIterator[tuple[FaultProxy, Echo]]:
    loop = asyncio.get_running_loop()
    transport, echo = await loop.create_datagram_endpoint(Echo, local_addr=("127.0.0.1", 0))
    port = transport.get_extra_info("sockname")[1]
    try:
        async with UdpProxy(Route(0, port), up, down or Faults(), 3) as proxy:
            yield proxy, echo
    finally:
        transport.close()


async def talk(port: int, count: int, wait_s: float = 0.4) -> list[bytes]:
    """What comes back of ``count`` numbered datagrams."""
    loop = asyncio.get_running_loop()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.setblocking(False)
        client.connect(("127.0.0.1", port))
        for index in range(count):
            client.send(index.to_bytes(4, "big"))
            await asyncio.sleep(0.001)
        back = []
        try:
            async with asyncio.timeout(wait_s):
                while True:
                    back.append(await loop.sock_recv(client, 2048))
        except TimeoutError:
            return back


async def test_datagrams_pass_in_order_and_each_client_keeps_its_own_port() -> None:
    async with udp_through(Faults()) as (proxy, echo):
        expected = [index.to_bytes(4, "big") for index in range(50)]
        assert await talk(proxy.port, 50) == expected
        assert await talk(proxy.port, 50) == expected
        assert len(set(echo.sources)) == 2
    assert proxy.statistics()["to_client"]["passed"] == 100


async def test_datagrams_are_lost_doubled_and_reordered_as_counted() -> None:
    async with udp_through(Faults(loss=0.2, duplicate=0.2), Faults(reorder=0.2, reorder_ms=30.0)) as (
        proxy,
        _,
    ):
        back = await talk(proxy.port, 200)
        up = proxy.statistics()["to_server"]
        assert len(back) == 200 - up["lost"] + up["duplicated"]
        assert up["lost"] > 20
        assert up["duplicated"] > 15
        assert back != sorted(back)


async def coupler_through(port: int, up: Faults, down: Faults, numbers: list[int]) -> list[CaseOutcome]:
    async with TcpProxy(Route(0, port), up, down, 9) as proxy:
        summary = await asyncio.to_thread(run_coupler, "127.0.0.1", proxy.port, numbers=numbers)
    return [result.outcome for result in summary.results]


async def test_a_stream_passes_whole_and_in_order_whatever_its_jitter() -> None:
    numbers = [601, 602, 604, 605, 606, 609, 610, 634]
    with ThreadedCoupler() as coupler:
        jitter = Faults(delay_ms=1.0, jitter_ms=4.0)
        outcomes = await coupler_through(coupler.port, jitter, jitter, numbers)
    assert outcomes == [CaseOutcome.PASS] * len(numbers)


async def test_a_bent_stream_is_noticed() -> None:
    with ThreadedCoupler() as coupler:
        async with TcpProxy(Route(0, coupler.port), Faults(), Faults(truncate=1.0), 9) as proxy:
            summary = await asyncio.to_thread(run_coupler, "127.0.0.1", proxy.port, numbers=[601])
    assert summary.ended is not None
    assert summary.ended.cause == "link.no_answer"


async def test_a_half_open_stream_stays_up_and_carries_nothing() -> None:
    read = bytes.fromhex("0001 0000 0006 01 03 0000 0001")
    faults = Faults(half_open_after_ms=300.0)
    with ThreadedCoupler() as coupler:
        route = Route(0, coupler.port)
        async with TcpProxy(route, faults, Faults(), 1) as proxy:
            reader, writer = await asyncio.open_connection("127.0.0.1", proxy.port)
            writer.write(read)
            assert len(await asyncio.wait_for(reader.readexactly(11), 2.0)) == 11
            await asyncio.sleep(0.35)
            writer.write(read)
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(reader.read(1), 0.2)
            assert not reader.at_eof()
            assert proxy.statistics()["to_server"]["swallowed"] == 1
            writer.close()
            await writer.wait_closed()


def test_the_command_serves_until_it_is_told_to_stop() -> None:
    code = "import typer; from testbed.fault_proxy.proxy import proxy; typer.run(proxy)"
    command = [sys.executable, "-c", code, "--listen-port", "0", "--port", "9", "--loss", "1"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    ready = json.loads(process.stdout.readline())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        for _ in range(3):
            client.sendto(b"x", ("127.0.0.1", ready["port"]))
    time.sleep(0.2)
    process.send_signal(signal.SIGTERM)
    counts = json.loads(process.stdout.read())
    assert process.wait(5.0) == 0
    assert counts["to_server"]["lost"] == 3
    process.stdout.close()
