"""The controller's configuration as a scan works with it: SI and radians, pressures in bar, typed fields."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from controller.commissioning import commissioned_config
from controller.config import ControllerConfig
from controller.core.kinematics.denavit_hartenberg import dh_table
from controller.core.kinematics.rotations import Array
from controller.core.parking.joint import ParkingLaw
from controller.core.servo.servo_step import ServoConstants
from controller.core.servo_settings import parking_law, servo_constants, surely_open
from controller.core.trajectories.approach import AxisLimits
from controller.core.trajectories.motion import StopLimits
from controller.core.trajectories.path_survey import JOINT_MARGIN_DEG, PlanningLimits
from controller.core.trajectories.workspace import WorkspaceBounds, widened
from nominal_arm.description import NominalArm

_MS = 1e-3
_MRAD = 1e-3
_SUPPLY_LOW_MS = 200.0  # [D] two axes at full flow may sag it for a moment
_VALVES_ENABLE_MS = 250.0  # [D]
_EXCHANGES_AT_MS = 5.0  # [D] limits that count exchanges hold from this cycle on


class MotionLimits(NamedTuple):
    """What bounds planned motion: tool speeds, accelerations, durations (s), way to the first point (m)."""

    speed: float
    acceleration: float
    turn_speed: float
    turn_acceleration: float
    duration_min: float
    duration_max: float
    first_point_distance: float

    def of_peaks(self) -> Array:
        """The limits (5,) of the columns of ``Survey.peaks``."""
        return np.array([self.speed, self.acceleration, self.turn_speed, self.turn_acceleration, 1.0])


class StreamLimits(NamedTuple):
    """What bounds streamed references, SI and radians.

    ``axes``: of the way to a reference. ``distance_m``, ``turn_rad``: of a reference from the commanded pose.
    Silence (s) after which the arm is slowed down, ``slow_s``, over ``ramp_s``, and after which the valves
    are centred, ``close_s``; ``first_s`` before the first reference. ``recovery_s``: back to full pace.
    """

    axes: AxisLimits
    distance_m: float
    turn_rad: float
    max_age_s: float
    first_s: float
    slow_s: float
    close_s: float
    ramp_s: float
    recovery_s: float


class SettledLimits(NamedTuple):
    """The arm counts as settled inside this joint-equivalent error (rad) for this time (s)."""

    tolerance: float
    time: float


class SupervisionLimits(NamedTuple):
    """When the controller stops by itself: exchanges and cycles, s, rad, m, m/s, bar where it says so.

    ``overtravel_range`` (2, 6): joint angles beyond which no joint may be driven further out;
    ``workspace``: the tool's, likewise. ``following_error``: (6,) rad. ``encoder_stuck_valves`` (6, 2): spool
    commands, raising and lowering, beyond which a joint must turn.
    """

    missed_exchanges: int
    silence: float
    frozen_exchanges: int
    echo_lag_cycles: int
    overrun: float
    following_error: Array
    encoder_jump: float
    encoder_stuck_valves: Array
    encoder_stuck: float
    overspeed: float
    overspeed_time: float
    supply_min_bar: float
    supply_low: float
    valves_enable: float
    overtravel_range: Array
    workspace: WorkspaceBounds


@dataclass(frozen=True, slots=True)
class ScanSettings:
    """Constants of a scan; arrays are never written to.

    ``load_compensation``: whether the drives' speeds are taken at the present circuit. ``parking``: None when
    the joint law holds the arm.
    """

    cycle_s: float
    table: Array
    load_compensation: bool
    servo: ServoConstants
    parking: ParkingLaw | None
    planning: PlanningLimits
    motion: MotionLimits
    stop: StopLimits
    streaming: StreamLimits
    settled: SettledLimits
    supervision: SupervisionLimits


def settings_from(arm: NominalArm, config: ControllerConfig) -> ScanSettings:
    """The ScanSettings that ``arm`` and ``config`` describe, by its commissioning where it names one.

    Raises ConfigurationError for a commissioning that is not of them, see ``commissioned_config``.
    """
    config = commissioned_config(arm, config)
    motion, settled = config.motion, config.settled
    table, space = dh_table(arm.dh), arm.workspace
    workspace = WorkspaceBounds(np.array([space.x_m, space.y_m, space.z_m]), space.radius_min_m)
    joint_range = np.radians([[j.lower_deg for j in arm.joints], [j.upper_deg for j in arm.joints]])
    margin = math.radians(JOINT_MARGIN_DEG)
    return ScanSettings(
        cycle_s=config.cycle_ms * _MS,
        table=table,
        load_compensation=config.joint_control.load_compensation and not config.valves.pressure_compensated,
        servo=servo_constants(arm, config),
        parking=parking_law(config),
        planning=PlanningLimits(
            table=table,
            planned_range=joint_range + np.array([[margin], [-margin]]),
            joint_speeds=np.radians([j.speed_deg_s for j in arm.joints]),
            workspace=workspace,
            singular_value_min=motion.singular_value_min,
        ),
        motion=MotionLimits(
            speed=motion.speed_m_s,
            acceleration=motion.acceleration_m_s2,
            turn_speed=math.radians(motion.turn_speed_deg_s),
            turn_acceleration=math.radians(motion.turn_acceleration_deg_s2),
            duration_min=motion.duration_min_s,
            duration_max=motion.duration_max_s,
            first_point_distance=motion.first_point_distance_m,
        ),
        stop=StopLimits(
            acceleration=motion.stop_acceleration_m_s2,
            turn_acceleration=math.radians(motion.stop_turn_acceleration_deg_s2),
            time_min=motion.stop_min_s,
        ),
        streaming=_stream_limits(config),
        settled=SettledLimits(settled.tolerance_mrad * _MRAD, settled.time_ms * _MS),
        supervision=_supervision_limits(config, joint_range, workspace),
    )


def _stream_limits(config: ControllerConfig) -> StreamLimits:
    stream = config.streaming
    share = 1.0 / math.sqrt(3.0)  # of a vector's bound that each of its axes has

    def axes(linear: float, turning_deg: float) -> Array:
        return share * np.repeat([linear, math.radians(turning_deg)], 3)

    close_s, ramp_s = config.stream_close_ms * _MS, stream.ramp_ms * _MS
    return StreamLimits(
        axes=AxisLimits(
            axes(stream.speed_m_s, stream.turn_speed_deg_s),
            axes(stream.acceleration_m_s2, stream.turn_acceleration_deg_s2),
            axes(stream.jerk_m_s3, stream.turn_jerk_deg_s3),
        ),
        distance_m=stream.distance_m,
        turn_rad=math.radians(stream.turn_deg),
        max_age_s=stream.max_age_ms * _MS,
        first_s=stream.first_reference_ms * _MS,
        slow_s=close_s - ramp_s,
        close_s=close_s,
        ramp_s=ramp_s,
        recovery_s=stream.recovery_ms * _MS,
    )


def _supervision_limits(
    config: ControllerConfig, joint_range: Array, workspace: WorkspaceBounds
) -> SupervisionLimits:
    watch = config.supervision
    over = math.radians(watch.joint_overtravel_deg)
    return SupervisionLimits(
        missed_exchanges=_exchanges(watch.missed_exchanges, config),
        silence=watch.silence_ms * _MS,
        frozen_exchanges=_exchanges(watch.frozen_exchanges, config),
        echo_lag_cycles=_exchanges(watch.echo_lag_cycles, config),
        overrun=watch.overrun_ms * _MS,
        following_error=np.radians(watch.following_error_deg),
        encoder_jump=math.radians(watch.encoder_jump_deg),
        encoder_stuck_valves=watch.encoder_stuck_opening + surely_open(config.valves),
        encoder_stuck=watch.encoder_stuck_ms * _MS,
        overspeed=watch.overspeed_m_s,
        overspeed_time=watch.overspeed_ms * _MS,
        supply_min_bar=watch.supply_min_bar,
        supply_low=_SUPPLY_LOW_MS * _MS,
        valves_enable=_VALVES_ENABLE_MS * _MS,
        overtravel_range=joint_range + np.array([[-over], [over]]),
        workspace=widened(workspace, watch.workspace_margin_m),
    )


def _exchanges(configured: int, config: ControllerConfig) -> int:
    """So many exchanges, or at a cycle below 5 ms as many as last as long as they do at 5 ms: what holds up
    network and plant counts in time."""
    return max(configured, math.ceil(configured * _EXCHANGES_AT_MS / config.cycle_ms))
