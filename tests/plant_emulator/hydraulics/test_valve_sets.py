"""One key chooses the valves of either arm; every number of theirs can be set, and nonsense is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

from foundation.configuration import load, parse_overrides
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES
from plant_emulator.core import layout as col
from plant_emulator.core.model import build_model
from plant_emulator.core.plant import Plant
from plant_emulator.core.right_hand_side import EncoderShafts, advance, new_work
from protocol.process_image import CONTROL_ENABLE, ValveImage
from tests.plant_emulator.plant_world import Driver, assert_refused, plant_config
from tests.support.paths import CONFIGS

ARMS = ("plant.yaml", "arms/long_crane/plant.yaml")
EDGES = slice(col.A_DEADBAND, col.A_DEADBAND + len(col.EDGES))


def _set(*assignments: str, arm: str = "plant.yaml") -> PlantConfig:
    """The arm's file under ``--set`` assignments, as every command reads it."""
    return load(PlantConfig, CONFIGS / Path(arm), parse_overrides(assignments).get("plant", {}))


@pytest.mark.parametrize("arm", ARMS)
def test_one_key_fits_either_arm_with_mobile_valves(arm: str) -> None:
    config = _set("plant.valve_set=mobile", arm=arm)
    assert config.valves.compensator_bar > 0.0
    assert config.valves.counterbalance.lift
    table = build_model(config)[0].actuators
    overlaps = table[:, EDGES]
    assert overlaps.min() >= 0.05
    assert overlaps.max() <= 0.12
    assert len(np.unique(overlaps)) > 6  # no two spools are alike
    plant = Plant(config, seed=1)
    at_rest = plant.truth().q
    driver = Driver(plant)
    driver.run(0.5)
    assert np.abs(plant.truth().q - at_rest).max() < 1e-3  # the start is an equilibrium with this set too
    for opening, way in ((0.4, 1.0), (-0.4, -1.0)):
        before = plant.truth().q
        driver.run(1.5, (opening, opening, opening, opening, opening, opening))
        assert ((plant.truth().q - before) * way > 0.01).all()
        driver.run(0.5)


@pytest.mark.parametrize("arm", ARMS)
def test_servo_valves_are_in_force_unless_asked_otherwise(arm: str) -> None:
    config = _set(arm=arm)
    assert config.valves == config.valve_sets["servo"]


def test_a_set_of_valves_may_come_with_tighter_actuators() -> None:
    own = build_model(_set())[0].actuators[:, col.A_LEAKAGE]
    held = build_model(_set("plant.valve_set=mobile"))[0].actuators[:, col.A_LEAKAGE]
    assert (own == 1e-13).all()
    assert held.tolist() == [4e-16, 4e-16, 4e-16, 1e-15, 1e-15, 1e-15]
    laid = _set("plant.valves.joints.tilt.actuator_leakage_m3_s_pa=5e-14")
    assert build_model(laid)[0].actuators[:, col.A_LEAKAGE].tolist() == [1e-13, 1e-13, 5e-14, *[1e-13] * 3]
    none = _set("plant.valve_set=mobile", "plant.errors.leakage.enabled=false")
    assert not build_model(none)[0].actuators[:, [col.A_LEAKAGE, col.A_SPOOL_LEAKAGE]].any()


def test_a_number_laid_over_holds_for_whichever_set_is_in_force() -> None:
    for name in ("servo", "mobile"):
        config = _set(f"plant.valve_set={name}", "plant.valves.joints.lift.deadband.supply_b=0.111")
        table = build_model(config)[0].actuators
        assert table[1, col.A_DEADBAND + col.EDGES.index("supply_b")] == 0.111
        assert (table[:, EDGES] == 0.111).sum() == 1
    assert (build_model(_set("plant.valves.deadband=0.03"))[0].actuators[:, EDGES] == 0.03).all()
    mobile = _set("plant.valve_set=mobile", "plant.valves.deadband.return_a=0.03")
    some = build_model(mobile)[0].actuators[:, EDGES] == 0.03
    assert (some == [edge == "return_a" for edge in col.EDGES]).all()
    own = _set("plant.valves.deadband=0.03", "plant.valves.joints.lift.deadband=0.04")
    assert own.valves.of("lift", 1.0).deadband == (0.04,) * 4
    assert own.valves.of("lift", 1.0).flow_extend_l_min == _set().valves.of("lift", 1.0).flow_extend_l_min
    mobile = _set("plant.valve_set=mobile", "plant.valves.hysteresis=0.06")
    assert {mobile.valves.of(name, 1.0).hysteresis for name in JOINT_NAMES} == {0.06}
    mobile = _set("plant.valve_set=mobile", "plant.valves.joints.lift=null")
    assert mobile.valves.of("lift", 100.0).flow_extend_l_min == 100.0
    assert mobile.valves.of("lift", 100.0).hysteresis == mobile.valves.hysteresis


