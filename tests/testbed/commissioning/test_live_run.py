"""`longreach commission --records`: what a running controller has recorded of its own trials."""

import io
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from controller.commissioning import basis_of
from controller.shell.scan_recorder import TrialRecords
from foundation.configuration import parse_overrides
from foundation.event_log import EventLog
from nominal_arm.commissioned import Commissioned
from protocol.errors import ConfigurationError
from protocol.faults import CommandCode
from testbed.commissioning.command import CommissionRequest, run_commission
from testbed.commissioning.recording import read_trial
from testbed.commissioning.runs import with_excitation
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.world import World
from testbed.scenarios.scenario import Settings, load_settings
from tests.support.paths import CONFIGS

pytestmark = pytest.mark.realtime


async def left_behind(records: Path, settings: Settings, joint: int) -> None:
    """What a controller leaves in ``records`` once it has tried out ``joint``, in simulated time."""
    world = World(with_excitation(settings, [joint]), 1, RunLog())
    side = world.controller.program
    program: Any = SimpleNamespace(plan=side.plan, excitation=side.excitation, samples=[])
    basis = basis_of(settings.arm, settings.controller)
    trials = TrialRecords(records, program, basis, EventLog("controller", io.StringIO()))
    world.connect()
    run(world.link.command(CommandCode.ENABLE))
    told = 0
    while not (side.excitation.finished(program.plan) or side.excitation.failure):
        world.clock.advance()
        program.excitation, program.samples = side.excitation, program.samples + side.samples[told:]
        told = len(side.samples)
        trials.follow()
    await trials.close()


@pytest.mark.slow("services start")
async def test_what_a_controller_tried_out_is_taken_and_what_it_did_not_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assignments = ("controller.excitation.ramps=2", "plant.valves.deadband=0.02")
    overrides = parse_overrides(list(assignments))
    await left_behind(tmp_path, load_settings(CONFIGS, overrides), 5)
    directory = tmp_path / "session"
    request = CommissionRequest(CONFIGS, overrides, ["wrist3"], directory, 1, None, tmp_path)
    assert not run_commission(request._replace(joints=["wrist3", "slew"]))
    assert "commissioning.unfinished: slew: ENABLE begins" in capsys.readouterr().err
    assert run_commission(request)
    content = yaml.safe_load((directory / "commissioned.yaml").read_text())
    found = Commissioned.model_validate(content)
    assert found.valves.wrist3.raising.deadband.value == pytest.approx(0.02, rel=0.02)


@pytest.mark.slow("a minute of arm time")
async def test_what_broke_a_controllers_trial_off_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    overrides = parse_overrides(["controller.excitation.spool_max=0.004"])
    await left_behind(tmp_path, load_settings(CONFIGS, overrides), 5)
    request = CommissionRequest(CONFIGS, overrides, ["wrist3"], tmp_path / "session", 1, None, tmp_path)
    assert not run_commission(request)
    assert "commissioning.no_motion: wrist3: does not move" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("overrides", "cause"),
    [([], "commissioning.no_trials"), (["controller.valves.name=other"], "commissioning.other_session")],
)
def test_records_of_no_trial_or_of_another_machine_are_named(
    tmp_path: Path, overrides: list[str], cause: str
) -> None:
    if overrides:
        settings = load_settings(CONFIGS, {})
        basis = basis_of(settings.arm, settings.controller).model_dump()
        summary = {"basis": basis, "finished": [], "ended_by": None, "whole": False}
        (tmp_path / "trials.json").write_text(json.dumps(summary))
    asked = parse_overrides(overrides)
    with pytest.raises(ConfigurationError) as raised:
        run_commission(CommissionRequest(CONFIGS, asked, ["slew"], tmp_path / "s", 1, None, tmp_path))
    assert raised.value.cause == cause


def test_a_recording_that_is_none_is_named(tmp_path: Path) -> None:
    path = tmp_path / "trial_slew.jsonl"
    path.write_text('{"strokes": [[0]]}\n[1, 2]\n')
    with pytest.raises(ConfigurationError) as raised:
        read_trial(path)
    assert raised.value.cause == "commissioning.bad_recording"
