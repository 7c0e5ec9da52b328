"""Families 28 to 31: overlap and flow curve, hysteresis and slew, compensated flow, load-holding valves."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from laboratory.validation.plant_balances import resting_arm
from laboratory.validation.plant_rig import LIFT, Stand, ValidationCase, default_config
from plant_emulator.config.actuators import BAR, LITRE_PER_MINUTE
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES, JointName, Valve
from plant_emulator.core import layout as col
from plant_emulator.core.hydraulics.oil_rates import bulk_modulus
from plant_emulator.core.layout import N_ACTUATORS, PRESSURE_A, PRESSURE_B, RATE, SPOOL, SUPPLY, Q
from plant_emulator.core.plant import Plant
from protocol.process_image import CONTROL_ENABLE, ValveImage

Array = NDArray[np.float64]

MOBILE: dict[str, Any] = {"valve_set": "mobile"}
TIGHT: dict[str, Any] = {"errors": {"leakage": {"enabled": False}}}
PER_EDGE = {"supply_a": 0.004, "return_b": 0.01, "supply_b": 0.02, "return_a": 0.03}
BARE = {"valves": {"counterbalance": {"lift": False, "tilt": False}}}
CYCLE_S = 5e-3
LIFT_VALVE = 1  # its row in the actuator table


def _valve(config: PlantConfig, name: JointName) -> Valve:
    """The valve of joint ``name``."""
    actuator = dict(zip(JOINT_NAMES, config.actuators.in_order(), strict=True))[name]
    return config.valves.of(name, actuator.rated_flow_l_min)


def _edge_flow(stand: Stand, i: int, edge: int, travel: float, drop: float = 20.0 * BAR) -> float:
    """Flow (m³/s) through one edge of valve ``i`` at spool ``travel``, ``drop`` (Pa) along its way."""
    supply, back = float(stand.model.circuit[col.C_SET]), float(stand.model.circuit[col.C_RETURN])
    pressure = supply - drop if edge % 2 == 0 else back + drop
    into_a = edge in (0, 3)
    stand.state[SUPPLY] = supply
    stand.state[SPOOL + i] = travel if edge < 2 else -travel
    stand.state[(PRESSURE_A if into_a else PRESSURE_B) + i] = pressure
    stand.state[(PRESSURE_B if into_a else PRESSURE_A) + i] = 100.0 * BAR
    stand.rates()
    return abs(float(stand.work.flows[i, col.F_NET_A if into_a else col.F_NET_B]))


def _opens_at(stand: Stand, i: int, edge: int) -> float:
    """The spool travel at which an edge begins to pass oil, by bisection."""
    shut, passing = 0.0, 1.0
    while passing - shut > 1e-9:
        middle = 0.5 * (shut + passing)
        if _edge_flow(stand, i, edge, middle) > 0.0:
            passing = middle
        else:
            shut = middle
    return passing


def overlaps(config_dir: Path) -> list[ValidationCase]:
    """Family 28: where each of the 24 edges opens, with either set, and how its flow grows."""
    cases = []
    servo = {"valves": {"joints": {"tilt": {"deadband": PER_EDGE}}}}
    for label, changes in (("mobile", MOBILE | BARE), ("servo, tilt's edges apart", servo)):
        config = default_config(config_dir, changes, TIGHT)
        stand = Stand(config)
        wanted = np.array([_valve(config, name).deadband for name in JOINT_NAMES])
        found = np.array([[_opens_at(stand, i, edge) for edge in range(4)] for i in range(N_ACTUATORS)])
        worst, spread = float(np.abs(found - wanted).max()), float(np.ptp(found))
        cases += [
            ValidationCase(28, f"overlap of 24 edges, {label}", "", 0.0, worst, 2e-9, "configuration"),
            ValidationCase(
                28, f"they differ, {label}", "", float(np.ptp(wanted)), spread, 2e-9, "configuration"
            ),
        ]
    config = default_config(config_dir, MOBILE, BARE, TIGHT)
    stand, valve = Stand(config), _valve(config, "lift")
    full = _edge_flow(stand, LIFT_VALVE, 0, 1.0, 100.0 * BAR)
    half = _edge_flow(stand, LIFT_VALVE, 0, 0.5 * (1.0 + valve.deadband[0]), 100.0 * BAR)
    share = 0.5 * valve.slope_extend + 0.25 * (1.0 - valve.slope_extend)
    rated = full / LITRE_PER_MINUTE
    return [
        *cases,
        ValidationCase(28, "lift, full spool", "l/min", valve.flow_extend_l_min, rated, 1e-3, "rating"),
        ValidationCase(28, "flow of a half-open edge", "", share, half / full, 1e-9, "s (g + (1 − g) s)"),
    ]


class _Bench:
    """A whole plant whose lift valve is told something, its spool watched every cycle."""

    def __init__(self, config: PlantConfig) -> None:
        self.plant = Plant(config, seed=1)
        self._cycle = 0

    def hold(self, command: float, seconds: float) -> Array:
        """Hold the lift's ``command``; where its spool was, every 5 ms."""
        seen = []
        for _ in range(round(seconds / CYCLE_S)):
            self._cycle += 1
            valves = (0.0, command, 0.0, 0.0, 0.0, 0.0)
            self.plant.write(ValveImage(self._cycle, CONTROL_ENABLE, valves))
            self.plant.advance(round(CYCLE_S * 1e9))
            seen.append(float(self.plant.truth().spools[LIFT_VALVE]))
        return np.array(seen)


