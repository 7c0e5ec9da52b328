"""The cycle: absolute deadlines, skipped and counted periods."""

import asyncio
import os
import time

import pytest

from controller.shell.cyclic_task import CyclicTask

pytestmark = pytest.mark.realtime


async def test_periods_are_absolute_and_none_is_lost() -> None:
    stamps: list[int] = []

    async def body(dt_ns: int) -> None:
        stamps.append(time.monotonic_ns())
        if len(stamps) == 40:
            task.stop()

    task = CyclicTask(5_000_000, body)
    await task.run()
    periods = 39 + task.overruns
    assert (stamps[-1] - stamps[0]) / 5e6 == pytest.approx(periods, abs=3.0)
    assert task.lateness.count == 40
    assert task.lateness.percentiles_us(0.5)[0] < 5000


async def test_missed_periods_are_skipped_counted_and_told() -> None:
    told: list[int] = []

    async def body(dt_ns: int) -> None:
        told.append(dt_ns)
        if len(told) == 3:
            time.sleep(0.052)  # noqa: ASYNC251 - holds the loop for ten periods on purpose
        if len(told) == 6:
            task.stop()

    task = CyclicTask(5_000_000, body)
    await task.run()
    assert task.overruns >= 9
    assert told[3] >= 10 * 5_000_000
    assert all(dt_ns % 5_000_000 == 0 for dt_ns in told)
    assert sum(told) == (len(told) + task.overruns) * 5_000_000


async def test_a_failing_body_ends_the_task_with_its_exception() -> None:
    async def body(dt_ns: int) -> None:
        raise ValueError("broken")

    open_files = len(os.listdir("/proc/self/fd"))
    with pytest.raises(ValueError, match="broken"):
        await CyclicTask(1_000_000, body).run()
    assert len(os.listdir("/proc/self/fd")) == open_files


async def test_stop_from_outside_ends_a_waiting_task() -> None:
    async def body(dt_ns: int) -> None:
        return

    task = CyclicTask(10_000_000_000, body)
    running = asyncio.ensure_future(task.run())
    await asyncio.sleep(0.02)
    task.stop()
    await asyncio.wait_for(running, 1.0)


async def test_the_second_part_of_a_period_begins_at_its_phase_and_not_before() -> None:
    into_ms: list[float] = []

    async def body(dt_ns: int) -> None:
        began_ns = time.monotonic_ns()
        if len(into_ms) == 10:
            time.sleep(0.009)  # noqa: ASYNC251 - the phase is over before the body asks for it
        await task.second_part()
        into_ms.append((time.monotonic_ns() - began_ns) / 1e6)
        if len(into_ms) == 20:
            task.stop()

    task = CyclicTask(10_000_000, body, 7_000_000)
    await task.run()
    late_ms = task.lateness.max_ns / 1e6
    assert min(into_ms) >= 7.0 - late_ms
    assert into_ms[10] >= 9.0
    assert sorted(into_ms)[10] == pytest.approx(7.0, abs=2.0)
