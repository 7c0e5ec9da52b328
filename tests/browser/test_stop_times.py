"""What a recording of scans says of a stop, by scans that are made up."""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from controller.config import ControllerConfig
from controller.core.scan_program import ScanProgram
from controller.core.scan_types import ScanInput
from controller.shell.scan_recorder import FILE, ScanRecorder
from foundation.configuration import load
from foundation.event_log import EventLog
from nominal_arm.description import NominalArm
from protocol.faults import GroupState
from tests.browser.stop_times import Scans, StopTimes, read_scans, standby_openings, stop_times
from tests.support.paths import CONFIGS

STANDBY, MOVING, STOPPING, ERROR = (
    GroupState.STANDBY, GroupState.MOVING, GroupState.STOPPING, GroupState.ERROR_STOP
)  # fmt: skip
PERIOD_NS = 5_000_000
HELD, DRIVEN = 0.02, 0.5  # openings


def scans(*phases: tuple[GroupState, int, float]) -> Scans:
    """Of phases (state, how many scans, opening of the lift's valve)."""
    states = np.concatenate([np.full(count, state) for state, count, _ in phases])
    valves = np.zeros((len(states), 6))
    valves[:, 1] = np.concatenate([np.full(count, opening) for _, count, opening in phases])
    return Scans(PERIOD_NS * np.arange(1, len(states) + 1), states, valves)


def one_stop(*after: tuple[GroupState, int, float]) -> StopTimes:
    """Asked for 2 ms before the last scan of a motion that scan 500 ends."""
    recorded = scans((STANDBY, 400, -HELD), (MOVING, 100, DRIVEN), *after)
    return stop_times(recorded, 500 * PERIOD_NS - 2e6, np.inf, standby_openings(recorded))


def test_a_stop_that_settles_after_its_ramp() -> None:
    taken = one_stop((STOPPING, 60, DRIVEN), (STANDBY, 10, 2 * HELD), (STANDBY, 50, HELD))
    assert taken == pytest.approx(StopTimes(7.0, 307.0, 357.0))


def test_what_the_recording_does_not_show_is_none() -> None:
    assert one_stop((MOVING, 50, DRIVEN)) == (None, None, None)
    assert one_stop((STOPPING, 60, DRIVEN))[1:] == (None, None)
    assert one_stop((STOPPING, 60, DRIVEN)).answered == pytest.approx(7.0)
    assert one_stop((STOPPING, 60, DRIVEN), (ERROR, 9, 0.0))[1:] == (None, None)
    assert one_stop((STOPPING, 60, DRIVEN), (STANDBY, 50, 2 * HELD)).settled is None


def test_the_next_trials_stop_is_not_taken_for_this_ones() -> None:
    recorded = scans((STANDBY, 400, HELD), (MOVING, 100, DRIVEN), (STOPPING, 60, DRIVEN))
    taken = stop_times(recorded, 450 * PERIOD_NS, 500 * PERIOD_NS, standby_openings(recorded))
    assert taken == (None, None, None)


def test_what_valves_do_soon_after_a_motion_is_not_standbys_own() -> None:
    recorded = scans((MOVING, 9, DRIVEN), (STANDBY, 150, 0.1), (STANDBY, 200, HELD), (ERROR, 9, 0.3))
    assert standby_openings(recorded)[1] == HELD


def test_scans_are_read_from_the_controllers_recording(tmp_path: Path) -> None:
    arm = load(NominalArm, CONFIGS / "arm.yaml", {})
    config = load(ControllerConfig, CONFIGS / "controller.yaml", {"recording_hz": 1000})
    made = scans((MOVING, 5, DRIVEN), (STOPPING, 3, HELD))
    with (
        closing(EventLog("controller")) as log,
        closing(ScanRecorder(tmp_path, arm, config, log)) as recorder,
    ):
        program = ScanProgram(arm, config)
        for now_ns, state, valves in zip(*made, strict=True):
            inputs = ScanInput(int(now_ns), int(now_ns), 0.005, None, (), True)
            output = program.scan(inputs)
            seen = output.view._replace(group_state=GroupState(state), valves=tuple(valves))
            recorder.scan(inputs, output._replace(view=seen))
    for read, said in zip(read_scans(tmp_path / FILE), made, strict=True):
        assert np.array_equal(read, said)
