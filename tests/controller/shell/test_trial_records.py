"""What trying out valves leaves on disk: whole files, in order, readable as they were recorded."""

import asyncio
import json
from pathlib import Path

import numpy as np
import pytest

from controller.commissioning import basis_of
from controller.config import ControllerConfig
from controller.core.excitation.plan import Failure, Phase, begun
from controller.core.excitation.program import ExcitationSample
from controller.core.scan_program import ScanProgram
from controller.shell.scan_recorder import TrialRecords
from foundation.configuration import load
from foundation.event_log import EventLog
from nominal_arm.description import NominalArm
from protocol.errors import ConfigurationError
from testbed.commissioning.recording import read_trial
from tests.controller.conftest import CONFIGS


@pytest.fixture
def program(arm: NominalArm) -> ScanProgram:
    chosen = {"excitation": {"enabled": True, "joints": [5, 0]}}
    return ScanProgram(arm, load(ControllerConfig, CONFIGS / "controller.yaml", chosen))


def records_in(directory: Path | None, program: ScanProgram, arm: NominalArm) -> TrialRecords:
    config = load(ControllerConfig, CONFIGS / "controller.yaml")
    return TrialRecords(directory, program, basis_of(arm, config), EventLog("controller"))


def sample(number: int, stroke: int) -> ExcitationSample:
    pressures = tuple((60.0 + k, 61.5) for k in range(6))
    q = np.linspace(0.1, 0.7, 6) + 1e-3 * number
    return ExcitationSample(number, stroke, True, 0.01 * number, q, pressures, 190.0, 10.0, (2.0, 1.5))


def told(directory: Path) -> dict[str, object]:
    found: dict[str, object] = json.loads((directory / "trials.json").read_text())
    return found


def files_in(directory: Path) -> list[Path]:
    return list(directory.iterdir())


def partial_files(directory: Path) -> list[Path]:
    return list(directory.glob("*.partial"))


async def test_a_finished_joint_is_written_as_it_was_recorded(
    tmp_path: Path, program: ScanProgram, arm: NominalArm
) -> None:
    records = records_in(tmp_path, program, arm)
    assert told(tmp_path)["finished"] == []
    recorded = [sample(k, 2) for k in range(5)]
    program.samples = list(recorded)
    program.excitation = program.excitation._replace(excitation=begun(np.zeros(6)))
    records.follow()
    assert program.samples  # the joint goes on
    assert program.plan is not None
    half = len(program.plan.strokes) // 2
    program.excitation = program.excitation._replace(stroke=half)
    records.follow()
    assert program.samples == []
    await records.close()
    strokes, samples = read_trial(tmp_path / "trial_wrist3.jsonl")
    assert tuple(strokes) == program.plan.strokes
    for read, was in zip(samples, recorded, strict=True):
        assert np.array_equal(read.q, was.q)
        assert read._replace(q=was.q, pressures_bar=was.pressures_bar, full_speed=was.full_speed) == was
        assert np.array_equal(read.pressures_bar, was.pressures_bar)
    assert told(tmp_path)["finished"] == ["wrist3"]
    assert told(tmp_path)["whole"] is False
    assert not partial_files(tmp_path)


async def test_a_joint_that_was_broken_off_is_kept_with_its_cause(
    tmp_path: Path, program: ScanProgram, arm: NominalArm
) -> None:
    records = records_in(tmp_path, program, arm)
    program.samples = [sample(0, 0)]
    over = begun(np.zeros(6))._replace(phase=Phase.ENDED)
    failure = Failure("commissioning.no_motion", 5, 0.3, 0.29)
    program.excitation = program.excitation._replace(excitation=over, failure=failure)
    records.follow()
    await records.close()
    assert told(tmp_path)["ended_by"] == {
        "cause": "commissioning.no_motion",
        "joint": "wrist3",
        "value": 0.3,
        "limit": 0.29,
    }
    assert (tmp_path / "trial_wrist3_unfinished.jsonl").is_file()


async def test_a_joint_that_somebody_stopped_says_so(
    tmp_path: Path, program: ScanProgram, arm: NominalArm
) -> None:
    records = records_in(tmp_path, program, arm)
    program.samples = [sample(0, 0)]
    records.follow()  # the excitation is gone: disabled
    await records.close()
    ended = told(tmp_path)["ended_by"]
    assert isinstance(ended, dict)
    assert ended["cause"] == "commissioning.stopped"


async def test_the_last_summary_says_that_it_is_the_whole(
    tmp_path: Path, program: ScanProgram, arm: NominalArm
) -> None:
    records = records_in(tmp_path, program, arm)
    assert program.plan is not None
    for stroke in (len(program.plan.strokes) // 2, len(program.plan.strokes)):
        program.samples = [sample(k, stroke - 1) for k in range(1000)]
        program.excitation = program.excitation._replace(stroke=stroke)
        records.follow()
    await records.close()
    assert told(tmp_path)["finished"] == ["wrist3", "slew"]
    assert told(tmp_path)["whole"] is True


def test_nothing_is_tried_out_that_nobody_records(program: ScanProgram, arm: NominalArm) -> None:
    with pytest.raises(ConfigurationError) as raised:
        records_in(None, program, arm)
    assert raised.value.cause == "configuration.nothing_recorded"


async def test_a_controller_that_servos_leaves_nothing(tmp_path: Path, arm: NominalArm) -> None:
    program = ScanProgram(arm, load(ControllerConfig, CONFIGS / "controller.yaml"))
    records = records_in(tmp_path, program, arm)
    records.follow()
    await asyncio.wait_for(records.close(), 10.0)
    assert not files_in(tmp_path)
