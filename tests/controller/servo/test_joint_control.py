"""PT-1 against its analytic step response; valve commands term by term; the linkage's speed map."""

import math

import numpy as np
import pytest

from controller.core.kinematics.rotations import Array, exponential, quaternion_product
from controller.core.servo.joint_control import (
    JointFilters,
    JointGains,
    LoadHolding,
    Pressures,
    pt1_step,
    unmoved,
    valve_commands,
)
from controller.core.servo.servo_step import (
    LONG,
    SHORT,
    ServoGains,
    drive_table,
    full_spool_speeds,
    load_pressures,
    rated_circuit,
    resolve,
    tool_state,
)
from controller.core.trajectories.paths import at_rest
from nominal_arm.description import NominalArm

ONES = np.ones(6)
REST = unmoved(np.zeros(6), np.zeros(6))
PLAIN = JointGains(
    gain=2.0 * ONES,
    time_constant=np.zeros(6),
    feed_forward=0.0,
    damping=np.zeros(6),
    high_pass=1.0,
    deadband=np.zeros((6, 2)),
    flow_gain=np.ones((6, 2)),
    blend=np.full((6, 2), 0.001),
    curve=np.tile(np.array([[0.0, 0.0], [1.0, 1.0]]), (6, 2, 1, 1)),
    half_play=0.0 * ONES,
    limit=1.0,
    holding=LoadHolding(np.zeros(6), 1.0, 0.01, 250.0, 4.0 * ONES),
)
SPEEDS = np.stack([2.0 * ONES, 4.0 * ONES], axis=1)
NO_LOAD = Pressures(np.zeros(6), np.zeros(6))


def loaded(bar: float) -> Pressures:
    return Pressures(bar * ONES, np.zeros(6))


@pytest.mark.parametrize("dt_s", [0.001, 0.005, 0.01])
@pytest.mark.parametrize("tau", [0.02, 0.1, 1.0])
def test_pt1_equals_the_analytic_step_response_at_every_sample(dt_s: float, tau: float) -> None:
    value = 0.0
    for k in range(200):
        assert value == pytest.approx(3.0 * (1.0 - math.exp(-k * dt_s / tau)), abs=1e-12)
        value = pt1_step(value, 3.0, tau, dt_s)


def test_proportional_law_is_scaled_by_the_nominal_speeds() -> None:
    error = np.array([0.1, -0.1, 0.2, 0.0, -0.2, 0.05])
    u, _ = valve_commands(PLAIN, REST, error, np.zeros(6), NO_LOAD, SPEEDS, 0.005)
    assert u == pytest.approx(np.where(error > 0, 2.0 * error / 2.0, 2.0 * error / 4.0))


def test_lift_and_tilt_pass_through_their_pt1_the_others_do_not() -> None:
    gains = PLAIN._replace(time_constant=np.array([0.0, 0.1, 0.1, 0.0, 0.0, 0.0]))
    filters, trace = REST, []
    for _ in range(100):
        u, filters = valve_commands(gains, filters, 0.1 * ONES, np.zeros(6), NO_LOAD, SPEEDS, 0.005)
        trace.append(u)
    times = 0.005 * np.arange(100)
    for joint in range(6):
        want = 0.1 * (1.0 - np.exp(-times / 0.1)) if joint in (1, 2) else np.full(100, 0.1)
        assert np.array(trace)[:, joint] == pytest.approx(want, abs=1e-12)


def test_feed_forward_gives_the_nominal_spool_for_the_speed() -> None:
    speed = np.array([0.2, -0.2, 0.4, -0.4, 0.0, 0.1])
    u, _ = valve_commands(PLAIN._replace(feed_forward=1.0), REST, 0 * ONES, speed, NO_LOAD, SPEEDS, 0.005)
    assert u == pytest.approx(np.where(speed > 0, speed / 2.0, speed / 4.0))


def test_deadband_is_added_in_the_sense_of_the_command_and_fades_at_zero() -> None:
    gains = PLAIN._replace(deadband=np.full((6, 2), 0.03), blend=np.full((6, 2), 0.001))
    error = np.array([0.05, -0.05, 0.0005, -0.0005, 0.0, 1e-5])
    u, _ = valve_commands(gains, REST, error, np.zeros(6), NO_LOAD, SPEEDS, 0.005)
    assert u[:2] == pytest.approx([0.05 + 0.03, -0.025 - 0.03])
    assert 0.0 < u[2] < 0.03
    assert u[4] == 0.0
    assert u[5] == pytest.approx(1e-5 + 0.03 * 0.01)


