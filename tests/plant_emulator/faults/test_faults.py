"""Every fault of the plant, judged by its physical effect; what is refused."""

from typing import Annotated, Any

import numpy as np
import pytest
from pydantic import Field, TypeAdapter

from plant_emulator.config.actuators import BAR
from plant_emulator.core import layout as col
from plant_emulator.core.faults.kinds import (
    FAULTS,
    EncoderBias,
    EncoderJump,
    EncoderStuck,
    Fault,
    PayloadChange,
    PayloadDrop,
    SupplyLost,
    ValveSlow,
    ValveStuck,
    ValveSwapped,
    ValvesWorn,
)
from plant_emulator.core.hydraulics.valve_commands import orifice_flow
from plant_emulator.core.layout import JOINTS
from plant_emulator.core.plant import Plant
from protocol.errors import RequestRefused
from protocol.process_image import (
    CONTROL_ENABLE,
    COUNTS_PER_TURN,
    STATUS_SENSOR_FAULT,
    STATUS_SUPPLY_ON,
    ValveImage,
)
from tests.plant_emulator.plant_world import Driver, plant_config

LIFT = 1
LIFT_UP = (0.0, 0.3, 0.0, 0.0, 0.0, 0.0)
RAD_PER_COUNT = 2.0 * np.pi / COUNTS_PER_TURN
MS = 1_000_000
ANY_FAULT: TypeAdapter[Fault] = TypeAdapter(Annotated[Fault, Field(discriminator="kind")])


@pytest.fixture
def plant() -> Plant:
    return Plant(plant_config(), seed=1)


def test_a_stuck_valve_goes_on_feeding_its_cylinder(plant: Plant) -> None:
    driver = Driver(plant)
    driver.run(0.5, LIFT_UP)
    spool = plant.truth().spools[LIFT]
    plant.inject(ValveStuck(joint="lift"))
    driver.run(0.5)  # the command is shut
    begun = plant.truth()
    driver.run(0.2)
    after = plant.truth()
    assert after.valves[LIFT] == 0.0
    assert after.spools[LIFT] == spool == pytest.approx(0.3, abs=1e-4)
    assert after.q[LIFT] - begun.q[LIFT] > 0.02  # still rising
    # The supply edge passes what its orifice equation says for the stuck opening and the pressures there.
    row, circuit = plant._model.actuators[LIFT], plant._model.circuit
    gain = row[col.A_GAIN] * (spool - row[col.A_DEADBAND]) / (1.0 - row[col.A_DEADBAND])
    drop = after.supply - after.pressures[LIFT, 0]
    leak = row[col.A_LEAKAGE] * (after.pressures[LIFT, 0] - after.pressures[LIFT, 1])
    expected = orifice_flow(gain, drop, circuit[col.C_REGULARISATION]) - leak
    assert after.flows[LIFT, 0] == pytest.approx(expected, rel=1e-3)
    assert np.abs(after.spools[[0, 2, 3, 4, 5]]).max() == 0.0


def test_a_swapped_valve_goes_the_other_way_until_it_is_mended(plant: Plant) -> None:
    driver = Driver(plant)
    number = plant.inject(ValveSwapped(joint="lift")).number
    driver.run(0.2, LIFT_UP)
    assert plant.truth().spools[LIFT] == pytest.approx(-0.3, abs=1e-3)
    assert np.abs(plant.truth().spools[[0, 2, 3, 4, 5]]).max() == 0.0
    plant.clear(number)
    driver.run(0.2, LIFT_UP)
    assert plant.truth().spools[LIFT] == pytest.approx(0.3, abs=1e-3)


