"""The plant's clock as a part follows it: what is due waits for a tick, answered when all is done."""

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager

import pytest

from foundation import clock
from protocol.errors import ConfigurationError, LinkLost
from protocol.plant_clock import (
    IN_VAIN,
    MESSAGE_BYTES,
    PICTURE,
    START_NS,
    ClockMessage,
    TickKind,
    decode,
    encode,
)
from vision_pc.shell.machine_clock import Goes, MachineClock

MS = 1_000_000
Program = Callable[["FakePlant", clock.PlantClock], Awaitable[None]]


class FakePlant:
    """A plant that ticks when it is told to, over a real socket."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer
        self.time_ns, self.number = START_NS, 0

    async def heard(self, within_s: float = 5.0) -> ClockMessage:
        """The next message of the part."""
        data = await asyncio.wait_for(self._reader.readexactly(MESSAGE_BYTES), within_s)
        (message,), rest = decode(data)
        assert rest == b""
        return message

    def say(self, kind: TickKind, flags: int = 0, name: str = "", later_ns: int = 0) -> None:
        """Send one message."""
        self.time_ns += later_ns
        self.number += kind is TickKind.TICK
        message = ClockMessage(kind, self.number, self.time_ns, 500_000, flags, name)
        self._writer.write(encode(message))

    async def tick(self, flags: int = 0, later_ns: int = 5 * MS) -> ClockMessage:
        """The answer to a tick."""
        self.say(TickKind.TICK, flags, later_ns=later_ns)
        return await self.heard()

    def close(self) -> None:
        """Be gone."""
        self._writer.transport.abort()


class Plants:
    """Where fake plants listen; ``next`` is the connection that comes next."""

    def __init__(self) -> None:
        self._come: asyncio.Queue[FakePlant] = asyncio.Queue()
        self.address = "127.0.0.1", 0

    async def next(self) -> FakePlant:
        """The part that follows, once it has joined."""
        return await asyncio.wait_for(self._come.get(), 5.0)

    @asynccontextmanager
    async def listening(self) -> AsyncIterator[None]:
        """A block in which parts may come."""

        async def come(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            self._come.put_nowait(FakePlant(reader, writer))

        server = await asyncio.start_server(come, "127.0.0.1", 0)
        self.address = server.sockets[0].getsockname()
        try:
            yield
        finally:
            server.close()


@pytest.fixture(autouse=True)
def wall_again() -> Iterator[None]:
    yield
    clock.use(clock.WallClock())


def following(program: Program) -> None:
    """Run ``program`` with a plant, in a loop of its own, and the clock that has joined it."""
    plants = Plants()

    async def act(followed: clock.PlantClock) -> None:
        # The plant lives in a loop of the same thread: what it hears has left the part by then.
        async with plants.listening():
            followed._where = plants.address
            joining = asyncio.create_task(followed.join(5 * MS))
            plant = await plants.next()
            joined = await plant.heard()
            assert (joined.kind, joined.name, joined.value) == (TickKind.JOIN, "part", 5 * MS)
            plant.say(TickKind.TIME)
            await joining
            followed.ready()
            assert (await plant.heard()).kind is TickKind.READY
            await program(plant, followed)
            followed.leave()
            plant.close()

    followed = clock.PlantClock(("127.0.0.1", 1), "part")
    clock.use(followed)
    with asyncio.Runner(loop_factory=lambda: clock.IdleLoop(followed)) as runner:
        runner.run(asyncio.wait_for(act(followed), 20.0))


def test_what_is_due_is_done_by_ticks_alone_in_the_order_of_its_times() -> None:
    done: list[tuple[str, int]] = []

    async def program(plant: FakePlant, followed: clock.PlantClock) -> None:
        for name, later_ns in (
            ("third", 9 * MS),
            ("first", 2 * MS),
            ("second", 2 * MS + 1),
            ("never", 1 * MS),
        ):
            timer = followed.call_at(START_NS + later_ns, lambda n=name: done.append((n, clock.now_ns())))
            if name == "never":
                timer.cancel()
        await asyncio.sleep(0.05)
        assert done == [], "the wall has passed it, the plant has not"
        assert (await plant.tick()).kind is TickKind.DONE
        assert done == [("first", START_NS + 5 * MS), ("second", START_NS + 5 * MS)]
        plant.say(TickKind.TIME, later_ns=5 * MS)
        await asyncio.sleep(0.05)
        assert clock.now_ns() == START_NS + 10 * MS, "it is told the time before others act"
        assert len(done) == 2, "and does nothing yet"
        await plant.tick(later_ns=0)
        assert done[2] == ("third", START_NS + 10 * MS)
        assert followed.pace == 0.5

    following(program)


def test_a_tick_is_answered_when_all_that_follows_from_it_is_done() -> None:
    hops: list[int] = []

    async def program(plant: FakePlant, followed: clock.PlantClock) -> None:
        async def chain() -> None:
            await clock.sleep(0.004)
            for hop in range(50):
                hops.append(hop)
                await asyncio.sleep(0)
            with ThreadPoolExecutor(1) as pool, followed.holding():
                await asyncio.get_running_loop().run_in_executor(pool, time.sleep, 0.1)
            hops.append(-1)

        task = asyncio.create_task(chain())
        await asyncio.sleep(0)
        began_s = time.monotonic()
        assert (await plant.tick()).kind is TickKind.DONE
        assert hops == [*range(50), -1]
        assert time.monotonic() - began_s >= 0.1
        await task

    following(program)


def test_a_tick_waits_until_what_belongs_to_the_time_before_is_done() -> None:
    async def program(plant: FakePlant, followed: clock.PlantClock) -> None:
        with followed.holding():
            plant.say(TickKind.TICK, later_ns=5 * MS)
            await asyncio.sleep(0.05)
            assert clock.now_ns() == START_NS
        assert (await plant.heard()).kind is TickKind.DONE
        assert clock.now_ns() == START_NS + 5 * MS

    following(program)


def test_who_computes_for_long_says_so_and_its_thread_keeps_the_time_at_which_it_began() -> None:
    async def program(plant: FakePlant, followed: clock.PlantClock) -> None:
        def work() -> int:
            time.sleep(0.2)
            return clock.now_ns()

        with ThreadPoolExecutor(1) as pool:
            computed = asyncio.create_task(followed.computed(pool, work, 8 * MS))
            await asyncio.sleep(0)
            assert (await plant.tick()).kind is TickKind.DONE, "time passes meanwhile"
            held = await plant.tick()
            assert (held.kind, computed.done()) == (TickKind.HELD, False)
            assert (await plant.heard()).kind is TickKind.DONE
            assert await computed == START_NS

    following(program)


def test_what_the_plant_leaves_unanswered_is_given_up() -> None:
    async def program(plant: FakePlant, followed: clock.PlantClock) -> None:
        given_up = asyncio.Event()
        followed.in_vain = given_up.set

        async def exchange() -> None:
            with followed.holding():
                await given_up.wait()

        waiting = asyncio.create_task(exchange())
        await asyncio.sleep(0)
        plant.say(TickKind.TICK, later_ns=5 * MS)
        await asyncio.sleep(0.05)
        assert not waiting.done()
        answer = await plant.tick(IN_VAIN)
        assert (answer.kind, answer.number) == (TickKind.DONE, 2)
        assert waiting.done()

    following(program)


def test_a_tick_is_held_on_purpose_and_let_go() -> None:
    async def program(plant: FakePlant, followed: clock.PlantClock) -> None:
        goes = False
        followed.passes = lambda: goes
        held = await plant.tick()
        assert (held.kind, held.number) == (TickKind.HELD, 1)
        goes = True
        await asyncio.sleep(0.01)  # anything that the loop does
        assert (await plant.heard()).kind is TickKind.DONE

    following(program)


def test_what_is_asked_between_two_ticks_begins_at_the_one_that_is_held() -> None:
    async def program(plant: FakePlant, followed: clock.PlantClock) -> None:
        machine = MachineClock()
        machine.let_go(Goes.ON_REQUEST)
        assert (await plant.tick()).kind is TickKind.HELD
        async with machine.requested():
            began_ns = clock.now_ns()
            assert (await plant.heard()).kind is TickKind.DONE

        async def asked_again() -> int:
            async with machine.requested():
                return clock.now_ns() - began_ns

        again = asyncio.create_task(asked_again())
        await asyncio.sleep(0.02)
        assert not again.done(), "no tick is held yet"
        assert (await plant.tick()).kind is TickKind.HELD
        assert await again == 5 * MS

    following(program)


def test_pictures_are_counted_and_waited_for() -> None:
    async def program(plant: FakePlant, followed: clock.PlantClock) -> None:
        came = 0
        followed.ready_to_answer.append(lambda: came == followed.pictures)
        plant.say(TickKind.TICK, PICTURE, later_ns=5 * MS)
        with pytest.raises(TimeoutError):
            await plant.heard(0.1)
        came = 1
        await asyncio.sleep(0)
        assert (await plant.heard()).kind is TickKind.DONE

    following(program)


def test_who_stands_is_known_and_a_plant_that_was_started_anew_goes_on_from_there() -> None:
    async def program(plant: FakePlant, followed: clock.PlantClock) -> None:
        await plant.tick(later_ns=700 * MS)
        plant._writer.write(encode(ClockMessage(TickKind.STANDS, time_ns=3_000 * MS, name="controller")))
        await asyncio.sleep(0.05)
        assert followed.standing is not None
        assert followed.standing.waits_for == "controller"
        assert followed.standing.seconds == pytest.approx(3.0, abs=0.5)
        plant.close()
        await asyncio.sleep(0.05)
        assert clock.now_ns() == START_NS + 700 * MS, "it stands while there is no plant"

    following(program)


def test_after_leaving_the_wall_has_the_time_and_what_waited_is_done() -> None:
    done: list[int] = []

    async def program(plant: FakePlant, followed: clock.PlantClock) -> None:
        followed.call_at(START_NS + 20 * MS, lambda: done.append(clock.now_ns()))
        followed.leave()
        await asyncio.sleep(0.1)
        assert len(done) == 1
        assert done[0] >= START_NS + 20 * MS

    following(program)


def test_what_is_no_message_of_the_clock_is_refused() -> None:
    whole = encode(ClockMessage(TickKind.TICK, 7, START_NS, 1, PICTURE, "vision_pc"))
    assert decode(whole * 2 + b"rest") == (
        [ClockMessage(TickKind.TICK, 7, START_NS, 1, PICTURE, "vision_pc")] * 2,
        b"rest",
    )
    for at in (0, 3, 4):
        broken = bytearray(whole)
        broken[at] ^= 0xFF
        with pytest.raises(LinkLost) as refused:
            decode(bytes(broken))
        assert refused.value.cause == "link.clock_place"


@pytest.mark.parametrize("named", ["47200", "host:", ":47200", "host:0", "host:65536", "host:x"])
def test_an_address_that_is_none_is_refused(named: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(clock.CLOCK, named)
    with pytest.raises(ConfigurationError, match="is not HOST:PORT"):
        clock.follow("part")