def test_pressure_damping_acts_on_changes_and_forgets_the_static_load() -> None:
    gains = PLAIN._replace(damping=0.002 * ONES, high_pass=0.5)
    filters = unmoved(40.0 * ONES, 0.0 * ONES)
    still, _ = valve_commands(gains, filters, 0 * ONES, 0 * ONES, loaded(40.0), SPEEDS, 0.005)
    assert still == pytest.approx(np.zeros(6))
    first, filters = valve_commands(gains, filters, 0 * ONES, 0 * ONES, loaded(50.0), SPEEDS, 0.005)
    assert first == pytest.approx(-0.002 * 10.0 / 4.0 * ONES)  # yields to a rising load
    for _ in range(1000):
        last, filters = valve_commands(gains, filters, 0 * ONES, 0 * ONES, loaded(50.0), SPEEDS, 0.005)
    assert np.abs(last).max() < 1e-6


def test_commands_stay_inside_the_valve_limit() -> None:
    u, _ = valve_commands(PLAIN._replace(limit=0.8), REST, 9 * ONES, 0 * ONES, NO_LOAD, SPEEDS, 0.005)
    assert u == pytest.approx(0.8 * ONES)


def test_speed_map_equals_the_derivative_of_the_linkage(arm: NominalArm) -> None:
    drives, rated = drive_table(arm.drives), rated_circuit(arm.rated)
    q = np.radians([0.0, 45.0, -90.0, 0.0, 0.0, 0.0])
    speeds = full_spool_speeds(drives, q, rated, rated, np.zeros(6))
    h = 1e-6
    for i, angle in ((1, q[1] - 2.0735), (2, q[2] - 0.41158)):
        long, short = drives[i, LONG], drives[i, SHORT]

        def piston(a: float, long: float = long, short: float = short) -> float:
            return math.sqrt(long**2 + short**2 + 2 * long * short * math.cos(a))

        lever = (piston(angle + h) - piston(angle - h)) / (2 * h)
        assert lever == pytest.approx({1: 0.3111, 2: 0.3061}[i], abs=1e-4)  # validation case 2 of the plant
        assert speeds[i] == pytest.approx([0.660 / lever, 0.534 / lever], rel=1e-6)


def test_speed_map_follows_the_load_as_the_free_velocities_do(arm: NominalArm) -> None:
    """The plant's validation case 8: 54.7 kN slows extension from 0.660 to 0.421 m/s."""
    drives, rated = drive_table(arm.drives), rated_circuit(arm.rated)
    q = np.radians([0.0, 45.0, -90.0, 0.0, 0.0, 0.0])
    load_bar = 54.7e3 / 5.0265e-3 / 1e5
    load = np.array([0.0, load_bar, 0.0, 0.0, 0.0, 0.0])
    free, loaded = (full_spool_speeds(drives, q, rated, rated, now)[1] for now in (np.zeros(6), load))
    assert loaded / free * [0.660, 0.534] == pytest.approx([0.421, 0.738], abs=2e-3)


def test_load_pressure_weighs_the_annulus(arm: NominalArm) -> None:
    load = load_pressures(drive_table(arm.drives), ((100.0, 50.0),) * 6)
    assert load == pytest.approx([50.0, 100.0 - 0.68359 * 50.0, 100.0 - 0.68359 * 50.0, 50.0, 50.0, 50.0])


GAINS = ServoGains(0.8, 1.6, 0.05, 0.05)
ZONE = 1e-4 * ONES
Q = np.radians([10.0, 50.0, -75.0, 15.0, -25.0, 5.0])


def test_the_pose_servo_steers_back_along_the_error(table: Array) -> None:
    tool = tool_state(table, Q)
    turn = np.array(exponential(np.array([0.0, 0.0, 0.01])))
    shift = np.array([0.0, 0.02, 0.0])
    desired = at_rest(tool.p_BT + shift, quaternion_product(turn, tool.quaternion))
    resolved = resolve(tool, desired, GAINS, 0.0 * ONES)
    want = [0.0, 0.8 * 0.02, 0.0, 0.0, 0.0, 1.6 * math.sin(0.005)]
    assert tool.J_BT @ resolved.qd_cmd == pytest.approx(want, abs=1e-12)
    ahead = tool_state(table, Q + resolved.q_error)
    assert ahead.p_BT == pytest.approx(desired.p, abs=2e-4)


