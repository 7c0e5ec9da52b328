"""The program that watches a controller try out its valves, in lockstep, and what it refuses."""

from functools import partial

import pytest

from foundation.configuration import parse_overrides
from protocol.errors import RequestRefused
from protocol.faults import GroupState
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.run_log import RunLog
from testbed.lockstep.simulated_measurements import load_eye_model, simulated_sight
from testbed.reporting.console import bars
from testbed.scenarios.settings import load_settings
from tests.support.paths import CONFIGS
from vision_pc.application.valve_trials import TrialsSeen, trials_json

pytestmark = pytest.mark.timeout(600)  # a minute of arm time, on a busy machine


def watched(*assignments: str) -> tuple[LockstepRig, TrialsSeen]:
    settings = load_settings(CONFIGS, parse_overrides(["controller.cycle_ms=10", *assignments]))
    sight = partial(simulated_sight, model=load_eye_model(CONFIGS), seed=1)
    rig = LockstepRig(settings, 1, RunLog(), sight)
    with bars(quiet=True) as shown, shown.step("valve-trials") as bar:
        found = rig.operate("valve-trials", {"confirmed": True}, bar)
    return rig, found


def test_play_and_delay_are_found_and_the_arm_is_left_disabled() -> None:
    rig, found = watched(
        "controller.excitation.enabled=true",
        "controller.excitation.joints=[5]",
        "controller.excitation.ramps=2",
        "scene.camera.stamps.delay_ms=12",
    )
    assert rig.link.state.group_state is GroupState.DISABLED
    told = trials_json(found)
    assert list(told["play_mrad"]) == ["wrist3"]
    play, late = told["play_mrad"]["wrist3"], told["camera_delay_ms"]
    true = rig.world.settings.plant.errors.backlash.half_width_mrad[5]
    assert play["value"] == pytest.approx(true, rel=0.2)
    assert abs(play["value"] - true) < 4.0 * play["std"]
    assert late["value"] == pytest.approx(12.0, abs=3.0)


def test_a_controller_in_no_such_mode_is_named_and_disabled() -> None:
    with pytest.raises(RequestRefused) as raised:
        watched()
    assert raised.value.cause == "refused.no_trials"
