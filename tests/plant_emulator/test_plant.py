"""The plant as its surroundings see it: at rest, driven, watched, broken, replayed."""

import numpy as np
import pytest

from controller.core.kinematics.denavit_hartenberg import dh_table, tool_pose
from foundation.configuration import load
from nominal_arm.description import NominalArm
from plant_emulator.core.layout import N_STATES, RATE, Q
from plant_emulator.core.plant import NOMINAL_MOUNTS, Plant
from plant_emulator.core.right_hand_side import new_work, right_hand_side
from plant_emulator.core.truth import inverse, tool_error
from protocol.errors import ConfigurationError, ImageRefused
from protocol.process_image import (
    CONTROL_ENABLE,
    CONTROL_RESET_WATCHDOG,
    COUNTS_PER_TURN,
    STATUS_SUPPLY_ON,
    STATUS_VALVES_ENABLED,
    STATUS_WATCHDOG_TRIPPED,
    ValveImage,
)
from tests.plant_emulator.known_answers.stand import Stand, default_config
from tests.plant_emulator.plant_world import CONFIGS, CYCLE_NS, Driver, plant_config

LIFT_UP = (0.0, 0.3, 0.0, 0.0, 0.0, 0.0)


@pytest.fixture
def plant() -> Plant:
    return Plant(plant_config(), seed=1)


def test_starts_in_equilibrium(plant: Plant) -> None:
    rate = np.zeros(N_STATES)
    right_hand_side(plant._state, np.zeros(6), plant._model, new_work(plant._model), rate)
    assert np.abs(rate[RATE : RATE + 10]).max() < 1e-9
    start = plant.truth()
    plant.advance(100_000_000)
    assert np.linalg.norm(plant.truth().X_BT[:3, 3] - start.X_BT[:3, 3]) < 1e-5
    assert start.deflections[0] < -1e-3  # the boom sags
    assert start.deflections[2] < -1e-3


def test_agrees_with_the_controllers_nominal_kinematics_without_errors() -> None:
    table = dh_table(load(NominalArm, CONFIGS / "arm.yaml").dh)
    stand = Stand(default_config())
    rng = np.random.default_rng(5)
    for _ in range(100):
        q = rng.uniform([-2.0, -0.1, -2.5, -1.5, -1.5, -1.5], [2.0, 1.8, -0.4, 1.5, 1.5, 1.5])
        stand.state[[Q + i for i in (0, 1, 4, 7, 8, 9)]] = q
        position = stand.place(9, stand.chain.X_BT_home[:3, 3])
        rotation = stand.work.multibody.rotation[-1] @ stand.chain.X_BT_home[:3, :3]
        nominal = tool_pose(table, q)
        np.testing.assert_allclose(position, nominal[:3, 3], atol=1e-9)
        np.testing.assert_allclose(rotation, nominal[:3, :3], atol=1e-9)


def test_positive_valves_raise_every_joint_angle(plant: Plant) -> None:
    before = np.array(plant.read().encoder_counts)
    Driver(plant).run(0.5, (0.1, 0.1, 0.1, 0.1, 0.1, 0.1))
    assert (np.array(plant.read().encoder_counts) - before > 50).all()


def test_named_errors_move_the_tool_by_centimetres_and_can_be_switched_off() -> None:
    nominal = np.array([3.89355, 0.0, 1.00825])
    errors = plant_config().model_dump()["errors"]
    off = {name: {"enabled": False} for name in errors}
    rigid = Plant(plant_config(errors=off, flexibility={"enabled": False}), seed=1).truth()
    np.testing.assert_allclose(rigid.X_BT[:3, 3], nominal, atol=1e-5)
    np.testing.assert_allclose(rigid.X_WB, np.eye(4))
    real = Plant(plant_config(), seed=1).truth()
    assert 5e-3 < np.linalg.norm(real.X_BT[:3, 3] - nominal) < 60e-3
    assert 1e-3 < np.linalg.norm(real.X_WB[:3, :3] - np.eye(3)) < 20e-3


