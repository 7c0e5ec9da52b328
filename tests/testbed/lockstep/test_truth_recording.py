"""Lockstep leaves the recording that the emulator's process leaves, and is not changed by it."""

from pathlib import Path

import numpy as np

from plant_emulator.core.faults.kinds import SupplyLost
from plant_emulator.core.truth import PlantTruth
from plant_emulator.shell.recording import Recording, read_truth
from testbed.lockstep.clock import RunLog
from testbed.lockstep.world import World
from testbed.scenarios.scenario import load_settings
from tests.support.paths import CONFIGS

SETTINGS = load_settings(CONFIGS, {})


def run(record: Path | None) -> World:
    """Half a second of a world that loses its supply."""
    world = World(SETTINGS, 1, RunLog())
    if record is not None:
        world.record_in(record, "7")
    world.plant.inject(SupplyLost(), start_ns=200_000_000)
    for _ in range(100):
        world.step()
    if world.recording is not None:
        world.recording.close()
    return world


def same(a: PlantTruth, b: PlantTruth) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in PlantTruth._fields)


def check_whole(recording: Recording, world: World) -> None:
    """Every truth of the world is there once, every fifth with its frame, and the fault."""
    assert recording.complete
    assert [record.log_ns for record in recording.truths] == [truth.time_ns for truth in world.truths]
    assert all(
        same(record.truth, truth) for record, truth in zip(recording.truths, world.truths, strict=True)
    )
    frames = {r.log_ns: r.frame_id for r in recording.truths if r.frame_id is not None}
    assert frames == {number * 100_000_000: number for number in range(1, 6)}
    (fault,) = recording.faults
    assert (fault.name, fault.began_ns) == ("supply_lost", 200_000_000)
    assert recording.run["scene"]["camera"]["lens"]["fx_px"] == SETTINGS.scene.camera.lens.fx_px


def test_a_recorded_run_is_the_same_run_and_gives_the_same_bytes_again(tmp_path: Path) -> None:
    first, again, unseen = run(tmp_path / "1.mcap"), run(tmp_path / "2.mcap"), run(None)
    assert len(unseen.truths) == 25
    assert all(same(a, b) for a, b in zip(first.truths, unseen.truths, strict=True))
    assert (tmp_path / "1.mcap").read_bytes() == (tmp_path / "2.mcap").read_bytes()
    assert first.log.digest() == again.log.digest() == unseen.log.digest()
    check_whole(read_truth(tmp_path / "1.mcap"), unseen)
