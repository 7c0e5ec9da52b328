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
_SETTLED = 0.9  # of the tolerance: a joint that may stay there does not leave it by the encoder's noise
_EARLY = 0.1  # [E] of its deadband, before its edge: there a jog begins, however well that is known
_DAMPING_MAX = 0.05  # [D] bounds joint speeds to 10 times the tool's next to a singularity
# Singular value; exactly no damping above it: wrist 2 further than 4.5° from stretched.
_DAMPING_ONSET = 0.05  # [D]
_LOWERED_MRAD_S = 10.0  # [D] pilots are damped from this speed on; at rest nothing is lowered
_SLOWEST_MRAD_S = 0.4  # [D] 8 digits a second: about the speed that a valve's edge is known to
_PATIENCE_MS = 6000.0  # [D] with valves that are known the joint law arrives sooner on the default arm [M]
_HOLDS_NONE = LoadHolding(np.zeros(6), 1.0, 1.0, 1.0, np.ones(6))


def servo_constants(arm: NominalArm, config: ControllerConfig) -> ServoConstants:
    return ServoConstants(
        gains=_servo_gains(config),
        joints=_joint_gains(config)._replace(holding=_load_holding(arm, config)),
        drives=drive_table(arm.drives),
        rated=rated_circuit(arm.rated),
        dead_zone=config.pose_servo.dead_zone_mrad * _MRAD,
        tolerance=config.settled.tolerance_mrad * _MRAD,
    )


def _servo_gains(config: ControllerConfig) -> ServoGains:
    servo = config.pose_servo
    return ServoGains(
        position=servo.position_gain_1_s,
        orientation=servo.orientation_gain_1_s,
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
    deadband = _edges(config.valves, "deadband") + half
    doubt = np.maximum(np.hypot(std, half_std), np.where(exact[:, None], 0.0, _EARLY * deadband))
    return ParkingLaw(
        band=parking.band_mm * _MM,
        band_most=PARKING_BAND_MOST_MRAD * _MRAD,
        slowest=_SLOWEST_MRAD_S * _MRAD,
        patience=_PATIENCE_MS * _MS,
        tolerance=_SETTLED * config.settled.tolerance_mrad * _MRAD,
        stays=parking.stays_ms * _MS,
        early=np.maximum(deadband - doubt, 0.0),
        doubt=doubt,
        surely_open=surely_open(config.valves),
        latest=late + _BREAKS_AWAY / gain,
        shutting=late + _RUNS_ON / gain,
        loaded=np.array(parking.loaded, dtype=float),
        oil_spring=np.where(exact, 0.0, parking.oil_mrad_bar) * _MRAD,
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