def test_inside_the_dead_zone_nothing_integrates_and_the_zone_opens_without_a_step(table: Array) -> None:
    tool = tool_state(table, Q)
    speeds = []
    for size in np.linspace(0.0, 3e-3, 301):
        desired = at_rest(tool.p_BT + np.array([0.0, 0.0, size]), tool.quaternion)
        resolved = resolve(tool, desired, GAINS, ZONE)
        quiet = np.abs(resolved.q_error) <= ZONE
        assert not resolved.qd_cmd[quiet].any()
        speeds.append(resolved.qd_cmd)
    assert np.abs(np.diff(speeds, axis=0)).max() < 2e-5


def test_the_desired_motion_passes_undamped_to_the_joints(table: Array) -> None:
    tool = tool_state(table, Q)
    moving = at_rest(tool.p_BT, tool.quaternion)._replace(
        v=np.array([0.1, -0.05, 0.02]), omega=np.array([0, 0.1, 0.0])
    )
    resolved = resolve(tool, moving, GAINS, ZONE)
    assert resolved.damping_squared == 0.0
    assert tool.J_BT @ resolved.qd_cmd == pytest.approx([0.1, -0.05, 0.02, 0.0, 0.1, 0.0], abs=1e-12)


HOLDING = PLAIN._replace(holding=PLAIN.holding._replace(damping=np.array([0.0, 0.002, 0.0, 0.0, 0.0, 0.0])))
DOWN = np.array([-0.1, -0.1, 0.0, 0.0, 0.0, 0.0])


def lowered(filters: JointFilters, pilot_bar: float, qd_cmd: Array) -> tuple[Array, JointFilters]:
    felt = Pressures(np.zeros(6), pilot_bar * ONES)
    return valve_commands(HOLDING, filters, 0 * ONES, qd_cmd, felt, SPEEDS, 0.005)


def test_the_pilot_pressure_that_lowering_took_is_kept_at_rest_and_filled_up_to_the_next_time() -> None:
    filters = REST._replace(pilot=40.0 * (DOWN < 0.0) * (HOLDING.holding.damping > 0.0))
    first, filters = lowered(filters, 40.0, DOWN)
    assert first == pytest.approx(np.zeros(6))
    assert filters.pilot == pytest.approx([0.0, 40.0, 0.0, 0.0, 0.0, 0.0])
    for bar, qd_cmd in ((10.0, 0 * ONES), (20.0, -DOWN)):  # at rest, and raised
        still, filters = lowered(filters, bar, qd_cmd)
        assert still == pytest.approx(np.zeros(6))
    assert unmoved(np.zeros(6), filters.pilot).pilot[1] == 40.0  # after the valves were shut, too
    again, filters = lowered(filters, 15.0, DOWN)
    assert again == pytest.approx([0.0, 0.002 * (15.0 - 40.0) / 4.0, 0.0, 0.0, 0.0, 0.0])
    for _ in range(2000):
        last, filters = lowered(filters, 15.0, DOWN)
    assert np.abs(last).max() < 1e-6  # a pressure that lasts is no error


def test_a_pilot_pressure_that_rises_too_far_slows_the_lowering() -> None:
    filters = REST._replace(pilot=40.0 * ONES)
    over, _ = lowered(filters, 50.0, DOWN)
    assert over[1] == pytest.approx(0.002 * 10.0 / 2.0)
    slow, _ = lowered(filters, 50.0, 0.05 * DOWN)  # half of the slowest speed in full force
    assert slow[1] == pytest.approx(0.5 * over[1])


def test_before_the_first_lowering_the_data_sheet_says_the_pilot_pressure() -> None:
    first, filters = lowered(REST, 10.0, DOWN)  # no load pressure: 250 = 10 + 4 · 60
    assert first[1] == pytest.approx(0.002 * (10.0 - 60.0) / 4.0)
    assert 59.0 < filters.pilot[1] < 60.0
