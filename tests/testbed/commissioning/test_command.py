"""`longreach commission` on one joint: found, kept, written, resumed; and what it refuses."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml

from controller.core.settings import settings_from
from foundation.configuration import parse_overrides
from nominal_arm.commissioned import Commissioned
from protocol.errors import ConfigurationError, MeasurementFailed
from protocol.faults import GroupState
from testbed.commissioning.command import CommissionRequest, run_commission
from testbed.commissioning.findings import joint_findings
from testbed.commissioning.recording import JointRecording, read_trial, recording_of
from testbed.lockstep.world import World
from testbed.scenarios.scenario import fault_orders, load_settings
from tests.support.paths import CONFIGS

pytestmark = [pytest.mark.slow("a minute of arm time"), pytest.mark.timeout(600)]

FAST = ("controller.excitation.ramps=3", "plant.valves.deadband=0.02")


def requested(directory: Path, *assignments: str) -> CommissionRequest:
    overrides = parse_overrides([*FAST, *assignments])
    return CommissionRequest(CONFIGS, overrides, ["wrist3"], directory, 1, directory / "figures.json")


MOBILE = (
    "plant.valve_set=mobile",
    "controller.valves.name=mobile",
    "controller.valves.pressure_compensated=true",
)


class Watched(NamedTuple):
    """What a command told on its error stream, line by line, and the ``worlds`` that it made."""

    told: list[str]
    worlds: list[World]


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Watched:
    worlds: list[World] = []

    def made(*arguments: Any) -> World:
        worlds.append(World(*arguments))
        return worlds[-1]

    monkeypatch.setattr("testbed.commissioning.command.World", made)
    lines: list[str] = []
    monkeypatch.setattr("testbed.commissioning.command.err.print", lambda told, **_: lines.append(str(told)))
    return Watched(lines, worlds)


def assert_stands(world: World) -> None:
    """Every valve is centred, and the group moves no more."""
    assert np.all(world.plant.truth().valves == 0.0)
    assert world.states[-1].group_state is not GroupState.MOVING


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory: Path = tmp_path_factory.mktemp("commission") / "session"
    assert run_commission(requested(directory))
    return directory


def read_recording(session: Path) -> JointRecording:
    return recording_of(load_settings(CONFIGS, {}).arm, 5, *read_trial(session / "trial_wrist3.jsonl"))


def test_what_was_found_is_written_and_the_controller_takes_it(session: Path) -> None:
    content = yaml.safe_load((session / "commissioned.yaml").read_text())
    found = Commissioned.model_validate(content)
    for edge in (found.valves.wrist3.raising, found.valves.wrist3.lowering):
        assert edge.deadband.value == pytest.approx(0.02, rel=0.02)
        assert 0.0 < edge.deadband.std < 0.001
        assert edge.deadband.recording.startswith("trial_wrist3.jsonl ")
    assert found.valves.slew.raising.deadband.recording == ""  # believed, as before
    settings = load_settings(CONFIGS, parse_overrides(["controller.excitation.ramps=3"]))
    config = settings.controller.model_copy(update={"commissioned": found})
    deadband = settings_from(settings.arm, config).servo.joints.deadband
    assert deadband[5] == pytest.approx([0.02, 0.02], rel=0.02)
    figures = json.loads((session / "figures.json").read_text())["joints"]["wrist 3"]
    for edge in (figures["raising"], figures["lowering"]):
        assert edge["deadband"]["value"] == pytest.approx(0.02, rel=0.02)
        assert abs(edge["hysteresis"]["value"]) < 3.0 * edge["hysteresis"]["std"] + 3e-4
        assert 0.005 < edge["lag"]["value"] < 0.04  # a cycle, the drive's 1 ms, the spool's 30 Hz


def test_a_session_goes_on_without_trying_out_again(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: Any) -> None:
        raise AssertionError("tried out again")

    monkeypatch.setattr("testbed.commissioning.command.excite_in_lockstep", never)
    assert run_commission(requested(session))


def test_a_session_of_another_machine_is_refused(session: Path) -> None:
    with pytest.raises(ConfigurationError) as raised:
        run_commission(requested(session, "controller.valves.name=other"))
    assert raised.value.cause == "commissioning.other_session"


def test_a_joint_that_is_not_the_models_is_refused(session: Path) -> None:
    recording = read_recording(session)
    q = recording.q.copy()
    q[:, 5] += 2e-3 * np.sin(2.0 * np.pi * 1.5 * recording.t) * recording.driving
    with pytest.raises(MeasurementFailed) as raised:
        joint_findings(recording._replace(q=q), compensated=False)
    assert raised.value.cause == "measurement.unlike_model"


@pytest.mark.parametrize(
    ("fault", "assignment", "told"),
    [
        ("valve_stuck,joint=wrist1", "", "commissioning.no_motion: wrist1: does not move"),
        ("valve_swapped,joint=wrist1", "", "commissioning.wrong_way: wrist1: turns against its valve word"),
        ("", "plant.actuators.wrist1.rotary.to_deg=1", "commissioning.blocked: wrist1: stands still under"),
        ("encoder_jump,joint=wrist1,angle_mrad=30,start_after_s=4", "", "measurement.stopped: fault encoder"),
    ],
)
def test_a_plant_that_misbehaves_is_named_stands_and_keeps_what_was_found(
    session: Path, tmp_path: Path, watched: Watched, fault: str, assignment: str, told: str
) -> None:
    directory = tmp_path / "session"
    shutil.copytree(session, directory)
    (directory / "commissioned.yaml").unlink()
    asked = requested(directory, *([assignment] if assignment else []))
    faults = fault_orders([fault] if fault else [])
    assert not run_commission(asked._replace(joints=["wrist3", "wrist1"], faults=faults))
    (line,) = [each for each in watched.told if each.startswith(("commissioning.", "measurement."))]
    assert line.startswith(told)
    assert line.endswith("; the arm stands, what was found is kept")
    assert_stands(watched.worlds[0])
    summary = json.loads((directory / "trials.json").read_text())
    assert summary["finished"] == ["wrist3"]
    assert summary["ended_by"]["cause"] == line.partition(":")[0]
    assert not (directory / "commissioned.yaml").exists()
    assert list(json.loads((directory / "figures.json").read_text())["joints"]) == ["wrist 3"]


def test_a_boom_that_swings_on_its_load_holding_valve_is_named(tmp_path: Path, watched: Watched) -> None:
    undamped = ["plant.valves.counterbalance.lag_ms=20", "plant.payload.mass_kg=100"]
    asked = requested(tmp_path)._replace(joints=["lift"], overrides=parse_overrides([*MOBILE, *undamped]))
    assert not run_commission(asked)
    (line,) = [each for each in watched.told if each.startswith("commissioning.")]
    assert line.startswith("commissioning.oscillates: lift: swings to and fro")
    assert_stands(watched.worlds[0])


def test_faults_are_of_the_emulated_arm(tmp_path: Path) -> None:
    asked = requested(tmp_path)._replace(records=tmp_path, faults=fault_orders(["supply_lost"]))
    with pytest.raises(ConfigurationError) as raised:
        run_commission(asked)
    assert raised.value.cause == "configuration.not_emulated"


def _without_pressures(recording: JointRecording) -> JointRecording:
    return recording._replace(chambers=np.zeros_like(recording.chambers))


def _unexcited(recording: JointRecording) -> JointRecording:
    return recording._replace(valve=np.zeros_like(recording.valve))


@pytest.mark.parametrize(
    ("spoilt", "cause"),
    [
        (_without_pressures, "measurement.no_pressures"),
        (_unexcited, "measurement.too_few_strokes"),
    ],
)
def test_a_recording_that_says_too_little_is_named(
    session: Path, spoilt: Callable[[JointRecording], JointRecording], cause: str
) -> None:
    recording = read_recording(session)
    with pytest.raises(MeasurementFailed, match="wrist3") as raised:
        joint_findings(spoilt(recording), compensated=False)
    assert raised.value.cause == cause
