"""Soft real time: absolute deadlines, missed periods skipped and counted, never caught up."""

import asyncio
import time

import pytest

from foundation.configuration import load
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core.plant import Plant
from plant_emulator.shell.ticker import Integrator, SlowCycle
from tests.plant_emulator.camera.camera_world import CONFIGS

pytestmark = pytest.mark.realtime

PERIOD_NS = 2_000_000


async def test_simulated_time_follows_the_periods_served() -> None:
    plant = Plant(load(PlantConfig, CONFIGS / "plant.yaml"), 1)
    plant.advance(PERIOD_NS)
    start_ns = plant.time_ns
    deadlines: list[int] = []

    def step(deadline_ns: int) -> None:
        plant.advance(PERIOD_NS)
        deadlines.append(deadline_ns)

    integrator = Integrator(PERIOD_NS, step)
    integrator.start()
    await asyncio.sleep(0.1)
    time.sleep(0.02)  # noqa: ASYNC251 - the loop must be blocked to miss periods
    await asyncio.sleep(0.05)
    integrator.stop()
    figures = integrator.as_dict()
    assert plant.time_ns - start_ns == len(deadlines) * PERIOD_NS
    assert figures["periods_served"] == len(deadlines)
    assert figures["periods_missed"] >= 8
    skipped = (deadlines[-1] - deadlines[0]) // PERIOD_NS + 1 - len(deadlines)
    assert skipped >= 8
    assert 0 <= figures["periods_missed"] - skipped <= 20  # what was missed before the first one served
    assert figures["late_max_us"] > 17_000.0


def test_slow_cycles_come_at_their_rate_and_late_ones_are_dropped() -> None:
    cycle = SlowCycle(10)
    assert [now for now in range(100, 141) if cycle.due(now)] == [100, 110, 120, 130, 140]
    assert cycle.dropped == 0
    assert cycle.due(175)
    assert cycle.dropped == 2
    assert not cycle.due(179)
    assert cycle.due(180)
