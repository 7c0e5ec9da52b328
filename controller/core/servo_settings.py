"""The servo's constants from the configuration: gains, what is known of the valves, parking."""

import numpy as np

from controller.config import PARKING_BAND_MOST_MRAD, ControllerConfig
from controller.core.kinematics.rotations import Array
from controller.core.parking.joint import ParkingLaw
from controller.core.servo.joint_control import JointGains, LoadHolding
from controller.core.servo.servo_step import RATIO, ServoConstants, ServoGains, drive_table, rated_circuit
from nominal_arm.commissioned import CURVE_KNOTS, ValveSet
from nominal_arm.description import NominalArm

_MS = 1e-3
_MRAD = 1e-3
_MM = 1e-3
_SURE = 3.0  # standard deviations
_CARRIED = 0.4  # [D] gain times lateness that a joint's loop bears: 23° of its phase
# A joint's gain goes with the pace of its oil's spring: so long, times the gain, until a joint breaks away,
# and until it rests after its valve has shut.
_BREAKS_AWAY, _RUNS_ON = 0.7, 0.3  # [E]
_SETTLED = 0.9  # of the tolerance: a joint that rests is brought back before the arm is not settled any more
_DAMPING_MAX = 0.05  # [D] bounds joint speeds to 10 times the tool's next to a singularity
# Singular value; exactly no damping above it: wrist 2 further than 4.5° from stretched.
_DAMPING_ONSET = 0.05  # [D]
_LOWERED_MRAD_S = 10.0  # [D] pilots are damped from this speed on; at rest nothing is lowered
_BAND_LEAST_MRAD = 0.03  # [D] 0.6 of an encoder digit: the mean of half a second tells a tenth
_SLOWEST_MRAD_S = 0.4  # [D] 8 digits a second: about the speed that a valve's edge is known to
_FASTEST_MRAD_S = 10.0  # [D] 40 mm/s at 4 m
_PATIENCE_MS = 6000.0  # [D] with valves that are known the joint law arrives sooner on the default arm [M]
_QUIET_MM = 0.1  # [D] of the tool, by each joint: parked is what has moved no further for 10 s
_HOLDS_NONE = LoadHolding(np.zeros(6), 1.0, 1.0, 1.0, np.ones(6))


def servo_constants(arm: NominalArm, config: ControllerConfig) -> ServoConstants:
    return ServoConstants(
        gains=_servo_gains(config),
        joints=_joint_gains(config)._replace(holding=_load_holding(arm, config)),
        drives=drive_table(arm.drives),
        rated=rated_circuit(arm.rated),
        tolerance=config.settled.tolerance_mrad * _MRAD,
    )


def _servo_gains(config: ControllerConfig) -> ServoGains:
    servo = config.pose_servo
    return ServoGains(
        position=servo.position_gain_1_s,
        orientation=servo.orientation_gain_1_s,
        dead_zone=servo.dead_zone_mrad * _MRAD,
        damping_onset=_DAMPING_ONSET,
        damping_max=_DAMPING_MAX,
    )


def _joint_gains(config: ControllerConfig) -> JointGains:
    joint, valves = config.joint_control, config.valves
    tau, late = joint.pt1_time_constant_ms * _MS, _lateness(config)
    flow_gain, curve = _edges(valves, "flow_gain"), _curves(valves)
    begins = flow_gain * curve[:, :, 1, 1] / curve[:, :, 1, 0]
    return JointGains(
        gain=np.minimum(joint.gain_1_s, _CARRIED / late),
        time_constant=np.array([0.0, tau, tau, 0.0, 0.0, 0.0]),  # (25) is for lift and tilt alone
        feed_forward=joint.feed_forward,
        damping=np.array(joint.pressure_damping_mrad_s_bar) * _MRAD,
        high_pass=joint.pressure_high_pass_ms * _MS,
        deadband=_edges(valves, "deadband"),
        flow_gain=flow_gain,
        blend=joint.deadband_blend / begins,
        curve=curve,
        half_play=np.array([0.5 * valve.hysteresis.value for valve in valves.joints]),
        limit=joint.valve_limit,
        holding=_HOLDS_NONE,
    )


