"""The plant's clock as the plant gives it: it goes on when every part has answered, and names who has not."""

import asyncio
import io
import json
import socket
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from foundation.clock import PACE, GivenClock
from foundation.event_log import EventLog
from plant_emulator.shell.ticker import GONE_NS, PARTS, Ticker, TickerBody, greatest_pace
from protocol.errors import ConfigurationError
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

MS = 1_000_000
PERIOD_NS = 5 * MS


class Part:
    """A part that answers when a test says so; ``heard``: all that it was told."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer
        self.heard: list[ClockMessage] = []

    def say(self, kind: TickKind, number: int = 0, name: str = "", time_ns: int = 0, value: int = 0) -> None:
        """Send one message."""
        self._writer.write(encode(ClockMessage(kind, number, time_ns, value, 0, name)))

    async def hear(self, kind: TickKind) -> ClockMessage:
        """The next message of that kind."""
        while True:
            data = await asyncio.wait_for(self._reader.readexactly(MESSAGE_BYTES), 10.0)
            self.heard += decode(data)[0]
            if self.heard[-1].kind is kind:
                return self.heard[-1]

    async def answer(self, kind: TickKind = TickKind.DONE) -> ClockMessage:
        """The next tick, once it is answered."""
        tick = await self.hear(TickKind.TICK)
        self.say(kind, tick.number)
        return tick

    def close(self) -> None:
        """Be gone."""
        self._writer.transport.abort()


class Machine:
    """A ticker and what it does: ``passed`` at each tick, ``pictures`` that are published."""

    def __init__(self, pace: float | None) -> None:
        self.passed: list[int] = []
        self.pictures: set[int] = set()
        self.clock = GivenClock()
        self.log = io.StringIO()
        body = TickerBody(self._begins, self.passed.append, self._published, lambda: None)
        self.events = EventLog("plant_emulator", self.log)
        self.ticker = Ticker(self.clock, PERIOD_NS, pace, body, self.events)
        self.address = "", 0
        self.parts: list[Part] = []

    async def part(self, name: str, ready: bool = True, time_ns: int = START_NS, period_ns: int = 0) -> Part:
        """A part of that name, which was told the time."""
        part = Part(*await asyncio.open_connection(*self.address))
        self.parts.append(part)
        part.say(TickKind.JOIN, name=name, time_ns=time_ns, value=period_ns)
        await part.hear(TickKind.TIME)
        if ready:
            part.say(TickKind.READY)
        return part

    async def _begins(self) -> None:
        assert self.passed == []

    async def _published(self, now_ns: int) -> bool:
        return now_ns in self.pictures


@asynccontextmanager
async def machine(pace: float | None = None) -> AsyncIterator[Machine]:
    made = Machine(pace)
    bound = socket.create_server(("127.0.0.1", 0))
    made.address = bound.getsockname()
    await made.ticker.start(bound)
    try:
        yield made
    finally:
        await made.ticker.stop()
        for part in made.parts:
            part.close()
        await asyncio.sleep(0.01)  # the transports close in the loop
        made.events.close()


async def test_time_begins_when_all_are_there_and_goes_on_when_all_have_answered() -> None:
    async with machine() as made:
        controller = await made.part("controller", period_ns=PERIOD_NS)
        await asyncio.sleep(0.1)
        assert made.passed == []
        vision = await made.part("vision_pc")
        tick = await vision.hear(TickKind.TICK)
        assert (tick.number, tick.time_ns) == (1, START_NS + PERIOD_NS)
        assert (await controller.hear(TickKind.TIME)).time_ns == tick.time_ns, (
            "who acts last knows the time too"
        )
        await asyncio.sleep(0.1)
        assert [one.kind for one in controller.heard] == [TickKind.TIME, TickKind.TIME], "it is not its turn"
        vision.say(TickKind.DONE, tick.number)
        await controller.answer()
        assert (await vision.answer()).number == 2
        assert made.passed == [PERIOD_NS] * 2


async def test_an_answer_to_another_tick_is_none() -> None:
    async with machine() as made:
        controller, vision = [await made.part(name) for name in PARTS]
        tick = await vision.hear(TickKind.TICK)
        vision.say(TickKind.DONE, tick.number - 1)
        vision.say(TickKind.DONE, tick.number + 1)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.2):
                await controller.hear(TickKind.TICK)


async def test_who_has_gone_is_not_waited_for_and_may_come_again() -> None:
    async with machine() as made:
        controller, vision = [await made.part(name) for name in PARTS]
        await vision.hear(TickKind.TICK)
        vision.close()
        assert [(await controller.answer()).number for _ in range(3)] == [1, 2, 3]
        again = await made.part("vision_pc")
        answering = asyncio.create_task(controller.answer())
        assert (await again.answer()).time_ns > START_NS + 3 * PERIOD_NS
        await answering


async def test_who_goes_while_another_acts_is_not_waited_for() -> None:
    async with machine() as made:
        controller, vision = [await made.part(name) for name in PARTS]
        tick = await vision.hear(TickKind.TICK)
        made.ticker.changed.clear()
        controller.close()
        await made.ticker.changed.wait()
        vision.say(TickKind.DONE, tick.number)
        async with asyncio.timeout(5.0):
            assert (await vision.answer()).number == tick.number + 1


async def test_nothing_runs_ahead_of_the_wall_and_nothing_is_made_up_for() -> None:
    async with machine(pace=1.0) as made:
        controller, vision = [await made.part(name) for name in PARTS]
        began_s = time.monotonic()
        for _ in range(20):
            await vision.answer()
            await controller.answer()
        assert time.monotonic() - began_s >= 19 * 1e-9 * PERIOD_NS - 0.02
        await vision.hear(TickKind.TICK)
        await asyncio.sleep(0.5)  # this part is slow once
        vision.say(TickKind.DONE, 21)
        await controller.answer()
        began_s = time.monotonic()
        for _ in range(20):
            await vision.answer()
            await controller.answer()
        assert time.monotonic() - began_s >= 19 * 1e-9 * PERIOD_NS - 0.03, "half a second is not run after"


async def test_a_picture_is_told_to_all_at_its_time() -> None:
    async with machine() as made:
        made.pictures = {START_NS + 2 * PERIOD_NS}
        controller, vision = [await made.part(name) for name in PARTS]
        flags = []
        for _ in range(3):
            flags.append((await vision.answer()).flags)
            assert (await controller.answer()).flags == flags[-1]
        assert flags == [0, PICTURE, 0]


async def test_a_controller_that_asks_in_vain_is_not_waited_for_and_told_so() -> None:
    async with machine() as made:
        controller, vision = [await made.part(name) for name in PARTS]
        await vision.answer()
        await controller.hear(TickKind.TICK)
        made.ticker.leave_unanswered()
        await vision.answer()
        assert (await controller.answer()).flags == IN_VAIN
        await vision.answer()
        assert (await controller.answer()).flags == 0


async def test_a_plant_that_was_started_anew_begins_later_than_its_parts_have_been() -> None:
    async with machine() as made:
        await made.part("controller", time_ns=START_NS + 77 * MS)
        vision = await made.part("vision_pc")
        assert (await vision.hear(TickKind.TICK)).time_ns == START_NS + 77 * MS + GONE_NS + PERIOD_NS


@pytest.mark.slow("two seconds of silence, twice")
async def test_who_does_not_answer_is_named_and_who_holds_the_clock_is_not() -> None:
    async with machine() as made:
        controller, vision = [await made.part(name) for name in PARTS]
        await vision.answer(TickKind.HELD)
        await asyncio.sleep(3.0)
        assert "clock.unanswered" not in made.log.getvalue(), "it is held on purpose"
        vision.say(TickKind.DONE, 1)
        await controller.hear(TickKind.TICK)
        stands = await vision.hear(TickKind.STANDS)
        assert (stands.name, stands.time_ns >= 2_000 * MS) == ("controller", True)
        controller.say(TickKind.DONE, 1)
        while (await vision.hear(TickKind.TICK)).number < 2:
            pass
        vision.say(TickKind.DONE, 2)
        await asyncio.sleep(1.0)
        lines = [json.loads(line) for line in made.log.getvalue().splitlines()]
        named = next(line for line in lines if line["event"] == "clock_stands")
        assert (named["cause"], "controller" in named["detail"]) == ("clock.unanswered", True)
        assert lines[-1]["event"] == "clock_goes_on"


@pytest.mark.parametrize(("name", "period_ns"), [("stranger", 0), ("controller", 1), ("controller", 10**9)])
async def test_a_part_that_is_none_and_a_period_out_of_range_are_refused(name: str, period_ns: int) -> None:
    async with machine() as made:
        with pytest.raises(asyncio.IncompleteReadError):
            await made.part(name, period_ns=period_ns)


async def test_bytes_that_are_no_message_end_the_connection_alone() -> None:
    async with machine() as made:
        controller, vision = [await made.part(name) for name in PARTS]
        _, stranger = await asyncio.open_connection(*made.address)
        stranger.write(b"GET / HTTP/1.1\r\nHost: there\r\nand some more of that kind\r\n\r\n")
        for _ in range(3):
            await vision.answer()
            await controller.answer()
        stranger.close()


@pytest.mark.parametrize(("named", "pace"), [("max", None), ("1", 1.0), ("0.25", 0.25)])
def test_the_pace_is_a_number_or_the_most_there_is(
    named: str, pace: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(PACE, named)
    assert greatest_pace() == pace


@pytest.mark.parametrize("named", ["0", "-1", "fast", "nan", "inf"])
def test_a_pace_that_is_none_is_refused(named: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PACE, named)
    with pytest.raises(ConfigurationError, match="neither max nor a number above 0"):
        greatest_pace()
