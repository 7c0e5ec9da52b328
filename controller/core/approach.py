"""A jerk-limited way from a moving state to a reference: what follows streamed references.

Ruckig (Berscheid & Kröger, RSS 2021) plans it anew from the present desired position, velocity and
acceleration at every reference, so all three are continuous whatever the references do. It plans in the
coordinates that the Cartesian law works in, x, y, z and the rotation vector to the goal: the tool's speed and
the straight way between two references are then bounded directly, and the servo needs no second kinematics.
The axes' limits are 1/√3 of those of the vectors, so no combination of axes breaks the latter.
"""

import math
from typing import NamedTuple

import numpy as np
from ruckig import InputParameter, Result, Ruckig, Synchronization, Trajectory

from controller.core.paths import Desired, at_rest
from controller.core.rotations import (
    Array,
    angular_motion,
    conjugate,
    quaternion_from_vector,
    quaternion_product,
    vector_from_quaternion,
    vector_rates,
)

AXES = 6
# Share of its speed limit that a moving reference may use: the planner needs some left to catch up.
_TWIST_SHARE = 0.8
_MEETINGS = 12  # at most so many times is the meeting with a moving reference put off
_MEETING_S = 1e-3


class AxisLimits(NamedTuple):
    """Speed, acceleration and jerk of each axis, each (6,): m and rad, per s, s² and s³."""

    speed: Array
    acceleration: Array
    jerk: Array


class Approach(NamedTuple):
    """A planned way to a pose. ``trajectory`` is never written to; ``goal``: unit quaternion (4,).

    ``duration_s`` is infinite when the reference moves: the way then goes on with the reference's velocity.
    """

    trajectory: Trajectory
    goal: Array
    duration_s: float


def approach(
    start: Desired, p: Array, quaternion: Array, twist: Array, limits: AxisLimits
) -> Approach | None:
    """The way from ``start`` to the pose ``p`` (3,), ``quaternion`` (4,) that moves with ``twist`` (6,).

    A moving reference is met where it will be by then: to be where it is now, and as fast, the arm would
    have to go back first. None when there is no way inside the limits, which only a twist beyond
    ``twist_limit`` or limits that are not positive can cause. The same arguments give the same bits.
    """
    if not np.any(twist):
        return _planned(start, p, quaternion, twist, limits)
    meeting_s = 0.0
    for _ in range(_MEETINGS):
        there = quaternion_product(quaternion_from_vector(meeting_s * twist[3:]), quaternion)
        way = _planned(start, p + meeting_s * twist[:3], there, twist, limits)
        if way is None or abs(way.trajectory.duration - meeting_s) < _MEETING_S:
            break
        meeting_s = way.trajectory.duration
    return way


def _planned(
    start: Desired, p: Array, quaternion: Array, twist: Array, limits: AxisLimits
) -> Approach | None:
    theta = vector_from_quaternion(quaternion_product(start.quaternion, conjugate(quaternion)))
    rate, bend = vector_rates(theta, start.omega, start.alpha)
    wanted = InputParameter(AXES)
    wanted.synchronization = Synchronization.Phase
    wanted.current_position = [*start.p.tolist(), *theta.tolist()]
    wanted.current_velocity = [*start.v.tolist(), *rate.tolist()]
    wanted.current_acceleration = [*start.a.tolist(), *bend.tolist()]
    wanted.target_position = [*p.tolist(), 0.0, 0.0, 0.0]
    wanted.target_velocity = twist.tolist()
    wanted.max_velocity = limits.speed.tolist()
    wanted.max_acceleration = limits.acceleration.tolist()
    wanted.max_jerk = limits.jerk.tolist()
    trajectory = Trajectory(AXES)
    planner = Ruckig(AXES)
    if planner.calculate(wanted, trajectory) is not Result.Working:
        return None
    return Approach(trajectory, quaternion, math.inf if np.any(twist) else trajectory.duration)


def twist_limit(limits: AxisLimits) -> Array:
    """The fastest that a reference may move (6,), in each axis."""
    most: Array = _TWIST_SHARE * limits.speed
    return most


def sample_approach(way: Approach, time_s: float) -> Desired:
    """The desired motion ``time_s`` after the start; at rest on the goal, exactly, once it is reached."""
    position, velocity, acceleration = way.trajectory.at_time(min(time_s, way.duration_s))
    p, theta = np.array(position[:3]), np.array(position[3:])
    if time_s >= way.duration_s:
        return at_rest(p, way.goal)
    omega, alpha = angular_motion(theta, np.array(velocity[3:]), np.array(acceleration[3:]))
    return Desired(
        p,
        np.array(velocity[:3]),
        np.array(acceleration[:3]),
        quaternion_product(quaternion_from_vector(theta), way.goal),
        omega,
        alpha,
    )
