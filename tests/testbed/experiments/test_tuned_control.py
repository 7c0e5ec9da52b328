"""A controller that is tuned on a plant file knows its valves, and follows better on that plant."""

import json

import pytest

from plant_emulator.config.plant import PlantConfig
from testbed.experiments.robustness.identification import followed_mm, tuned_to
from testbed.identification.parameters import every_valve
from testbed.scenarios.settings import load_settings
from tests.support.paths import CONFIGS


def other_plant(config: PlantConfig) -> PlantConfig:
    """``config`` whose lift has wider edges and less flow."""
    data = json.loads(config.model_dump_json())
    data["valves"]["joints"] = every_valve(config)
    lift = data["valves"]["joints"]["lift"]
    lift["deadband"] = {"supply_a": 0.02, "return_b": 0.018, "supply_b": 0.03, "return_a": 0.027}
    lift["flow_l_min"]["extend"] *= 0.9
    lift["bandwidth_hz"] = 2.0
    return PlantConfig.model_validate(data)


def test_what_the_file_says_of_valves_is_told_and_gains_keep_their_margins() -> None:
    settings = load_settings(CONFIGS, {})
    plant = other_plant(settings.plant)
    told = tuned_to(settings, plant)
    lift, before = told.valves.lift, settings.controller.joint_control.gain_1_s
    assert (lift.raising.deadband.value, lift.lowering.deadband.value) == (0.02, 0.03)
    assert lift.raising.flow_gain.value == pytest.approx(0.9)
    assert lift.lowering.flow_gain.value == pytest.approx(1.0)
    assert told.joint_control.gain_1_s[1] < 0.95 * before[1]
    assert told.joint_control.gain_1_s[0] == before[0]
    assert tuned_to(settings, settings.plant).valves.lift.raising.flow_gain.value == 1.0


def test_it_follows_better_than_a_controller_that_was_told_nothing() -> None:
    settings = load_settings(CONFIGS, {})
    plant = other_plant(settings.plant)
    untuned = followed_mm(settings, plant, settings.controller, seed=1)
    assert followed_mm(settings, plant, tuned_to(settings, plant), seed=1) < 0.8 * untuned
