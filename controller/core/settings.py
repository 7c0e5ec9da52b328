"""The controller's configuration in the units and arrays that a scan works with."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from controller.config import ControllerConfig
from controller.core.kinematics.denavit_hartenberg import dh_table
from controller.core.kinematics.rotations import Array
from controller.core.servo.drives import drive_table, unloaded
from controller.core.servo.joint_control import JointGains
from controller.core.trajectories.approach import AxisLimits
from nominal_arm.description import NominalArm


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


@dataclass(frozen=True, slots=True)
class ScanSettings:
    """Constants of a scan: SI and radians; arrays are never written to.

    ``servo_gains``: as ``pose_servo.resolve`` takes them. ``workspace``: (7,) x, y, z intervals and least
    radius.
    ``planned_range``: (2, 6) joint range less the margin; ``joint_range`` (2, 6) the range itself.
    ``motion_limits``: (4,) TCP speed, acceleration, turning speed, turning acceleration.
    """

    config: ControllerConfig
    cycle_s: float
    table: Array
    drives: Array
    rated: Array
    servo_gains: Array
    joint_gains: JointGains
    joint_range: Array
    planned_range: Array
    joint_speeds: Array
    motion_limits: Array
    streaming: StreamLimits
    workspace: Array
    following_error: Array


def settings_from(arm: NominalArm, config: ControllerConfig) -> ScanSettings:
    """The Settings that ``arm`` and ``config`` describe."""
    servo, joint, motion = config.pose_servo, config.joint_control, config.motion
    joint_range = np.radians([[j.lower_deg for j in arm.joints], [j.upper_deg for j in arm.joints]])
    margin = math.radians(motion.joint_margin_deg)
    tau = joint.pt1_time_constant_ms * 1e-3
    space = arm.workspace
    return ScanSettings(
        config=config,
        cycle_s=config.cycle_ms * 1e-3,
        table=dh_table(arm.dh),
        drives=drive_table(arm.drives),
        rated=unloaded(arm.rated),
        servo_gains=np.array(
            [
                servo.position_gain_1_s,
                servo.orientation_gain_1_s,
                servo.dead_zone_mrad * 1e-3,
                servo.damping_onset,
                servo.damping_max,
            ]
        ),
        joint_gains=JointGains(
            gain=np.array(joint.gain_1_s),
            time_constant=np.array([0.0, tau, tau, 0.0, 0.0, 0.0]),  # (25) is for lift and tilt alone
            feed_forward=joint.feed_forward,
            damping=np.array(joint.pressure_damping_mrad_s_bar) * 1e-3,
            high_pass=joint.pressure_high_pass_ms * 1e-3,
            deadband=np.array(joint.deadband_compensation),
            blend=joint.deadband_blend,
            limit=joint.valve_limit,
        ),
        joint_range=joint_range,
        planned_range=joint_range + np.array([[margin], [-margin]]),
        joint_speeds=np.radians([j.speed_deg_s for j in arm.joints]),
        motion_limits=np.array(
            [
                motion.speed_m_s,
                motion.acceleration_m_s2,
                math.radians(motion.turn_speed_deg_s),
                math.radians(motion.turn_acceleration_deg_s2),
            ]
        ),
        streaming=_stream_limits(config),
        workspace=np.array([*space.x_m, *space.y_m, *space.z_m, space.radius_min_m]),
        following_error=np.radians(config.supervision.following_error_deg),
    )


def _stream_limits(config: ControllerConfig) -> StreamLimits:
    stream = config.streaming
    share = 1.0 / math.sqrt(3.0)  # of a vector's bound that each of its axes has

    def axes(linear: float, turning_deg: float) -> Array:
        return share * np.repeat([linear, math.radians(turning_deg)], 3)

    close_s, ramp_s = config.stream_close_ms * 1e-3, stream.ramp_ms * 1e-3
    return StreamLimits(
        axes=AxisLimits(
            axes(stream.speed_m_s, stream.turn_speed_deg_s),
            axes(stream.acceleration_m_s2, stream.turn_acceleration_deg_s2),
            axes(stream.jerk_m_s3, stream.turn_jerk_deg_s3),
        ),
        distance_m=stream.distance_m,
        turn_rad=math.radians(stream.turn_deg),
        max_age_s=stream.max_age_ms * 1e-3,
        first_s=stream.first_reference_ms * 1e-3,
        slow_s=close_s - ramp_s,
        close_s=close_s,
        ramp_s=ramp_s,
        recovery_s=stream.recovery_ms * 1e-3,
    )
