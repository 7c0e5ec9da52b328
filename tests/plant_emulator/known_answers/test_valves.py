"""Overlap and flow curve, hysteresis and slew, compensated flow, load-holding valves."""

import math
from typing import Any

import numpy as np
import pytest

from plant_emulator.config.actuators import BAR, LITRE_PER_MINUTE
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES, JointName, Valve
from plant_emulator.core import layout as col
from plant_emulator.core.hydraulics.valve_commands import ValveCommands, ValveDrive, take
from plant_emulator.core.layout import N_ACTUATORS, PRESSURE_A, PRESSURE_B, RATE, SPOOL, SUPPLY, Q
from plant_emulator.core.plant import Plant
from protocol.process_image import CONTROL_ENABLE, ValveImage
from tests.plant_emulator.known_answers.stand import (
    LIFT,
    LIFT_VALVE,
    Array,
    Stand,
    default_config,
    resting_arm,
)

MOBILE: dict[str, Any] = {"valve_set": "mobile"}
TIGHT: dict[str, Any] = {"errors": {"leakage": {"enabled": False}}}
BARE: dict[str, Any] = {"valves": {"counterbalance": {"lift": False, "tilt": False}}}
EDGES_APART = {"supply_a": 0.004, "return_b": 0.01, "supply_b": 0.02, "return_a": 0.03}
POSE = [0.0, 45.0, -60.0, 0.0, 0.0, 0.0]


def valve_of(config: PlantConfig, name: JointName) -> Valve:
    return config.valves.of(name, getattr(config.actuators, name).rated_flow_l_min)


def edge_flow(stand: Stand, i: int, edge: int, travel: float, drop: float = 20.0 * BAR) -> float:
    """Flow (m³/s) through one edge of valve ``i`` at spool ``travel``, ``drop`` (Pa) along its way."""
    supply, back = float(stand.model.circuit[col.C_SET]), float(stand.model.circuit[col.C_RETURN])
    into_a = edge in (0, 3)
    stand.state[SUPPLY] = supply
    stand.state[SPOOL + i] = travel if edge < 2 else -travel
    stand.state[(PRESSURE_A if into_a else PRESSURE_B) + i] = supply - drop if edge % 2 == 0 else back + drop
    stand.state[(PRESSURE_B if into_a else PRESSURE_A) + i] = 100.0 * BAR
    stand.rates()
    return abs(float(stand.work.flows[i, col.F_NET_A if into_a else col.F_NET_B]))


def opens_at(stand: Stand, i: int, edge: int) -> float:
    """The spool travel at which an edge begins to pass oil, by bisection."""
    shut, passing = 0.0, 1.0
    while passing - shut > 1e-9:
        middle = 0.5 * (shut + passing)
        shut, passing = (shut, middle) if edge_flow(stand, i, edge, middle) > 0.0 else (middle, passing)
    return passing


@pytest.mark.parametrize(
    "changes",
    [MOBILE | BARE, {"valves": {"joints": {"tilt": {"deadband": EDGES_APART}}}}],
    ids=["mobile", "servo"],
)
def test_each_of_24_edges_opens_at_its_overlap(changes: dict[str, Any]) -> None:
    config = default_config(changes, TIGHT)
    stand = Stand(config)
    found = np.array([[opens_at(stand, i, edge) for edge in range(4)] for i in range(6)])
    overlaps = np.array([valve_of(config, name).deadband for name in JOINT_NAMES])
    assert found == pytest.approx(overlaps, abs=2e-9)


def test_flow_grows_with_the_spool_as_configured() -> None:
    config = default_config(MOBILE, BARE, TIGHT)
    stand, valve = Stand(config), valve_of(config, "lift")
    full = edge_flow(stand, LIFT_VALVE, 0, 1.0, 100.0 * BAR)
    half = edge_flow(stand, LIFT_VALVE, 0, 0.5 * (1.0 + valve.deadband[0]), 100.0 * BAR)
    assert full / LITRE_PER_MINUTE == pytest.approx(valve.flow_extend_l_min, abs=1e-3)
    slope = valve.slope_extend
    assert half / full == pytest.approx(0.5 * slope + 0.25 * (1.0 - slope), abs=1e-9)


def test_a_compensator_takes_the_load_out_of_the_flow_and_lets_none_back() -> None:
    config = default_config(MOBILE, BARE, TIGHT)
    stand, kept = Stand(config), config.valves.compensator_bar * BAR
    flows = np.array([edge_flow(stand, 1, 0, 0.5, drop) for drop in np.linspace(3.0, 24.0, 40) * kept])
    assert np.ptp(flows) <= 0.005 * flows.max()
    left, soft = 0.5 * kept / (1.0 + 0.5**4) ** 0.25, config.valves.regularisation_bar * BAR
    share = (left / kept) * ((kept**2 + soft**2) / (left**2 + soft**2)) ** 0.25
    assert edge_flow(stand, 1, 0, 0.5, 0.5 * kept) / flows[-1] == pytest.approx(share, abs=1e-5)
    assert edge_flow(stand, 1, 0, 0.5, -30.0 * BAR) == 0.0
    servo = Stand(default_config(TIGHT))
    root = edge_flow(servo, 1, 0, 0.5, 160.0 * BAR) / edge_flow(servo, 1, 0, 0.5, 40.0 * BAR)
    assert root == pytest.approx(2.0, abs=0.002)