def hysteresis_and_slew(config_dir: Path) -> list[ValidationCase]:
    """Family 29: the loop between command and spool, and how long full strokes out and back take."""
    config = default_config(config_dir, MOBILE, {"start_pose_deg": [0.0, 30.0, -75.0, 0.0, -25.0, 0.0]})
    valve, bench = _valve(config, "lift"), _Bench(config)
    up = bench.hold(0.06, 0.8)[-1]
    top = bench.hold(0.5, 0.8)[-1]
    turned = bench.hold(0.5 - 0.9 * valve.hysteresis, 0.8)[-1]
    loop = bench.hold(0.06, 0.8)[-1] - up
    centred = bench.hold(0.0, 1.0)[-1]
    out = bench.hold(1.0, 1.0)
    left = bench.hold(0.0, 1.0)
    lag = 2.0 * valve.damping_ratio / (2.0 * math.pi * valve.bandwidth_hz) + valve.delay_ms * 1e-3
    cases = [
        ValidationCase(29, "loop, going down over going up", "", valve.hysteresis, loop, 2e-4, "play"),
        ValidationCase(29, "spool while the command turns within it", "", top, turned, 2e-4, "play"),
    ]
    for label, answer, rest, rate, source in (
        ("out", (out - centred) / (out[-1] - centred), centred, valve.slew_out_per_s, (120.0, 230.0)),
        ("back", (out[-1] - left) / (out[-1] - left[-1]), left[-1], valve.slew_back_per_s, (65.0, 175.0)),
    ):
        stroke = out[-1] - rest
        area = float(np.sum(1.0 - answer)) * CYCLE_S + 0.5 * CYCLE_S  # trapezoids, from 1 at the start
        reaction = float(np.interp(0.95, answer, CYCLE_S * np.arange(1, len(answer) + 1)))
        cases += [
            ValidationCase(
                29, f"mean lag {label}", "ms", 1e3 * (0.5 * stroke / rate + lag), 1e3 * area, 1.0,
                "ramp / 2 + 2ζ/ω + delay",
            ),
            ValidationCase(
                29, f"{label}, 95 % of the stroke, least", "ms", source[0], 1e3 * reaction, 0.0,
                "PVE class", "at_least",
            ),
            ValidationCase(
                29, f"{label}, 95 % of the stroke, most", "ms", source[1], 1e3 * reaction, 0.0,
                "PVE class", "at_most",
            ),
        ]  # fmt: skip
    return cases


def compensated_flow(config_dir: Path) -> list[ValidationCase]:
    """Family 30: what the load does to the flow with compensators and without; a pump that falls short."""
    config = default_config(config_dir, MOBILE, BARE, TIGHT)
    stand, kept = Stand(config), config.valves.compensator_bar * BAR
    flows = np.array([_edge_flow(stand, 1, 0, 0.5, drop) for drop in np.linspace(3.0, 24.0, 40) * kept])
    uneven = float(np.ptp(flows) / flows.max())
    starved = _edge_flow(stand, 1, 0, 0.5, 0.5 * kept) / flows[-1]
    left = 0.5 * kept / (1.0 + 0.5**4) ** 0.25
    soft = config.valves.regularisation_bar * BAR
    share = (left / kept) * ((kept**2 + soft**2) / (left**2 + soft**2)) ** 0.25
    back = _edge_flow(stand, 1, 0, 0.5, -30.0 * BAR)
    servo = Stand(default_config(config_dir, TIGHT))
    root = _edge_flow(servo, 1, 0, 0.5, 160.0 * BAR) / _edge_flow(servo, 1, 0, 0.5, 40.0 * BAR)
    return [
        ValidationCase(30, "change of flow, 21 to 168 bar", "", 0.0, uneven, 0.005, "independent of load"),
        ValidationCase(
            30, "share left at half the margin", "", share, starved, 1e-5, "wide-open compensator"
        ),
        ValidationCase(30, "flow back at 30 bar above supply", "m³/s", 0.0, back, 0.0, "check valve"),
        ValidationCase(30, "flow of four times the drop, servo", "", 2.0, root, 0.002, "√Δp"),
        *_shared_pump(config_dir),
    ]


