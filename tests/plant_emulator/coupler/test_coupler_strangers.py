"""What strangers may cost the plant's loop: slices, back-pressure, places. Counted in steps, never timed."""

import asyncio
import contextlib
import socket
import struct
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from typing import Any

import pytest

from plant_emulator.shell import coupler as limits
from plant_emulator.shell.coupler import SLICE, Coupler, CouplerConnection
from protocol.process_image import ValveImage, encode_valves

READ_PDU = bytes.fromhex("03 0000 0028")
READ = struct.pack(">HHHB", 1, 0, len(READ_PDU) + 1, 1) + READ_PDU
ANSWER_BYTES = 9 + 80
WRITE_PDU = struct.pack(">BHHB12H", 16, 0x800, 12, 24, *encode_valves(ValveImage(3, 0, (0.0,) * 6)))
WRITE = struct.pack(">HHHB", 2, 0, len(WRITE_PDU) + 1, 1) + WRITE_PDU


@dataclass
class Bench:
    """A coupler that listens, a clock to turn, what it reported, and its masters."""

    now_ns: int = 0
    told: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    masters: list[socket.socket] = field(default_factory=list)
    coupler: Coupler = field(init=False)
    port: int = 0

    def __post_init__(self) -> None:
        def report(_kind: str, event: str, _level: str, **fields: Any) -> None:
            self.told.append((event, fields))

        self.coupler = Coupler(lambda: [0] * 40, lambda _: None, 10**15, lambda: self.now_ns, report=report)

    async def master(self, host: str = "127.0.0.1") -> socket.socket:
        """A master that the coupler has accepted, its socket not blocking."""
        seen = self.coupler.statistics.connections
        sock = socket.socket()
        self.masters.append(sock)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        sock.bind((host, 0))
        sock.connect(("127.0.0.1", self.port))
        sock.setblocking(False)
        await self.until(lambda: self.coupler.statistics.connections > seen)
        return sock

    async def ask(self, sock: socket.socket, frame: bytes = READ) -> bytes:
        """The frame that answers one request."""
        loop = asyncio.get_running_loop()
        await loop.sock_sendall(sock, frame)
        return await asyncio.wait_for(loop.sock_recv(sock, 4096), 5.0)

    async def until(self, condition: Callable[[], object]) -> None:
        """Return when ``condition()`` holds, looking after each step of the loop."""
        async with asyncio.timeout(10.0):
            while not condition():  # noqa: ASYNC110 - the steps are what is counted
                await asyncio.sleep(0)

    def blocked(self) -> bool:
        """Whether answers wait for a master to read them."""
        return any(connection.blocked_ns is not None for connection in self.coupler._connections)

    async def closed(self, sock: socket.socket) -> bool:
        """Whether the coupler has hung up on a master that has read all its answers."""
        with contextlib.suppress(TimeoutError, ConnectionError):
            return await asyncio.wait_for(asyncio.get_running_loop().sock_recv(sock, 1), 5.0) == b""
        return False


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    made = Bench()
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        _, made.port = await made.coupler.start(bound)
        yield made
        await made.coupler.stop()
    for sock in made.masters:
        sock.close()


async def _served_a_step(bench: Bench, wanted: int) -> tuple[list[int], float]:
    """How many requests each step of the loop served that served any, and how long (ms) ``wanted`` took."""
    served: list[int] = []
    began_s = time.monotonic()
    while sum(served) < wanted and time.monotonic() - began_s < 20.0:
        before = bench.coupler.statistics.requests
        await asyncio.sleep(0)
        if bench.coupler.statistics.requests > before:
            served.append(bench.coupler.statistics.requests - before)
    return served, 1e3 * (time.monotonic() - began_s)


@pytest.mark.parametrize("strangers", [1, 3, 7])
async def test_pipelined_requests_of_all_strangers_are_one_slice_a_millisecond(
    bench: Bench, strangers: int
) -> None:
    masters = [await bench.master() for _ in range(strangers)]
    for sock in masters:
        assert sock.send(READ * 30) == 30 * len(READ)
    served, took_ms = await _served_a_step(bench, 30 * strangers)
    assert sum(served) == 30 * strangers
    assert max(served) <= SLICE
    assert took_ms >= (len(served) - 1) * 0.95