class Bench:
    """A whole plant of which the lift's valve alone is driven."""

    def __init__(self, config: PlantConfig) -> None:
        self.plant, self._cycle = Plant(config, seed=1), 0

    def hold(self, command: float, seconds: float) -> Array:
        """Hold the lift's ``command``; where its spool was, every 5 ms."""
        seen = []
        for _ in range(round(seconds / 5e-3)):
            self._cycle += 1
            self.plant.write(ValveImage(self._cycle, CONTROL_ENABLE, (0.0, command, 0.0, 0.0, 0.0, 0.0)))
            self.plant.advance(5_000_000)
            seen.append(float(self.plant.truth().spools[LIFT_VALVE]))
        return np.array(seen)


def test_hysteresis_is_a_play_between_command_and_spool() -> None:
    config = default_config(MOBILE, {"start_pose_deg": [0.0, 30.0, -75.0, 0.0, -25.0, 0.0]})
    valve, bench = valve_of(config, "lift"), Bench(config)
    up, top = bench.hold(0.06, 0.8)[-1], bench.hold(0.5, 0.8)[-1]
    assert bench.hold(0.5 - 0.9 * valve.hysteresis, 0.8)[-1] == pytest.approx(top, abs=2e-4)
    assert bench.hold(0.06, 0.8)[-1] - up == pytest.approx(valve.hysteresis, abs=2e-4)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_command_beyond_the_stroke_is_the_stroke(sense: float) -> None:
    valves = ValveCommands(ValveDrive((0,) * N_ACTUATORS, (0.0,) * N_ACTUATORS), 1).targets
    take(valves, 2, 1.5 * sense)
    assert valves.commanded.tolist() == valves.spool.tolist() == [0.0, 0.0, sense, 0.0, 0.0, 0.0]


def test_full_strokes_take_as_long_as_a_ramp_a_lag_and_a_delay() -> None:
    """Mean lag: ramp / 2 + 2ζ/ω + delay; 95 % within the times of a PVE's class, ms."""
    config = default_config(MOBILE, {"start_pose_deg": [0.0, 30.0, -75.0, 0.0, -25.0, 0.0]})
    valve, bench = valve_of(config, "lift"), Bench(config)
    centred = bench.hold(0.0, 0.5)[-1]
    out, back = bench.hold(1.0, 1.0), bench.hold(0.0, 1.0)
    lag = 2.0 * valve.damping_ratio / (2.0 * math.pi * valve.bandwidth_hz) + valve.delay_ms * 1e-3
    for answer, rest, rate, low, high in (
        ((out - centred) / (out[-1] - centred), centred, valve.slew_out_per_s, 120.0, 230.0),
        ((out[-1] - back) / (out[-1] - back[-1]), back[-1], valve.slew_back_per_s, 65.0, 175.0),
    ):
        mean = float(np.sum(1.0 - answer)) * 5e-3 + 2.5e-3  # trapezoids, from 1 at the start
        assert mean == pytest.approx(0.5 * (out[-1] - rest) / rate + lag, abs=1e-3)
        assert low <= np.interp(0.95, answer, 5.0 * np.arange(1, len(answer) + 1)) <= high


def sinking_mrad(*changes: dict[str, Any]) -> float:
    """How far the lift sinks in 20 s under 200 kg, its spool leaking."""
    stand = resting_arm(POSE, 200.0, MOBILE, *changes)
    stand.smooth(LIFT_VALVE)
    stand.model.actuators[LIFT_VALVE, col.A_SPOOL_LEAKAGE] = 3.3e-14
    start = float(stand.state[Q + LIFT])
    stand.run(20.0, 5e-4)
    return 1e3 * (start - float(stand.state[Q + LIFT]))


def test_a_load_holding_valve_holds_what_a_leaking_spool_lets_go() -> None:
    assert sinking_mrad() == pytest.approx(0.0, abs=0.2)
    assert sinking_mrad(BARE) >= 3.0


def lowering(mass: float, lag_ms: float) -> tuple[float, float]:
    """Mean speed (m/s) of the lift's piston at 40 % of its spool, and the ripple of its rate."""
    stand = resting_arm(POSE, mass, MOBILE, {"valves": {"counterbalance": {"lag_ms": lag_ms}}})
    stand.command[1] = -0.4
    stand.run(1.5, 5e-4)
    rate, speed = stand.run(
        1.5, 5e-4, lambda s: (s.state[RATE + LIFT], s.work.flows[LIFT_VALVE, col.F_VELOCITY])
    ).T
    return float(speed.mean()), float(rate.std() / abs(rate.mean()))


def test_a_load_is_lowered_at_the_metered_speed_and_a_damped_pilot_calms_it() -> None:
    """Q_b / A_b."""
    config = default_config(MOBILE)
    valve, (_, area_b) = valve_of(config, "lift"), config.actuators.lift.areas()
    opening = (0.4 - valve.deadband[2]) / (1.0 - valve.deadband[2])
    opening *= valve.slope_retract + (1.0 - valve.slope_retract) * opening
    metered = -valve.flow_retract_l_min * LITRE_PER_MINUTE * opening / area_b
    light, ripple = lowering(30.0, 400.0)
    assert light == pytest.approx(metered, rel=0.05)
    assert lowering(200.0, 400.0)[0] == pytest.approx(metered, rel=0.05)
    assert ripple <= 0.25
    assert lowering(30.0, 0.0)[1] >= 1.5 * ripple