def test_encoders_show_joint_plus_offset_and_never_the_sag(plant: Plant) -> None:
    angles = np.array(plant.read().encoder_counts) * (2.0 * np.pi / COUNTS_PER_TURN)
    offsets = np.array(plant.config.errors.encoder_offsets.mrad) * 1e-3
    np.testing.assert_allclose(angles, plant.truth().q + offsets, atol=1e-4)
    np.testing.assert_allclose(plant.truth().q, np.radians(plant.config.start_pose_deg), atol=1e-12)


def test_truth_is_one_consistent_chain(plant: Plant) -> None:
    truth = plant.truth()
    X_CO = inverse(truth.X_WC) @ truth.X_WO
    X_CM = inverse(truth.X_WC) @ truth.X_WM
    np.testing.assert_allclose(truth.p_CO, X_CO[:3, 3], atol=1e-12)
    np.testing.assert_allclose(truth.R_CM, X_CM[:3, :3], atol=1e-12)
    np.testing.assert_allclose(truth.p_CM, [0.20, 0.05, 0.40], atol=1e-12)
    np.testing.assert_allclose(truth.X_WT, truth.X_WB @ truth.X_BT, atol=1e-12)
    np.testing.assert_allclose(tool_error(truth, 0.1), truth.p_CO - truth.p_CM - [0.0, 0.0, 0.1], atol=1e-12)


def test_mounts_are_the_callers(plant: Plant) -> None:
    shifted = NOMINAL_MOUNTS.X_WO.copy()
    shifted[1, 3] += 0.25
    other = Plant(plant_config(), seed=1, mounts=NOMINAL_MOUNTS._replace(X_WO=shifted))
    np.testing.assert_allclose(other.truth().X_WO[1, 3] - plant.truth().X_WO[1, 3], 0.25)


def test_disabled_valves_stay_shut(plant: Plant) -> None:
    Driver(plant).run(0.1, LIFT_UP, control=0)
    assert np.abs(plant.truth().spools).max() == 0.0
    assert not plant.read().status & STATUS_VALVES_ENABLED


def test_commands_take_the_drives_delay_and_are_clipped() -> None:
    plant = Plant(plant_config(valves={"delay_ms": 4.0}), seed=1)
    plant.write(ValveImage(1, CONTROL_ENABLE, (0.0, 3.0, 0.0, 0.0, 0.0, 0.0)))
    plant.advance(4_000_000)
    assert plant.truth().spools[1] == 0.0
    plant.advance(500_000)
    assert plant.truth().spools[1] > 0.0
    assert plant.truth().valves[1] == 1.0


def test_watchdog_shuts_the_valves_when_the_controllers_cycle_stalls(plant: Plant) -> None:
    driver = Driver(plant)
    driver.run(0.2, LIFT_UP)
    assert plant.read().status == STATUS_SUPPLY_ON | STATUS_VALVES_ENABLED
    stalled = ValveImage(driver.cycle, CONTROL_ENABLE, LIFT_UP)
    for _ in range(18):  # the last fresh image was taken 5 ms ago
        plant.write(stalled)
        plant.advance(CYCLE_NS)
    assert not plant.read().status & STATUS_WATCHDOG_TRIPPED
    for _ in range(12):
        plant.write(stalled)
        plant.advance(CYCLE_NS)
    assert plant.read().status & STATUS_WATCHDOG_TRIPPED
    assert not plant.read().status & STATUS_VALVES_ENABLED
    assert np.abs(plant.truth().valves).max() == 0.0


