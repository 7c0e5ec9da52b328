"""Simulated time: the foreground lets it pass, the background goes on in it, and nothing waits outside."""

import asyncio

import pytest

from testbed.lockstep.clock import LockstepClock, run

CYCLE_NS = 5_000_000


class Ticks:
    """A world in which nothing but time passes."""

    def __init__(self) -> None:
        self.time_ns = 0

    @property
    def vision_ns(self) -> int:
        return self.time_ns

    def step(self) -> None:
        self.time_ns += CYCLE_NS


@pytest.fixture
def clock() -> LockstepClock:
    return LockstepClock(Ticks())


def test_waiting_lets_cycles_pass_until_it_has_happened_or_the_time_is_over(clock: LockstepClock) -> None:
    assert run(clock.until(lambda: clock.time_ns >= 3 * CYCLE_NS, 1.0))
    assert clock.time_ns == 3 * CYCLE_NS
    assert not run(clock.until(lambda: False, 0.02))
    assert clock.time_ns == 7 * CYCLE_NS


def test_a_program_in_the_background_goes_on_while_the_foreground_waits(clock: LockstepClock) -> None:
    seen: list[int] = []

    async def beside() -> None:
        for _ in range(3):
            began_ns = clock.now_ns
            await clock.until(lambda began_ns=began_ns: clock.now_ns >= began_ns + 2 * CYCLE_NS, 1.0)  # type: ignore[misc]
            seen.append(clock.now_ns // CYCLE_NS)

    clock.start(beside())
    assert run(clock.until(lambda: len(seen) == 2, 1.0))
    assert seen == [2, 4]
    assert run(clock.until(lambda: len(seen) == 3, 1.0))
    assert seen == [2, 4, 6]


def test_a_cancelled_program_ends_where_it_waits(clock: LockstepClock) -> None:
    ended: list[str] = []

    async def endless() -> None:
        try:
            await clock.until(lambda: False, 100.0)
        finally:
            ended.append("cleaned up")

    end = clock.start(endless())
    for _ in range(2):  # once it has ended there is nothing to end
        run(end())
        clock.advance()
    assert ended == ["cleaned up"]


def test_a_program_that_waits_outside_of_simulated_time_is_found_out(clock: LockstepClock) -> None:
    async def sleeps() -> None:
        await asyncio.sleep(0)

    with pytest.raises(RuntimeError, match="outside of simulated time"):
        run(sleeps())
    with pytest.raises(RuntimeError, match="outside of simulated time"):
        clock.start(sleeps())


def test_the_background_cannot_let_time_pass(clock: LockstepClock) -> None:
    async def greedy() -> None:
        clock.advance()

    with pytest.raises(RuntimeError, match="only the foreground"):
        clock.start(greedy())