def _shared_pump(config_dir: Path) -> list[ValidationCase]:
    """Lift and tilt full open on a pump of half of what both ask for: who has the higher load gets less."""
    pump = {"pump": {"flow_limit_l_min": 40.0}}
    stand = resting_arm(config_dir, [0.0, 10.0, -100.0, 0.0, 0.0, 0.0], 150.0, **MOBILE, **pump)
    stand.command[1] = stand.command[2] = 1.0
    stand.run(0.6, 5e-4)
    before, seconds = float(stand.state[SUPPLY]), 0.6
    drawn = np.array(stand.run(seconds, 5e-4, lambda s: s.work.flows[1:3, col.F_SUPPLY].copy())).mean(axis=0)
    after, c = float(stand.state[SUPPLY]), stand.model.circuit
    stiff = bulk_modulus(
        0.5 * (before + after), c[col.C_LINE_VOLUME], c[col.C_MODULUS], 0.0, *c[[col.C_AIR, col.C_EXPONENT]]
    )
    stored = (after - before) / stiff * float(c[col.C_LINE_VOLUME]) / seconds
    given = (float(drawn.sum()) + stored) / LITRE_PER_MINUTE
    return [
        ValidationCase(30, "both on a pump of 40 l/min", "l/min", 40.0, given, 0.5, "Q_max"),
        ValidationCase(
            30, "share of the heavier of the two", "", 0.3, float(drawn[0] / drawn.sum()), 0.0,
            "no flow sharing", "at_most",
        ),
    ]  # fmt: skip


def load_holding(config_dir: Path) -> list[ValidationCase]:
    """Family 31: counterbalance valves hold a load that the spool would let go, and lower it in control."""
    pose, cases = [0.0, 45.0, -60.0, 0.0, 0.0, 0.0], []
    sunk = {}
    for label, changes in (("held", {}), ("bare", BARE)):
        stand = resting_arm(config_dir, pose, 200.0, **MOBILE, **changes)
        stand.smooth(LIFT_VALVE)
        stand.model.actuators[LIFT_VALVE, col.A_SPOOL_LEAKAGE] = 3.3e-14
        start = float(stand.state[Q + LIFT])
        stand.run(20.0, 5e-4)
        sunk[label] = 1e3 * (start - float(stand.state[Q + LIFT]))
    cases.append(
        ValidationCase(31, "sinking over 20 s, leaking spool", "mrad", 0.0, sunk["held"], 0.2, "tight seat")
    )
    cases.append(
        ValidationCase(
            31, "the same without the valve", "mrad", 3.0, sunk["bare"], 0.0, "leaking spool", "at_least"
        )
    )
    return cases + _lowering(config_dir, pose)


def _motion(stand: Stand) -> tuple[float, float]:
    """Rate of the lift (rad/s) and speed of its piston (m/s)."""
    return float(stand.state[RATE + LIFT]), float(stand.work.flows[LIFT_VALVE, col.F_VELOCITY])


def _lowering(config_dir: Path, pose: list[float]) -> list[ValidationCase]:
    """Lowering at 40 % of the spool with a damped and an undamped pilot, 30 kg and 200 kg at the tool."""
    speeds, ripple = {}, {}
    for mass in (30.0, 200.0):
        for lag_ms in (0.0, 400.0):
            hold = {"valves": {"counterbalance": {"lag_ms": lag_ms}}}
            stand = resting_arm(config_dir, pose, mass, **MOBILE, **hold)
            stand.command[1] = -0.4
            stand.run(1.5, 5e-4)
            rate = np.array(stand.run(1.5, 5e-4, _motion))
            speeds[mass, lag_ms] = float(rate[:, 1].mean())
            ripple[mass, lag_ms] = float(rate[:, 0].std() / abs(rate[:, 0].mean()))
    config = default_config(config_dir, MOBILE)
    valve, (_, area_b) = _valve(config, "lift"), config.actuators.lift.areas()
    opening = (0.4 - valve.deadband[2]) / (1.0 - valve.deadband[2])
    opening *= valve.slope_retract + (1.0 - valve.slope_retract) * opening
    metered = -valve.flow_retract_l_min * LITRE_PER_MINUTE * opening / area_b
    light, heavy = speeds[30.0, 400.0], speeds[200.0, 400.0]
    return [
        ValidationCase(31, "lowering 30 kg", "m/s", metered, light, 0.05 * abs(metered), "Q_b / A_b"),
        ValidationCase(31, "lowering 200 kg", "m/s", metered, heavy, 0.05 * abs(metered), "Q_b / A_b"),
        ValidationCase(
            31, "ripple of the speed, damped pilot", "", 0.25, ripple[30.0, 400.0], 0.0,
            "in control", "at_most",
        ),
        ValidationCase(
            31, "undamped over damped", "", 1.5, ripple[30.0, 0.0] / ripple[30.0, 400.0], 0.0,
            "pilot damping", "at_least",
        ),
    ]  # fmt: skip