def test_a_set_that_came_out_of_a_configuration_goes_in_again() -> None:
    config = _set("plant.valve_set=mobile", "plant.valves.hysteresis=0.06")
    again = PlantConfig.model_validate(config.model_dump())
    assert again == config


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"valve_set": "mobil"}, ["valve_set", "'mobil'", "one of valve_sets: servo, mobile"]),
        ({"valve_set": ["mobile"]}, ["valve_set", "text"]),
        (
            {"valves": {"deadband": -0.01}},
            ["valves.deadband.supply_a", "-0.01", "greater than or equal to 0"],
        ),
        ({"valves": {"deadband": {"supply_a": 0.1}}}, ["valves.deadband", "return_b, supply_b, return_a"]),
        ({"valves": {"deadband": {"supply_c": 0.1}}}, ["valves.deadband.supply_c", "no such key"]),
        ({"valves": {"deadband": True}}, ["valves.deadband"]),
        ({"valves": {"joints": {"boom": {"hysteresis": 0.1}}}}, ["valves.joints.boom", "'slew'"]),
        (
            {"valves": {"joints": {"tilt": {"deadband": {"return_a": 0.4}, "hysteresis": 0.3}}}},
            ["valves.joints", "tilt", "0.4", "0.3", "0.5", "little would be left"],
        ),
        (
            {"valves": {"delay_ms": 100.0}},
            ["valves", "delay_ms = 100", "slew", "watchdog_ms = 100", "old commands"],
        ),
        (
            {"valves": {"compensator_bar": 49.0}, "pump": {"pressure_bar": 55.0}},
            ["pump", "compensator_bar = 49"],
        ),
        (
            {"valves": {"counterbalance": {"lift": True, "setting_bar": 200.0}}},
            ["protection", "relief_bar = 230", "setting_bar = 200", "a load alone"],
        ),
        (
            {"valve_set": "mobile", "valves": {"counterbalance": {"range_bar": 1.0}}},
            ["step_ms", "counterbalance.range_bar = 1 at", "diverge"],
        ),
        (
            {"valve_set": "mobile", "valves": {"joints": {"wrist2": {"flow_l_min": 60.0}}}},
            ["step_ms", "actuators.wrist2.dead_volume_a_l", "diverge"],
        ),
    ],
)
def test_refused_with_key_value_limit_and_reason(changes: dict[str, Any], parts: list[str]) -> None:
    assert_refused(changes, parts)


def _first_motion_ms(plant: Plant, command: float) -> list[int]:
    """When each spool first moves (ms) after a command to all six."""
    plant.write(ValveImage(1, CONTROL_ENABLE, (command,) * 6))
    found = [0] * 6
    for ms in range(1, 40):
        plant.advance(1_000_000)
        for i, spool in enumerate(plant.truth().spools):
            found[i] = found[i] or (ms if spool != 0.0 else 0)
    return found


def test_each_valve_has_its_own_delay() -> None:
    delays = {"slew": 14.0, "lift": 2.0, "wrist3": 30.0}
    joints = {name: {"delay_ms": delay} for name, delay in delays.items()}
    plant = Plant(plant_config(valves={"delay_ms": 5.0, "joints": joints}), seed=1)
    first = _first_motion_ms(plant, 0.5)
    assert first == [15, 3, 6, 6, 6, 31]


def test_commands_inside_the_hysteresis_are_lost_and_none_is_skipped() -> None:
    plant = Plant(plant_config(valves={"delay_ms": 0.0, "hysteresis": 0.2, "slew_limit_per_s": 1e6}), seed=1)
    for command, spool in ((0.09, 0.0), (0.3, 0.2), (0.15, 0.2), (0.0, 0.1), (-0.5, -0.4), (0.0, -0.1)):
        plant.write(ValveImage(round(1000 + command * 100), CONTROL_ENABLE, (command,) * 6))
        plant.advance(90_000_000)
        assert plant.truth().spools == pytest.approx([spool] * 6, abs=1e-4)
    for cycle, command in enumerate((0.5, 0.0)):  # both due at once: the first is not forgotten
        plant.write(ValveImage(2000 + cycle, CONTROL_ENABLE, (command,) * 6))
        plant.advance(1_000_000)
    plant.advance(90_000_000)
    assert plant.truth().spools == pytest.approx([0.1] * 6, abs=1e-4)


def test_a_load_sensing_pump_keeps_its_margin_above_the_load() -> None:
    config = _set("plant.valve_set=mobile", "plant.pump.load_sensing.enabled=true")
    plant = Plant(config, seed=1)
    driver = Driver(plant)
    driver.run(0.5)
    assert plant.truth().supply / 1e5 == pytest.approx(30.0, abs=1.0)  # idles above the return pressure
    driver.run(1.5, (0.0, 0.5, 0.0, 0.0, 0.0, 0.0))
    truth = plant.truth()
    above = (truth.supply - truth.pressures[1, 0]) / 1e5
    assert 12.0 < above < 21.0  # the margin less the pump's droop and the lag of a swinging load
    assert truth.supply / 1e5 < 150.0


def test_the_hot_loop_with_mobile_valves_allocates_nothing() -> None:
    plant = Plant(_set("plant.valve_set=mobile", "plant.pump.load_sensing.enabled=true"), seed=1)
    arrays = (plant._state, np.zeros(6), np.full(6, -0.4), EncoderShafts(np.zeros(6), np.zeros(6)))
    work, counts = new_work(plant._model), []
    _nrt_python.memsys_enable_stats()
    for steps in (1, 1, 200):
        before = rtsys.get_allocation_stats().alloc
        advance(*arrays, steps, 5e-4, plant._model, work)
        counts.append(rtsys.get_allocation_stats().alloc - before)
    assert counts[2] == counts[1]