def test_watchdog_latches_until_the_rising_edge_of_its_reset(plant: Plant) -> None:
    driver = Driver(plant)
    driver.run(0.05, LIFT_UP)
    plant.advance(150_000_000)
    driver.run(0.1, LIFT_UP)
    assert plant.read().status & STATUS_WATCHDOG_TRIPPED
    assert np.abs(plant.truth().valves).max() == 0.0  # what goes on being written opens none
    driver.run(0.05, LIFT_UP, CONTROL_ENABLE | CONTROL_RESET_WATCHDOG)
    assert plant.read().status == STATUS_SUPPLY_ON | STATUS_VALVES_ENABLED
    plant.advance(150_000_000)
    driver.run(0.05, LIFT_UP, CONTROL_ENABLE | CONTROL_RESET_WATCHDOG)  # held, no edge
    assert plant.read().status & STATUS_WATCHDOG_TRIPPED


def test_watchdog_waits_for_a_first_controller(plant: Plant) -> None:
    plant.advance(1_000_000_000)
    assert plant.read().status == STATUS_SUPPLY_ON


def test_non_finite_valves_are_refused(plant: Plant) -> None:
    with pytest.raises(ImageRefused, match="finite"):
        plant.write(ValveImage(1, CONTROL_ENABLE, (0.0, float("nan"), 0.0, 0.0, 0.0, 0.0)))


def test_time_advances_in_whole_steps_and_owes_the_rest(plant: Plant) -> None:
    plant.advance(700_000)
    assert plant.time_ns == 500_000
    plant.advance(300_000)
    assert plant.time_ns == 1_000_000
    with pytest.raises(ValueError, match="backwards"):
        plant.advance(-1)


@pytest.mark.parametrize("ms", [50, 150])
def test_splitting_an_advance_in_which_the_watchdog_may_trip_changes_nothing(ms: int) -> None:
    one, many = Plant(plant_config(), seed=3), Plant(plant_config(), seed=3)
    for plant in (one, many):
        plant.write(ValveImage(1, CONTROL_ENABLE, (0.1, 0.2, -0.1, 0.3, 0.1, -0.2)))
    one.advance(ms * 1_000_000)
    for _ in range(ms):
        many.advance(1_000_000)
    assert bool(one.read().status & STATUS_WATCHDOG_TRIPPED) == (ms > 100)
    np.testing.assert_array_equal(one._state, many._state)


def test_end_stops_hold_the_arm(plant: Plant) -> None:
    driver = Driver(plant)
    driver.run(4.0, (0.0, 1.0, 0.0, 0.0, 0.0, 0.0))
    assert np.degrees(plant.truth().q[1]) == pytest.approx(104.7, abs=1.5)
    driver.run(1.0)
    assert np.abs(plant.truth().q_rate).max() < 0.05


def test_overloaded_start_pose_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"start_pose_deg: .* beyond 190 bar"):
        Plant(plant_config(payload={"mass_kg": 1000.0}, start_pose_deg=[0, 10, -20, 0, 0, 0]), seed=1)


def test_step_too_long_for_the_arms_own_vibration_is_refused() -> None:
    tool = {"tool": {"mass_kg": 0.05, "forward_m": 0.0, "gyration_m": [0.01, 0.01, 0.01]}}
    with pytest.raises(ConfigurationError, match=r"step_ms = 0\.5: must not exceed"):
        Plant(plant_config(masses=tool), seed=1)


def test_start_pose_outside_a_stroke_is_refused() -> None:
    with pytest.raises(
        ConfigurationError, match=r"start_pose_deg: lift at 120 .* outside its stroke of 0 to 0\.5450"
    ):
        Plant(plant_config(start_pose_deg=[0, 120, -60, 0, 0, 0]), seed=1)


def test_oil_warms_under_work_and_its_drift_can_be_switched_off() -> None:
    warm, held = Plant(plant_config(), 1), Plant(plant_config(oil={"thermal_drift": False}), 1)
    for plant in (warm, held):
        driver = Driver(plant)
        for k in range(8):
            driver.run(0.5, (0.0, 0.5 * (-1) ** k, 0.0, 0.0, 0.0, 0.0))
    assert warm.read().oil_temperature_degc > 40.01
    assert held.read().oil_temperature_degc == 40.0
