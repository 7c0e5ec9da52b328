"""The machine in lockstep on an event loop: programs wait in its time, which may stand or be slow."""

import asyncio
import time
from collections.abc import Awaitable, Callable

import pytest

from longreach_ros2.lockstep import CLOCK_NS, SimulatedMachine
from protocol.faults import CommandCode, Reason
from tests.support.paths import CONFIGS


def beside(machine: SimulatedMachine, pace: float, program: Callable[[], Awaitable[None]]) -> list[int]:
    """The times that were published while ``program`` ran."""
    times: list[int] = []

    async def both() -> None:
        running = asyncio.ensure_future(machine.run(pace, times.append))
        try:
            await asyncio.wait_for(program(), 60.0)
        finally:
            running.cancel()

    asyncio.run(both())
    return times


def test_programs_wait_and_give_up_in_simulated_time() -> None:
    async def program() -> None:
        assert await machine.until(lambda: machine.link.connected, 5.0)
        assert (await machine.link.command(CommandCode.ENABLE)).reason is Reason.ACCEPTED
        before_ns = machine.now_ns
        assert not await machine.until(lambda: False, 3.0)
        assert machine.now_ns - before_ns == pytest.approx(3e9, abs=1e7)

    machine = SimulatedMachine(CONFIGS, {})
    times = beside(machine, 0.0, program)
    assert times == list(range(CLOCK_NS, times[-1] + 1, CLOCK_NS))


@pytest.mark.slow("a pace and a pause are of real time")
def test_a_pace_is_kept_and_a_pause_stands() -> None:
    async def program() -> None:
        start_s, start_ns = time.monotonic(), machine.time_ns
        await asyncio.sleep(1.0)
        passed_s, real_s = 1e-9 * (machine.time_ns - start_ns), time.monotonic() - start_s
        assert 0.0 < passed_s <= 0.2 * real_s + 0.02, "never faster than asked"
        machine.pause(True)
        await asyncio.sleep(0.1)
        stands_ns = machine.time_ns
        await asyncio.sleep(1.5)
        assert machine.time_ns == stands_ns
        machine.pause(False)
        await machine.until(lambda: machine.time_ns > stands_ns, 1.0)

    machine = SimulatedMachine(CONFIGS, {})
    times = beside(machine, 0.2, program)
    assert len(times) > len(set(times)), "the time that stands is published again, for nodes that come then"
