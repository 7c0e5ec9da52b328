"""Soft real time: absolute deadlines, missed periods skipped and counted, never caught up."""

import asyncio
import os
import time
from itertools import pairwise

import pytest

from foundation.configuration import load
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core.plant import Plant
from plant_emulator.shell.integrator import Beat, Integrator
from plant_emulator.shell.lateness import Lateness
from plant_emulator.shell.timer import PeriodicTimer
from tests.plant_emulator.camera.camera_world import CONFIGS

PERIOD_NS = 2_000_000


async def test_the_timer_keeps_its_grid_and_tells_what_it_missed() -> None:
    ticks: list[tuple[int, int]] = []
    first = time.monotonic_ns() + PERIOD_NS
    timer = PeriodicTimer(first, PERIOD_NS, lambda deadline, missed: ticks.append((deadline, missed)))
    await asyncio.sleep(0.05)
    time.sleep(0.03)  # noqa: ASYNC251 - the loop must be blocked to miss periods
    await asyncio.sleep(0.05)
    timer.close()
    count = len(ticks)
    await asyncio.sleep(0.01)
    assert len(ticks) == count
    assert all((deadline - first) % PERIOD_NS == 0 for deadline, _ in ticks)
    for (before, _), (after, missed) in pairwise(ticks):
        assert after - before == (missed + 1) * PERIOD_NS
    assert max(missed for _, missed in ticks) >= 13
    assert sum(missed for _, missed in ticks) + count == (ticks[-1][0] - first) // PERIOD_NS + 1


async def test_closing_a_timer_frees_its_descriptor() -> None:
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(20):
        timer = PeriodicTimer(time.monotonic_ns(), PERIOD_NS, lambda deadline, missed: None)
        timer.close()
        timer.close()
    assert len(os.listdir("/proc/self/fd")) == before


async def test_simulated_time_follows_the_periods_served() -> None:
    plant = Plant(load(PlantConfig, CONFIGS / "plant.yaml"), 1)
    plant.advance(PERIOD_NS)
    start_ns = plant.time_ns
    deadlines: list[int] = []
    integrator = Integrator(plant, PERIOD_NS, deadlines.append)
    integrator.start()
    await asyncio.sleep(0.1)
    time.sleep(0.02)  # noqa: ASYNC251 - the loop must be blocked to miss periods
    await asyncio.sleep(0.05)
    integrator.stop()
    figures = integrator.lateness.as_dict()
    assert plant.time_ns - start_ns == len(deadlines) * PERIOD_NS
    assert figures["periods_served"] == len(deadlines)
    assert figures["periods_missed"] >= 8
    skipped = (deadlines[-1] - deadlines[0]) // PERIOD_NS + 1 - len(deadlines)
    assert skipped >= 8
    assert 0 <= figures["periods_missed"] - skipped <= 20  # what was missed before the first one served
    assert figures["late_max_us"] > 17_000.0


def test_beats_come_at_their_rate_and_late_ones_are_dropped() -> None:
    beat = Beat(10)
    assert [now for now in range(100, 141) if beat.due(now)] == [100, 110, 120, 130, 140]
    assert beat.dropped == 0
    assert beat.due(175)
    assert beat.dropped == 2
    assert not beat.due(179)
    assert beat.due(180)


def test_lateness_percentiles_are_exact_to_a_microsecond() -> None:
    lateness = Lateness()
    for microseconds in range(1000):
        lateness.add(microseconds * 1000, 0)
    lateness.add(50_000_000, 3)
    assert lateness.percentile_us(0.5) == pytest.approx(500.0, abs=1.0)
    assert lateness.percentile_us(0.99) == pytest.approx(991.0, abs=1.0)
    assert lateness.percentile_us(1.0) == 50_000.0
    figures = lateness.as_dict()
    assert figures["periods_missed"] == 3
    assert figures["missed_percent"] == pytest.approx(100.0 * 3 / 1004)


def test_lateness_before_the_first_period_is_zero() -> None:
    assert Lateness().as_dict()["late_p99_us"] == 0.0