def _load_holding(arm: NominalArm, config: ControllerConfig) -> LoadHolding:
    """Nothing where the flow goes with the load: that damps by itself, and holds no loads."""
    holding = config.load_holding
    damping = np.array(holding.pilot_damping_mrad_s_bar) * _MRAD
    return LoadHolding(
        damping=damping if config.valves.pressure_compensated else np.zeros(6),
        high_pass=holding.pilot_high_pass_ms * _MS,
        slowest=_LOWERED_MRAD_S * _MRAD,
        setting=holding.setting_bar,
        lifted=holding.pilot_ratio / drive_table(arm.drives)[:, RATIO],
    )


def _lateness(config: ControllerConfig) -> Array:
    """How late (s) a joint's flow follows the measurement that it answers to, (6,)."""
    valves = config.valves.joints
    return _MS * np.array([v.delay_ms.value + v.lag_ms.value + 1.5 * config.cycle_ms for v in valves])


def _curves(valves: ValveSet) -> Array:
    """The flow curves (6, 2, n, 2) as knots from (0, 0) on; short ones go on with their last slope."""
    curves = np.empty((len(valves.joints), 2, CURVE_KNOTS + 1, 2))
    for i, valve in enumerate(valves.joints):
        for side, edge in enumerate((valve.raising, valve.lowering)):
            knots = [(0.0, 0.0), *(edge.curve or ((1.0, 1.0),))]
            while len(knots) <= CURVE_KNOTS:
                (x0, y0), (x1, y1) = knots[-2:]
                knots.append((2.0 * x1 - x0, 2.0 * y1 - y0))
            curves[i, side] = knots
    return curves


def parking_law(config: ControllerConfig) -> ParkingLaw | None:
    """The law by which the arm parks; None where the joint law goes on."""
    return _parking_law(config) if config.parks else None


def _parking_law(config: ControllerConfig) -> ParkingLaw:
    parking, valves = config.parking, config.valves.joints
    exact = np.array([valve.exact for valve in valves])
    half = np.array([[0.5 * valve.hysteresis.value] for valve in valves])
    half_std = np.array([[0.5 * valve.hysteresis.std] for valve in valves])
    std = np.array([[edge.deadband.std for edge in (valve.raising, valve.lowering)] for valve in valves])
    gain, late = _joint_gains(config).gain, _lateness(config)
    return ParkingLaw(
        band=parking.band_mm * _MM,
        band_least=_BAND_LEAST_MRAD * _MRAD,
        band_most=PARKING_BAND_MOST_MRAD * _MRAD,
        slowest=_SLOWEST_MRAD_S * _MRAD,
        fastest=_FASTEST_MRAD_S * _MRAD,
        patience=_PATIENCE_MS * _MS,
        calm_travel=parking.calm_mm * _MM,
        calm=parking.calm_ms * _MS,
        settled=_SETTLED * config.settled.tolerance_mrad * _MRAD,
        give_up=parking.stays_ms * _MS,
        quiet=_QUIET_MM * _MM,
        deadband=_edges(config.valves, "deadband") + half,
        spread=np.hypot(std, half_std),
        latest=late + _BREAKS_AWAY / gain,
        shutting=late + _RUNS_ON / gain,
        loaded=np.array(parking.loaded, dtype=float),
        oil_spring=np.where(exact, 0.0, parking.oil_mrad_bar) * _MRAD,
        surely_open=surely_open(config.valves),
        dt_s=config.cycle_ms * _MS,
    )


def _edges(valves: ValveSet, name: str) -> Array:
    """A number (6, 2) of the six valves, raising and lowering."""
    return np.array(
        [[getattr(edge, name).value for edge in (valve.raising, valve.lowering)] for valve in valves.joints]
    )


def surely_open(valves: ValveSet) -> Array:
    """Spool commands (6, 2) beyond which every valve is open, however little is known of it."""
    return np.array(
        [
            [
                edge.deadband.value + _SURE * edge.deadband.std + valve.hysteresis.value
                for edge in (valve.raising, valve.lowering)
            ]
            for valve in valves.joints
        ]
    )