@pytest.mark.parametrize("share", [0.5, 0.1])
def test_a_slow_valve_peaks_as_late_as_its_bandwidth_says(share: float) -> None:
    """The step response of a second-order spool peaks at π / (ω √(1 − ζ²))."""
    plant = Plant(plant_config(valves={"delay_ms": 0.0, "slew_limit_per_s": 1e6}), seed=1)
    plant.inject(ValveSlow(joint="lift", bandwidth_share=share))
    plant.write(ValveImage(1, CONTROL_ENABLE, LIFT_UP))
    spools = []
    for cycle in range(2, 1000):
        plant.write(ValveImage(cycle, CONTROL_ENABLE, LIFT_UP))
        plant.advance(MS // 2)
        spools.append(plant.truth().spools[LIFT])
    valves = plant.config.valves
    omega = 2.0 * np.pi * valves.bandwidth_hz * share
    peak_s = np.pi / (omega * np.sqrt(1.0 - valves.damping_ratio**2))
    assert (np.argmax(spools) + 1) * 0.5e-3 == pytest.approx(peak_s, abs=2e-3)
    assert max(spools) == pytest.approx(0.3 * 1.0433, rel=2e-3)


def flow(plant: Plant, spool: float) -> float:
    """The oil (m³/s) that the lift's valve has let into either chamber, 0.5 s after its command."""
    driver = Driver(plant)
    driver.run(0.5, (0.0, spool, 0.0, 0.0, 0.0, 0.0))
    return float(plant.truth().flows[LIFT].max())


def test_worn_valves_open_later_pass_less_while_lowering_and_are_as_before_once_mended() -> None:
    played = {"hysteresis": 0.02}
    healthy, worn = (Plant(plant_config(valves=played), seed=1) for _ in range(2))
    number = worn.inject(ValvesWorn(deadband_share=2.0, lowering_flow_share=0.5)).number
    edges = healthy.model.actuators[:, col.A_DEADBAND : col.A_DEADBAND + 4]
    assert worn.model.actuators[:, col.A_DEADBAND : col.A_DEADBAND + 4] == pytest.approx(2.0 * edges)
    assert flow(worn, 0.3) < flow(healthy, 0.3)
    assert flow(worn, -0.3) < 0.6 * flow(healthy, -0.3)
    Driver(worn).run(0.2, LIFT_UP)
    assert worn.truth().spools[LIFT] == pytest.approx(0.3 - 1.5 * 0.5 * played["hysteresis"], abs=1e-3)
    worn.clear(number)
    np.testing.assert_array_equal(worn.model.actuators, healthy.model.actuators)
    Driver(worn).run(0.2, LIFT_UP)
    assert worn.truth().spools[LIFT] == pytest.approx(0.3 - 0.5 * played["hysteresis"], abs=1e-3)


def test_a_lost_supply_lets_the_pressure_fall_and_the_arm_only_sink(plant: Plant) -> None:
    driver = Driver(plant)
    driver.run(0.5)
    supply = [plant.truth().supply]
    plant.inject(SupplyLost())
    for _ in range(10):
        driver.run(0.1)
        supply.append(plant.truth().supply)
    assert (np.diff(supply) <= 0.0).all()
    image = plant.read()
    assert not image.status & STATUS_SUPPLY_ON
    assert image.supply_bar == pytest.approx(supply[-1] / BAR)
    assert image.supply_bar < 20.0
    height = [plant.truth().X_WT[2, 3]]
    for _ in range(100):
        driver.run(0.01, LIFT_UP)
        height.append(plant.truth().X_WT[2, 3])
    assert max(height) < height[0] + 1e-4  # asked to rise, it cannot
    assert height[-1] < height[0] - 0.05  # through the open valve the load sinks
    plant.clear()
    driver.run(1.0, LIFT_UP)
    assert plant.read().status & STATUS_SUPPLY_ON
    assert plant.truth().supply > 150 * BAR
    assert plant.truth().X_WT[2, 3] > height[-1]


def reading_error(plant: Plant) -> np.ndarray:
    """What each encoder reads beyond the true angle and its known zero offset (rad)."""
    counts = np.array(plant.read().encoder_counts)
    offsets = np.array(plant.config.errors.encoder_offsets.mrad) * 1e-3
    return np.asarray(counts * RAD_PER_COUNT - plant.truth().q - offsets)


@pytest.fixture
def exact() -> Plant:
    """A plant whose encoders have neither play nor noise."""
    errors = {"backlash": {"enabled": False}, "encoder_noise": {"enabled": False}}
    return Plant(plant_config(errors=errors), seed=1)


def test_a_stuck_encoder_repeats_its_count_and_says_so(exact: Plant) -> None:
    driver, before = Driver(exact), exact.read().encoder_counts
    exact.inject(EncoderStuck(joint="lift"))
    driver.run(0.5, LIFT_UP)
    assert exact.read().encoder_counts[LIFT] == before[LIFT]
    assert reading_error(exact)[LIFT] < -0.02  # it has risen unseen
    assert np.abs(np.delete(reading_error(exact), LIFT)).max() < RAD_PER_COUNT
    assert exact.read().status & STATUS_SENSOR_FAULT
    exact.clear()
    assert abs(reading_error(exact)[LIFT]) < RAD_PER_COUNT
    assert not exact.read().status & STATUS_SENSOR_FAULT


def test_an_encoder_may_be_stuck_without_knowing(exact: Plant) -> None:
    offset = 1e-3 * plant_config().errors.encoder_offsets.mrad[LIFT]
    true_count = round((exact.truth().q[LIFT] + offset) / RAD_PER_COUNT)
    exact.inject(EncoderStuck(joint="lift", reported=False))  # before anybody ever read it
    Driver(exact).run(0.2, LIFT_UP)
    assert abs(exact.read().encoder_counts[LIFT] - true_count) <= 1
    assert not exact.read().status & STATUS_SENSOR_FAULT


def test_an_encoder_jumps_at_once_and_stays_off(exact: Plant) -> None:
    driver = Driver(exact)
    exact.inject(EncoderJump(joint="tilt", angle_mrad=-100.0))
    for _ in range(3):
        assert reading_error(exact)[2] == pytest.approx(-0.1, abs=RAD_PER_COUNT)
        driver.run(0.3, LIFT_UP)
    exact.inject(EncoderJump(joint="lift", angle_mrad=5.0))
    assert reading_error(exact)[LIFT] == pytest.approx(0.005, abs=RAD_PER_COUNT)
    assert reading_error(exact)[2] == pytest.approx(-0.1, abs=RAD_PER_COUNT)


def test_an_encoder_bias_creeps_in(exact: Plant) -> None:
    driver = Driver(exact)
    exact.inject(EncoderBias(joint="slew", angle_mrad=40.0, ramp_s=2.0))
    errors = []
    for _ in range(60):
        driver.run(0.05)
        errors.append(reading_error(exact)[0])
    expected = 0.04 * np.minimum(0.05 * np.arange(1, 61) / 2.0, 1.0)
    np.testing.assert_allclose(errors, expected, atol=RAD_PER_COUNT)


def test_a_dropped_payload_relieves_the_cylinder_and_lets_the_tip_jump() -> None:
    loaded = Plant(plant_config(payload={"mass_kg": 100.0}), seed=1)
    driver = Driver(loaded)
    driver.run(0.5)
    before = loaded.truth()
    number = loaded.inject(PayloadDrop()).number
    assert loaded.truth().payload_kg == 0.0
    driver.run(2.0)
    after = loaded.truth()
    push = [float(t.pressures[LIFT, 0] - t.pressures[LIFT, 1]) for t in (before, after)]
    assert push[1] < push[0] - 5 * BAR
    assert after.X_WT[2, 3] - before.X_WT[2, 3] > 10e-3
    assert after.deflections[2] - before.deflections[2] > 2e-3  # unseen by any encoder
    loaded.clear(number)
    driver.run(3.0)
    assert loaded.truth().payload_kg == 100.0
    rings = []
    for _ in range(100):  # the hinges still ring about where they were
        driver.run(0.02)
        rings.append(loaded.truth().deflections)
    np.testing.assert_allclose(np.mean(rings, axis=0), before.deflections, atol=3e-4)
    assert after.X_WT[2, 3] - loaded.truth().X_WT[2, 3] > 10e-3


def test_a_changed_payload_is_the_latest_in_force(plant: Plant) -> None:
    plant.inject(PayloadChange(mass_kg=60.0), duration_ns=2 * MS)
    assert plant.truth().payload_kg == 60.0
    drop = plant.inject(PayloadDrop())
    assert plant.truth().payload_kg == 0.0
    plant.clear(drop.number)
    assert plant.truth().payload_kg == 60.0
    plant.advance(2 * MS)
    assert plant.truth().payload_kg == 0.0
    plant.set_payload(25.0)
    assert plant.truth().payload_kg == 25.0
    with pytest.raises(RequestRefused):
        plant.set_payload(-1.0)


def test_faults_that_are_not_the_plants_change_nothing_in_it() -> None:
    healthy, other = (Plant(plant_config(), seed=4) for _ in range(2))
    for fault in (
        {"kind": "camera_frozen"}, {"kind": "camera_blind"}, {"kind": "frames_dropped"},
        {"kind": "marker_covered", "marker_id": 3}, {"kind": "coupler_silent"},
    ):  # fmt: skip
        other.inject(ANY_FAULT.validate_python(fault))
    for plant in (healthy, other):
        Driver(plant).run(0.3, LIFT_UP)
    np.testing.assert_array_equal(healthy._state, other._state)
    assert healthy.read() == other.read()
    assert len(other.truth().faults) == 5


EVERY: list[dict[str, Any]] = [
    *(
        {"kind": kind, "joint": joint}
        for kind in ("valve_stuck", "valve_swapped", "encoder_stuck")
        for joint in JOINTS
    ),
    {"kind": "valve_slow", "joint": "wrist3", "bandwidth_share": 0.3},
    {"kind": "valves_worn", "deadband_share": 1.2, "hysteresis_share": 2.0, "lowering_flow_share": 0.5},
    {"kind": "encoder_jump", "joint": "slew", "angle_mrad": -3.5},
    {"kind": "encoder_bias", "joint": "tilt", "angle_mrad": 3.5, "ramp_s": 0.5},
    {"kind": "supply_lost"},
    {"kind": "payload_drop"},
    {"kind": "payload_change", "mass_kg": 12.0},
    {"kind": "object_moves", "speed_mm_s": -0.5, "axis": "y"},
    {"kind": "camera_frozen", "stamps": "hold"},
    {"kind": "camera_blind", "grey": 255},
    {"kind": "frames_dropped", "share": 0.25},
    {"kind": "marker_covered", "marker_id": 2, "share": 0.4, "side": "top", "grey": 200},
    {"kind": "coupler_silent"},
]


def test_every_kind_is_tested_here() -> None:
    assert {data["kind"] for data in EVERY} == set(FAULTS)
