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
from ruckig import InputParameter, Result, Ruckig, RuckigError, Synchronization, Trajectory

from controller.core.kinematics.rotations import (
    Array,
    angular_motion,
    conjugate,
    cross,
    matrix_from_quaternion,
    quaternion_from_vector,
    quaternion_product,
    vector_from_quaternion,
    vector_rates,
)
from controller.core.trajectories.paths import Desired, at_rest

AXES = 6
# Share of its speed limit that a moving reference may use: the rest is for catching up with it.
_TWIST_SHARE = 0.8


class AxisLimits(NamedTuple):
    """Speed, acceleration and jerk of each axis, each (6,): m and rad, per s, s² and s³."""

    speed: Array
    acceleration: Array
    jerk: Array


class ApproachTrajectory(NamedTuple):
    """A planned way to a reference: the pose ``p`` (3,), ``quaternion`` (4,), moving with ``twist`` (6,).

    ``trajectory``: towards the reference and seen from it, never written to. ``duration_s``: infinite when
    the reference moves, for the way then goes on with it.
    """

    trajectory: Trajectory
    p: Array
    quaternion: Array
    twist: Array
    duration_s: float

    def sample(self, time_s: float) -> tuple[Desired, int]:
        """The desired motion ``time_s`` after the start, at rest from ``duration_s`` on; segment 0."""
        if time_s >= self.duration_s:
            return at_rest(self.p, self.quaternion), 0
        position, velocity, acceleration = map(np.array, self.trajectory.at_time(time_s))
        turn = quaternion_from_vector(position[3:])
        carried = matrix_from_quaternion(turn) @ self.twist[3:]
        turning, bending = angular_motion(position[3:], velocity[3:], acceleration[3:])
        there = quaternion_product(quaternion_from_vector(time_s * self.twist[3:]), self.quaternion)
        desired = Desired(
            self.p + time_s * self.twist[:3] + position[:3],
            self.twist[:3] + velocity[:3],
            acceleration[:3],
            quaternion_product(turn, there),
            turning + carried,
            bending + cross(turning, carried),
        )
        return desired, 0


def approach(
    start: Desired, p: Array, quaternion: Array, twist: Array, limits: AxisLimits
) -> ApproachTrajectory | None:
    """The way from ``start`` to the pose ``p`` (3,), ``quaternion`` (4,) that moves with ``twist`` (6,).

    A moving reference is approached in its own frame, in which it stands: so it is met where it will be by
    then, and the arm never goes back to get up speed. None when there is no way inside the limits, which only
    a twist beyond ``twist_limit`` or limits that are not positive can cause. The same arguments give the same
    bits.
    """
    theta = vector_from_quaternion(quaternion_product(start.quaternion, conjugate(quaternion)))
    carried = matrix_from_quaternion(quaternion_from_vector(theta)) @ twist[3:]
    turning = start.omega - carried
    rate, bend = vector_rates(theta, turning, start.alpha - cross(turning, carried))
    wanted = InputParameter(AXES)
    wanted.current_position = [*(start.p - p).tolist(), *theta.tolist()]
    wanted.current_velocity = [*(start.v - twist[:3]).tolist(), *rate.tolist()]
    wanted.current_acceleration = [*start.a.tolist(), *bend.tolist()]
    wanted.target_position = [0.0] * AXES
    wanted.max_velocity = (limits.speed - twist).tolist()
    wanted.min_velocity = (-limits.speed - twist).tolist()
    wanted.max_acceleration = limits.acceleration.tolist()
    wanted.max_jerk = limits.jerk.tolist()
    trajectory = _planned(wanted)
    if trajectory is None:
        return None
    duration_s = math.inf if np.any(twist) else trajectory.duration
    return ApproachTrajectory(trajectory, p, quaternion, twist, duration_s)


def _planned(wanted: InputParameter) -> Trajectory | None:
    """The trajectory that ``wanted`` asks for, axes in step where Ruckig can; None when there is none.

    With some tens of nanometres left, Ruckig's sum of times may be off by more than the way takes, and axes
    that were to arrive together have no solution (its issue 160). Each by itself has one, inside the same
    limits, and so short a way need not be straight.
    """
    for synchronization in (Synchronization.Phase, Synchronization.No):
        wanted.synchronization = synchronization
        trajectory = Trajectory(AXES)
        try:
            if Ruckig(AXES).calculate(wanted, trajectory) is Result.Working:
                return trajectory
        except RuckigError:
            continue
    return None


def twist_limit(limits: AxisLimits) -> Array:
    """The fastest that a reference may move (6,), in each axis."""
    most: Array = _TWIST_SHARE * limits.speed
    return most
