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
    Angles,
    Array,
    conjugate,
    cross_product,
    exponential,
    product,
    quaternion_product,
    rows,
    turned,
    turning,
    vector_from_quaternion,
    vector_rates,
)
from controller.core.trajectories.paths import Desired, at_rest
from foundation.compiled import kernel

AXES = 6
# Share of its speed limit that a moving reference may use: the rest is for catching up with it.
_TWIST_SHARE = 0.8  # [D]


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
        motion = np.array(self.trajectory.at_time(time_s))
        out = np.empty((6, 4))
        _seen_from_base(motion, self.p, self.quaternion, self.twist, time_s, out)
        return Desired(out[0, :3], out[1, :3], out[2, :3], out[3], out[4, :3], out[5, :3]), 0


def approach(
    start: Desired, p: Array, quaternion: Array, twist: Array, limits: AxisLimits
) -> ApproachTrajectory | None:
    """The way from ``start`` to the pose ``p`` (3,), ``quaternion`` (4,) that moves with ``twist`` (6,).

    A moving reference is approached in its own frame, in which it stands: so it is met where it will be by
    then, and the arm never goes back to get up speed. None when there is no way inside the limits, which only
    a twist beyond ``twist_limit`` or limits that are not positive can cause. The same arguments give the same
    bits.
    """
    request = InputParameter(AXES)
    request.current_position, request.current_velocity, request.current_acceleration = _seen_from_reference(
        start, p, quaternion, twist
    )
    request.target_position = [0.0] * AXES
    request.max_velocity = (limits.speed - twist).tolist()
    request.min_velocity = (-limits.speed - twist).tolist()
    request.max_acceleration = limits.acceleration.tolist()
    request.max_jerk = limits.jerk.tolist()
    trajectory = _planned(request)
    if trajectory is None:
        return None
    duration_s = math.inf if np.any(twist) else trajectory.duration
    return ApproachTrajectory(trajectory, p, quaternion, twist, duration_s)


@kernel
def _seen_from_reference(
    start: Desired, p: Array, quaternion: Array, twist: Array
) -> tuple[Angles, Angles, Angles]:
    """Position, velocity and acceleration of ``start`` in the coordinates of the way, in the moving frame."""
    theta = vector_from_quaternion(quaternion_product(start.quaternion, conjugate(quaternion)))
    carried = turned(rows(exponential(theta)), twist[3:])
    own = start.omega - np.array(carried)
    rate, bend = vector_rates(theta, own, start.alpha - np.array(cross_product(own, carried)))
    x, v, a = start.p - p, start.v - twist[:3], start.a
    return (
        (x[0], x[1], x[2], theta[0], theta[1], theta[2]),
        (v[0], v[1], v[2], rate[0], rate[1], rate[2]),
        (a[0], a[1], a[2], bend[0], bend[1], bend[2]),
    )


@kernel
def _seen_from_base(
    motion: Array, p: Array, quaternion: Array, twist: Array, time_s: float, out: Array
) -> None:
    """Fill ``out`` (6, 4), rows as in ``Desired``, with ``motion`` (3, 6) at ``time_s`` of the way.

    ``motion``: position, velocity and acceleration in the coordinates of the way; p, quaternion: of the
    reference at 0, which moves with ``twist``.
    """
    theta = motion[0, 3], motion[0, 4], motion[0, 5]
    turn = exponential(theta)
    carried = turned(rows(turn), (twist[3], twist[4], twist[5]))
    omega, alpha = turning(
        theta, (motion[1, 3], motion[1, 4], motion[1, 5]), (motion[2, 3], motion[2, 4], motion[2, 5])
    )
    moved = exponential((time_s * twist[3], time_s * twist[4], time_s * twist[5]))
    pose = product(turn, product(moved, quaternion))
    aside = cross_product(omega, carried)
    for k in range(4):
        out[3, k] = pose[k]
    for k in range(3):
        out[0, k] = p[k] + time_s * twist[k] + motion[0, k]
        out[1, k] = twist[k] + motion[1, k]
        out[2, k] = motion[2, k]
        out[4, k] = omega[k] + carried[k]
        out[5, k] = alpha[k] + aside[k]


def _planned(request: InputParameter) -> Trajectory | None:
    """The trajectory that ``request`` asks for, axes in step where Ruckig can; None when there is none.

    With some tens of nanometres left, Ruckig's sum of times may be off by more than the way takes, and axes
    that were to arrive together have no solution (its issue 160). Each by itself has one, inside the same
    limits, and so short a way need not be straight.
    """
    for synchronization in (Synchronization.Phase, Synchronization.No):
        request.synchronization = synchronization
        trajectory = Trajectory(AXES)
        try:
            if Ruckig(AXES).calculate(request, trajectory) is Result.Working:
                return trajectory
        except RuckigError:
            continue
    return None


def twist_limit(limits: AxisLimits) -> Array:
    """The fastest that a reference may move (6,), in each axis."""
    most: Array = _TWIST_SHARE * limits.speed
    return most