async def test_a_stranger_that_pipelines_does_not_wake_the_loop_until_its_turn(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    woken = 0
    right = CouplerConnection._readable

    def readable(connection: CouplerConnection) -> None:
        nonlocal woken
        woken += 1
        right(connection)

    monkeypatch.setattr(CouplerConnection, "_readable", readable)
    monkeypatch.setattr(limits.Turns, "took", lambda self, *_: setattr(self, "next_ns", 10**15))
    greedy, other = await bench.master(), await bench.master()
    await bench.ask(other)  # that was a turn, and the next one is never
    greedy.send(READ * 400)
    for _ in range(100):
        greedy.send(READ)
        await asyncio.sleep(0)
    assert woken <= 3  # the other's request, the greedy one's, and that there is more


async def test_strangers_take_a_twentieth_of_the_time_however_slow_the_machine_is(bench: Bench) -> None:
    """The clock stands still but for a request, which takes 0.3 ms: by the loop's timers turns are told."""
    right, waits = bench.coupler.answer, []

    def answer(master: object, unit: int, pdu: bytes) -> bytes:
        bench.now_ns += 300_000
        return right(master, unit, pdu)

    bench.coupler.answer = answer  # type: ignore[method-assign]
    turn_later = bench.coupler._turn_later

    def later() -> None:
        waits.append(bench.coupler._schedule.next_ns - bench.now_ns)
        bench.now_ns = max(bench.now_ns, bench.coupler._schedule.next_ns)
        turn_later()

    bench.coupler._turn_later = later  # type: ignore[method-assign]
    sock = await bench.master()
    sock.send(READ * 64)
    await bench.until(lambda: bench.coupler.statistics.requests == 64)
    slices = 64 // SLICE
    assert waits[1:slices] == [19 * SLICE * 300_000] * (slices - 1)


async def test_a_stranger_that_asks_once_is_not_kept_waiting_by_one_that_pipelines(bench: Bench) -> None:
    greedy, modest = await bench.master(), await bench.master()
    greedy.send(READ * 300)
    await bench.until(lambda: bench.coupler.statistics.requests > 0)
    before = bench.coupler.statistics.requests
    modest.send(READ)
    await bench.until(lambda: all(connection.served for connection in bench.coupler._connections))
    assert bench.coupler.statistics.requests - before <= 3 * SLICE


async def test_the_writer_waits_for_no_turn(bench: Bench) -> None:
    writer, other, greedy = await bench.master(), await bench.master(), await bench.master()
    await bench.ask(writer, WRITE)
    greedy.send(READ * 300)
    await bench.until(lambda: len(bench.coupler._turns) > 0)
    order: list[object] = []
    right = bench.coupler.answer

    def answer(master: object, unit: int, pdu: bytes) -> bytes:
        order.append(master)
        return right(master, unit, pdu)

    bench.coupler.answer = answer  # type: ignore[method-assign]
    other.send(READ)
    writer.send(WRITE)  # later than the other, and served before it
    await bench.until(lambda: len(set(order)) == 3)
    once = [master for master in order if order.count(master) == 1]
    assert once[0] is bench.coupler.writer
    assert len(once) == 2


async def test_a_master_that_never_reads_is_not_read_on_and_then_closed(bench: Bench) -> None:
    deaf, other = await bench.master(), await bench.master()
    sent = 0
    for _ in range(20_000):
        with contextlib.suppress(BlockingIOError):
            sent += deaf.send(READ * 100)
        await asyncio.sleep(0)
        if bench.blocked():
            break
    served = bench.coupler.statistics.requests
    assert served * ANSWER_BYTES < 1 << 20  # the buffers of two sockets, and nothing beside
    before = bench.coupler.statistics.requests
    await asyncio.sleep(0.05)
    assert bench.coupler.statistics.requests == before
    assert len(await bench.ask(other)) == ANSWER_BYTES  # nobody else notices
    bench.now_ns += limits.UNREAD_NS - 1
    bench.coupler._look_around()
    assert bench.coupler.statistics.unread == 0
    bench.now_ns += 1
    bench.coupler._look_around()
    assert bench.coupler.statistics.unread == 1
    assert len(await bench.ask(other)) == ANSWER_BYTES
    (event, fields), *more = bench.told
    assert (event, fields["cause"], fields["count"], more) == ("connection_closed", "coupler.unread", 1, [])


async def test_a_master_that_reads_late_gets_every_answer(bench: Bench) -> None:
    late, got, expected = await bench.master(), 0, 3000
    pending = READ * expected
    while got < expected * ANSWER_BYTES:
        with contextlib.suppress(BlockingIOError):
            pending = pending[late.send(pending) :]
        await asyncio.sleep(0)
        if bench.blocked() or not pending:
            with contextlib.suppress(BlockingIOError):
                got += len(late.recv(1 << 16))
    assert got == expected * ANSWER_BYTES
    assert bench.coupler.statistics.requests == expected


async def test_strangers_displace_strangers_and_never_the_writer(bench: Bench) -> None:
    writer, reader = await bench.master(), await bench.master()
    await bench.ask(writer, WRITE)
    bench.now_ns += 1
    await bench.ask(reader)
    for _ in range(3 * limits.PLACES):
        await bench.master()
    assert len(bench.coupler._connections) == limits.PLACES_OF_ONE_ADDRESS
    assert bench.coupler.statistics.displaced == 2 + 3 * limits.PLACES - limits.PLACES_OF_ONE_ADDRESS
    assert (await bench.ask(writer, WRITE))[7] == 16
    assert len(await bench.ask(reader)) == ANSWER_BYTES  # it was served, they never were
    assert [fields["count"] for _, fields in bench.told] == list(range(1, len(bench.told) + 1))
    assert {fields["cause"] for _, fields in bench.told} == {"coupler.no_place"}


async def test_one_address_takes_no_places_from_others(bench: Bench) -> None:
    other = await bench.master("127.0.0.2")
    for _ in range(2 * limits.PLACES):
        await bench.master()
    assert len(await bench.ask(other)) == ANSWER_BYTES
    for host in range(3, 6):
        for _ in range(limits.PLACES_OF_ONE_ADDRESS):
            await bench.master(f"127.0.0.{host}")
    assert len(bench.coupler._connections) == limits.PLACES


async def test_who_asks_nothing_goes_after_a_minute_and_the_writer_stays(bench: Bench) -> None:
    writer, quiet, half = await bench.master(), await bench.master(), await bench.master()
    await bench.ask(writer, WRITE)
    half.send(READ[:5])
    bench.now_ns += limits.QUIET_NS - 1
    talks = await bench.master()
    await bench.ask(talks)
    bench.coupler._look_around()
    assert bench.coupler.statistics.quiet == 0
    bench.now_ns += 1
    bench.coupler._look_around()
    assert bench.coupler.statistics.quiet == 2
    assert await bench.closed(quiet)
    assert await bench.closed(half)
    assert [(await bench.ask(sock))[7] for sock in (talks, writer)] == [0x83, 0x83]  # the watchdog expired


async def test_one_connection_is_taken_a_step(bench: Bench) -> None:
    for _ in range(10):
        sock = socket.socket()
        bench.masters.append(sock)
        sock.connect(("127.0.0.1", bench.port))
    before, taken = bench.coupler.statistics.connections, []
    while bench.coupler.statistics.connections < 10:
        await asyncio.sleep(0)
        taken.append(bench.coupler.statistics.connections - before)
        before = bench.coupler.statistics.connections
    assert max(taken) == 1


async def test_a_connection_holds_no_more_than_one_piece_and_a_part_of_a_request(bench: Bench) -> None:
    sock = await bench.master()
    (connection,) = bench.coupler._connections
    held = 0
    pending = READ * 1000 + READ[:-1]
    while pending or bench.coupler.statistics.requests < 1000:
        with contextlib.suppress(BlockingIOError):
            pending = pending[sock.send(pending) :]
        with contextlib.suppress(BlockingIOError):
            sock.recv(1 << 16)
        await asyncio.sleep(0)
        held = max(held, len(connection._held))
    assert SLICE * len(READ) < held < 4096 + len(READ)
    await bench.until(lambda: connection._held == READ[:-1])
