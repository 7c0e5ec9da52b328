"""The controller's configuration in the units and arrays that a scan works with."""

import math
from dataclasses import dataclass

import numpy as np

from controller.config import ArmConfig, ControllerConfig
from controller.core.denavit_hartenberg import dh_table
from controller.core.drives import drive_table, unloaded
from controller.core.joint_control import JointGains
from controller.core.rotations import Array


@dataclass(frozen=True, slots=True)
class Settings:
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
    workspace: Array
    following_error: Array


def settings_from(arm: ArmConfig, config: ControllerConfig) -> Settings:
    """The Settings that ``arm`` and ``config`` describe."""
    servo, joint, motion = config.pose_servo, config.joint_control, config.motion
    joint_range = np.radians([[j.lower_deg for j in arm.joints], [j.upper_deg for j in arm.joints]])
    margin = math.radians(motion.joint_margin_deg)
    tau = joint.pt1_time_constant_ms * 1e-3
    space = arm.workspace
    return Settings(
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
        workspace=np.array([*space.x_m, *space.y_m, *space.z_m, space.radius_min_m]),
        following_error=np.radians(config.supervision.following_error_deg),
    )
