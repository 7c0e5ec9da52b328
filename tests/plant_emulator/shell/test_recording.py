"""The truth recording: every number comes back, and what a kill leaves behind is read up to the cut."""

import os
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np

from foundation.recording.decoding import messages
from foundation.recording.messages import fields_of
from plant_emulator.core.faults.kinds import SupplyLost, ValveSlow
from plant_emulator.core.faults.schedule import FaultSchedule
from plant_emulator.core.truth import PlantTruth
from plant_emulator.shell.truth_recorder import EVENT, TruthRecorder
from testbed.recordings.plant_truth import FaultRecord, read_truth

RUN = {"plant": {"step_ms": 0.5}, "scene": {"seed": 7}}


def truth(number: int) -> PlantTruth:
    """A truth whose every number differs from every other's."""
    generator = np.random.default_rng(number)
    shapes = {
        "q": 6, "q_rate": 6, "deflections": 4, "p_CM": 3, "p_CO": 3, "valves": 6, "spools": 6,
        "X_BT": (4, 4), "X_WB": (4, 4), "X_WT": (4, 4), "X_WC": (4, 4), "X_WM": (4, 4), "X_WO": (4, 4),
        "R_CM": (3, 3), "R_CO": (3, 3), "pressures": (6, 2), "flows": (6, 2),
    }  # fmt: skip
    return PlantTruth(
        time_ns=number * 1_000_000,
        supply=1.9e7 + number,
        oil_temperature_degc=40.0 + 0.1 * number,
        payload_kg=12.5,
        faults=("supply_lost", "valve_stuck.lift") if number % 2 else (),
        **{name: generator.standard_normal(shape) for name, shape in shapes.items()},
    )


def same(a: PlantTruth, b: PlantTruth) -> bool:
    """Whether two truths are equal to the last bit."""
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in PlantTruth._fields)


def write(path: Path, count: int = 50) -> TruthRecorder:
    """A recorder that has written ``count`` truths, every fifth a capture, and an event."""
    recorder = TruthRecorder(path, RUN)
    for number in range(count):
        if number % 5 == 4:
            recorder.capture(truth(number), 1000 + number, number // 5)
        else:
            recorder.truth(truth(number), 1000 + number)
    recorder.event({"event": "status", "status": 3}, 2000, 99)
    for number, change in enumerate(troubled().changes):
        recorder.fault(change, 3000 + number)
    return recorder


def troubled() -> FaultSchedule:
    """A schedule that has seen every phase: one fault over, one withdrawn, one in force."""
    schedule = FaultSchedule()
    schedule.inject(ValveSlow(joint="lift", bandwidth_share=0.25), 10, duration_ns=40)
    schedule.inject(SupplyLost(), 10, 60)
    schedule.settle(10)
    schedule.settle(50)
    schedule.clear(2, 55)
    schedule.inject(SupplyLost(), 58)
    schedule.settle(58)
    return schedule


def test_everything_comes_back(tmp_path: Path) -> None:
    write(tmp_path / "truth.mcap").close()
    recording = read_truth(tmp_path / "truth.mcap")
    assert recording.complete
    assert recording.run == RUN
    assert [record.log_ns for record in recording.truths] == list(range(1000, 1050))
    assert [record.frame_id for record in recording.truths[:10]] == [*[None] * 4, 0, *[None] * 4, 1]
    assert all(same(record.truth, truth(number)) for number, record in enumerate(recording.truths))
    ((_, event),) = messages(tmp_path / "truth.mcap", (EVENT,))
    assert (event.log_time, event.publish_time) == (2000, 99)
    assert fields_of(event.data) == {"event": "status", "status": 3}
    slow = {"kind": "valve_slow", "joint": "lift", "bandwidth_share": 0.25}
    lost = {"kind": "supply_lost"}
    assert recording.faults == (
        FaultRecord(2, "supply_lost", lost, 3000, None, None),  # the first one heard of, as it was planned
        FaultRecord(1, "valve_slow.lift", slow, 3001, 10, 50),
        FaultRecord(3, "supply_lost", lost, 3004, 58, None),
    )
    assert recording.stacked("X_BT").shape == (50, 4, 4)
    assert recording.stacked("p_CM").shape == (50, 3)
    assert recording.log_ns()[-1] == 1049


def eventually(said: Callable[[], bool]) -> None:
    """Return once ``said`` is true. Fails after 30 s."""
    limit = time.monotonic() + 30.0
    while not said():
        assert time.monotonic() < limit
        time.sleep(0.01)


def test_a_full_disk_ends_the_recording_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "truth.mcap"
    with closing(TruthRecorder(path, {})) as recorder:
        recorder.capture(truth(0), 5_000_000_000, 1)
        eventually(lambda: len(read_truth(path).truths) == 1)
        full = os.open("/dev/full", os.O_WRONLY)
        os.dup2(full, recorder.sink._file._file.fileno())
        os.close(full)
        recorder.capture(truth(1), 11_000_000_000, 2)
        eventually(lambda: recorder.sink.failure == "No space left on device")
        recorder.capture(truth(2), 11_100_000_000, 3)
    (kept,) = read_truth(path).truths
    assert kept.frame_id == 1
