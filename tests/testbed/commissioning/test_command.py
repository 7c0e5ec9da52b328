"""`longreach commission` on one joint: found, kept, written, resumed; and what it refuses."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from controller.core.settings import settings_from
from foundation.configuration import parse_overrides
from nominal_arm.commissioned import Commissioned
from protocol.errors import ConfigurationError, MeasurementFailed
from testbed.commissioning.command import CommissionRequest, run_commission
from testbed.commissioning.findings import joint_findings
from testbed.commissioning.recording import load_recording
from testbed.scenarios.settings import load_settings
from tests.support.paths import CONFIGS

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]  # a minute of arm time, on a busy machine

FAST = ("controller.excitation.ramps=3", "plant.valves.deadband=0.02")


def requested(directory: Path, *assignments: str) -> CommissionRequest:
    overrides = parse_overrides([*FAST, *assignments])
    return CommissionRequest(CONFIGS, overrides, ["wrist3"], directory, 1, directory / "figures.json")


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory: Path = tmp_path_factory.mktemp("commission") / "session"
    assert run_commission(requested(directory))
    return directory


def test_what_was_found_is_written_and_the_controller_takes_it(session: Path) -> None:
    content = yaml.safe_load((session / "commissioned.yaml").read_text())
    found = Commissioned.model_validate(content)
    for edge in (found.valves.wrist3.raising, found.valves.wrist3.lowering):
        assert edge.deadband.value == pytest.approx(0.02, rel=0.02)
        assert 0.0 < edge.deadband.std < 0.001
        assert edge.deadband.recording.startswith("wrist3.npz ")
    assert found.valves.slew.raising.deadband.recording == ""  # believed, as before
    settings = load_settings(CONFIGS, parse_overrides(["controller.excitation.ramps=3"]))
    config = settings.controller.model_copy(update={"commissioned": found})
    deadband = settings_from(settings.arm, config).servo.joints.deadband
    assert deadband[5] == pytest.approx([0.02, 0.02], rel=0.02)
    figures = json.loads((session / "figures.json").read_text())
    assert figures["joints"]["wrist 3"]["friction"]["friction"]["value"] > 1.0
    assert (session / "wrist3.png").read_bytes().startswith(b"\x89PNG")


def test_friction_is_that_of_the_plant(session: Path) -> None:
    found = joint_findings(load_recording(session / "wrist3.npz"), compensated=False)
    v = found.friction.speed
    # configs/plant.yaml: 60 N m, 75 at rest, 60 N m s/rad, at 1.3e-4 m³/rad
    true_bar = (60.0 + 15.0 * np.exp(-((v / 0.03) ** 2)) + 60.0 * v) / 1.3e-4 / 1e5
    assert found.friction.friction.value == pytest.approx(true_bar, abs=0.5)
    assert abs(found.friction.load.value) < 1.0  # the tool hangs in its axis


def test_a_session_goes_on_without_trying_out_again(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: Any) -> None:
        raise AssertionError("tried out again")

    monkeypatch.setattr("testbed.commissioning.command.excite_in_lockstep", never)
    assert run_commission(requested(session))


def test_a_session_of_another_machine_is_refused(session: Path) -> None:
    with pytest.raises(ConfigurationError) as raised:
        run_commission(requested(session, "controller.valves.name=other"))
    assert raised.value.cause == "commissioning.other_session"


def test_an_unknown_joint_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError) as raised:
        run_commission(requested(tmp_path)._replace(joints=["elbow"]))
    assert raised.value.cause == "configuration.unknown_joint"


def test_a_spoilt_recording_is_refused(session: Path, tmp_path: Path) -> None:
    (tmp_path / "bad.npz").write_bytes((session / "wrist3.npz").read_bytes()[:1000])
    with pytest.raises(ConfigurationError) as raised:
        load_recording(tmp_path / "bad.npz")
    assert raised.value.cause == "commissioning.bad_recording"


def test_a_joint_that_is_not_the_models_is_refused(session: Path) -> None:
    recording = load_recording(session / "wrist3.npz")
    q = recording.q.copy()
    q[:, 5] += 2e-3 * np.sin(2.0 * np.pi * 1.5 * recording.t) * recording.driving
    with pytest.raises(MeasurementFailed) as raised:
        joint_findings(recording._replace(q=q), compensated=False)
    assert raised.value.cause == "measurement.unlike_model"


def test_a_plant_that_does_not_move_ends_it_and_keeps_what_was_found(tmp_path: Path) -> None:
    stiff = ["controller.excitation.search_rate_1_s=0.1", "plant.valves.deadband=0.45"]
    dead = requested(tmp_path)._replace(overrides=parse_overrides(stiff))
    assert not run_commission(dead)
    assert json.loads((tmp_path / "session.json").read_text())["ended_by"] == "commissioning.no_motion"
    assert not (tmp_path / "commissioned.yaml").exists()
