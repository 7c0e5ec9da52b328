"""A commissioning that is stated: taken by the controller, as far from the truth as it says, and labelled."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controller.commissioning import commissioned_config
from foundation.configuration import merged, parse_overrides
from laboratory.experiments.positioning.corrected_run import adapting, settings_of
from laboratory.experiments.positioning.own_commissioning import own_commissioning
from laboratory.experiments.positioning.worlds import ARMS, STATED
from nominal_arm.commissioned import found_numbers
from nominal_arm.description import JOINT_NAMES
from plant_emulator.config.valves import JOINT_NAMES as VALVE_NAMES
from protocol.errors import ConfigurationError
from tests.support.paths import CONFIGS


def task(arm: str, seed: int = 5, **asked: Any) -> dict[str, Any]:
    mobile = ["plant.valve_set=mobile"]
    return {"seed": seed, "arm": arm, "world": "lab", "eyes": "model", "assignments": mobile, **asked}


@pytest.mark.parametrize("arm", ARMS)
def test_the_controller_takes_what_is_stated_of_mobile_valves(arm: str) -> None:
    settings = settings_of(CONFIGS, task(arm, commissioned=True))
    known = commissioned_config(settings.arm, settings.controller).valves
    assert settings.controller.commissioned.made_by == STATED
    assert (known.name, known.pressure_compensated) == ("mobile", True)
    for name, own in zip(VALVE_NAMES, JOINT_NAMES, strict=True):
        valve = settings.plant.valves.of(name, getattr(settings.plant.actuators, name).rated_flow_l_min)
        supply_a, return_b, supply_b, return_a = valve.deadband
        told = getattr(known, own)
        assert told.raising.deadband.value == pytest.approx(max(supply_a, return_b), rel=0.05)
        assert told.lowering.deadband.value == pytest.approx(max(supply_b, return_a), rel=0.05)
        assert told.hysteresis.value == pytest.approx(valve.hysteresis, rel=0.25)
        assert told.raising.curve, "mobile spools are progressive"
        assert 0.05 < told.raising.flow_gain.value < 1.0, "and smaller than the servo valves' of arm.yaml"


@pytest.mark.slow("a campaign, small")
def test_what_is_stated_errs_by_what_it_says() -> None:
    z = []
    for seed in range(12):
        controller = settings_of(CONFIGS, task(ARMS[0], seed, commissioned=True)).controller
        found = {n.name: n.number for n in found_numbers(controller.commissioned)}
        loop = found["valves.wrist3.hysteresis"]
        z.append((loop.value - 0.035) / loop.std)
    assert 0.3 < np.std(z) < 2.0
    assert abs(np.mean(z)) < 1.2


@pytest.mark.slow("a joint is tried out")
def test_a_machine_that_commissions_itself_finds_its_own_valve() -> None:
    asked = task(ARMS[0], commissioned=True)
    settings = settings_of(CONFIGS, asked)
    plates = {"controller": {"valves": {"name": "mobile", "pressure_compensated": True}}}
    overrides = merged(parse_overrides(["plant.valve_set=mobile"]), plates)
    found = own_commissioning(CONFIGS, overrides, 5, [2])
    valve = settings.plant.valves.of("tilt", settings.plant.actuators.tilt.rated_flow_l_min)
    _, _, supply_b, return_a = valve.deadband
    assert return_a > 1.03 * supply_b, "its return edge opens last"
    edge = found.valves.tilt.lowering.deadband
    assert edge.value == pytest.approx(return_a, rel=0.015)
    assert "return edge, which opens last" in edge.recording
    assert found.made_by != STATED


def test_nothing_is_stated_unless_it_is_asked_for() -> None:
    assert settings_of(CONFIGS, task(ARMS[0])).controller.commissioned is None


@pytest.mark.parametrize("arm", ARMS)
def test_vision_that_adapts_is_one_file_and_keeps_the_arms_own_numbers(arm: str) -> None:
    plain, adapts = (settings_of(CONFIGS, task(arm, adapting=on)).vision for on in (False, True))
    before, after = (one.programs.local_map for one in (plain, adapts))
    assert (plain.markers.calibration.enabled, adapts.markers.calibration.enabled) == (False, True)
    assert after.servo_std_m == before.servo_std_m
    assert adapts.markers.offset_std_px == adapting(CONFIGS)["markers"]["offset_std_px"] == 3.5


def test_a_configuration_without_that_file_is_not_silently_plain(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError):
        adapting(tmp_path)
