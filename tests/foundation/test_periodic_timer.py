"""Absolute deadlines: the grid is kept, and what was missed is counted, never caught up."""

import asyncio
import os
import time
from itertools import pairwise

from foundation.periods import PeriodicTimer

PERIOD_NS = 2_000_000


async def test_the_timer_keeps_its_grid_and_counts_what_passed() -> None:
    ticks: list[tuple[int, int]] = []
    first = time.monotonic_ns() + PERIOD_NS

    def ready() -> None:
        passed = timer.passed()
        ticks.append((timer.deadline_ns, passed))

    timer = PeriodicTimer(first, PERIOD_NS, ready)
    await asyncio.sleep(0.05)
    time.sleep(0.03)  # noqa: ASYNC251 - the loop must be blocked to miss periods
    await asyncio.sleep(0.05)
    timer.close()
    count = len(ticks)
    await asyncio.sleep(0.01)
    assert len(ticks) == count
    assert all((deadline - first) % PERIOD_NS == 0 for deadline, _ in ticks)
    for (before, _), (after, passed) in pairwise(ticks):
        assert after - before == passed * PERIOD_NS
    assert max(passed for _, passed in ticks) >= 14
    assert sum(passed for _, passed in ticks) == (ticks[-1][0] - first) // PERIOD_NS + 1


async def test_asking_too_early_returns_nothing_and_keeps_the_deadline() -> None:
    first = time.monotonic_ns() + 10**12
    timer = PeriodicTimer(first, PERIOD_NS, lambda: None)
    assert timer.passed() == 0
    assert timer.deadline_ns == first - PERIOD_NS
    timer.close()


async def test_closing_a_timer_frees_its_descriptor() -> None:
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(20):
        timer = PeriodicTimer(time.monotonic_ns(), PERIOD_NS, lambda: None)
        timer.close()
        timer.close()
    assert len(os.listdir("/proc/self/fd")) == before
