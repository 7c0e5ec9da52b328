"""Faults of the plant planned in simulated time: what controller and camera get, the same in every rerun."""

import numpy as np

from plant_emulator.core.faults.kinds import CouplerSilent, Fault, FramesDropped, ValveSlow
from protocol.faults import CommandCode, FaultCode, GroupState
from protocol.process_image import STATUS_WATCHDOG_TRIPPED
from protocol.reference_messages import Command, ReferencePose
from testbed.lockstep.clock import RunLog
from testbed.lockstep.world import World
from testbed.scenarios.scenario import chosen_overrides, load_settings
from tests.support.paths import CONFIGS

MS = 1_000_000


def world_of(seed: int, *assignments: str) -> World:
    """A world that has connected."""
    settings = load_settings(CONFIGS, chosen_overrides(CONFIGS, "standard", seed, list(assignments)))
    world = World(settings, seed, RunLog())
    world.connect()
    return world


def until(world: World, time_ns: int) -> None:
    """Step the world until it has reached ``time_ns``."""
    while world.time_ns < time_ns:
        world.clock.advance()


def moving(seed: int) -> World:
    """A world whose arm is on its way, 500 ms after its start."""
    world = world_of(seed)
    world.link.submit(Command(0, CommandCode.ENABLE))
    until(world, 200 * MS)
    here = world.states[-1].X_BT
    x, y, z = here.p_m
    world.link.submit(ReferencePose(0, here._replace(p_m=(x, y + 0.5, z - 0.2)), 0.0))
    until(world, 500 * MS)
    assert world.states[-1].group_state is GroupState.MOVING
    return world


def test_a_silent_coupler_faults_the_controller_and_the_plants_own_watchdog_shuts_the_valves() -> None:
    world = moving(1)
    assert np.abs(world.plant.truth().valves).max() > 0.0
    world.plant.inject(CouplerSilent(), start_ns=600 * MS, duration_ns=500 * MS)
    until(world, 595 * MS)
    assert world.states[-1].fault is FaultCode.NONE
    shut_ns = 0
    while world.time_ns < 1_000 * MS:
        world.clock.advance()
        if shut_ns == 0 and not world.plant.truth().valves.any():
            shut_ns = world.time_ns
    assert 600 * MS < shut_ns <= (600 + 100 + 5 + 5) * MS  # silence, watchdog, drive's delay, one cycle
    assert world.states[-1].fault is FaultCode.PLANT_LINK_LOST
    assert world.states[-1].group_state is GroupState.ERROR_STOP
    assert world.plant.read().status & STATUS_WATCHDOG_TRIPPED
    resting = world.plant.truth().X_WT[:3, 3]
    until(world, 2_000 * MS)  # it speaks again: nothing moves by itself
    assert world.states[-1].group_state is GroupState.ERROR_STOP
    assert np.linalg.norm(world.plant.truth().X_WT[:3, 3] - resting) < 5e-3


def test_planned_faults_rerun_to_the_last_bit() -> None:
    faults: list[Fault] = [ValveSlow(joint="lift", bandwidth_share=0.2), FramesDropped(share=0.5)]
    seen = []
    for planned in (faults, faults, []):
        world = moving(2)
        frames: list[int] = []
        world.camera.viewers.append(lambda exposure, frames=frames: frames.append(exposure.shot.frame_id))  # type: ignore[misc]
        for fault in planned:
            world.plant.inject(fault, start_ns=613 * MS, duration_ns=401 * MS)
        until(world, 1_500 * MS)
        seen.append(
            (world.log.digest(), world.plant.truth().q.tolist(), world.plant.truth().pressures.tolist())
        )
        changes = [(c.phase, c.time_ns) for c in world.plant.faults.changes]
        assert changes == [
            (phase, at) for phase, at in (("planned", 500 * MS), ("began", 613 * MS), ("ended", 1014 * MS))
            for _ in planned
        ]  # fmt: skip
        told = [(e["phase"], e["name"]) for e in world.log.events if e["event"] == "fault"]
        assert told == [(c.phase, c.injection.fault.name) for c in world.plant.faults.changes]
    assert seen[0] == seen[1]
    assert seen[0][1] != seen[2][1]
