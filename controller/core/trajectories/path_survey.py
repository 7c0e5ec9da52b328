"""Can the arm follow a path? Answered before anything moves, by closed-form inverse kinematics along all
of it.

Every segment is sampled at SAMPLES instants: workspace, reach, joint range, wrist flips, and the peaks of
speed and acceleration in Cartesian and in joint terms. Beside the stretched wrist, where wrist 1 and 3 turn
fast, each of the steps is sampled _PARTS times.

While the wrist is as good as stretched, its servo is damped and lets wrist 1 rest. The survey does so too:
it passes from the angles with which the path goes in to those with which it comes out, and refuses what
wrist 1 would have to swing between them.
"""

import math
from typing import NamedTuple

import numpy as np

from controller.core.kinematics.denavit_hartenberg import chain
from controller.core.kinematics.inverse_kinematics import REACHED, joint_angles
from controller.core.kinematics.jacobian import damped_inverse, geometric_jacobian
from controller.core.kinematics.rotations import Array, matrix_from_quaternion
from controller.core.settings import ScanSettings
from controller.core.trajectories.paths import Path, segment_motion
from foundation.compiled import kernel
from protocol.faults import Reason

SAMPLES = (
    24  # a multiple of 2: the peak speed of a quintic is at its middle; peak acceleration is met to 0.1 %
)
# Between two samples of a smooth joint path no joint turns this far; a wrist that flips does.
_FLIP_RAD = 0.6
# Sines of wrist 2 from stretched: damped below the first, where the least singular value is 0.05; within the
# second the next of SAMPLES may lie beyond the singularity.
_DAMPED, _BESIDE = math.sin(math.radians(4.5)), math.sin(math.radians(25.0))
_PARTS = 8
_SWING_RAD = 0.2  # of wrist 1, left to the servo while damped

SPEED, ACCELERATION, TURN_SPEED, TURN_ACCELERATION, JOINT_SPEED = range(5)

_WORKSPACE, _JOINT, _REACH, _SINGULAR = (
    int(Reason.OUTSIDE_WORKSPACE),
    int(Reason.JOINT_LIMIT),
    int(Reason.UNREACHABLE),
    int(Reason.SINGULAR),
)
_ACCEPTED = int(Reason.ACCEPTED)


class Survey(NamedTuple):
    """What the survey found: ACCEPTED, or the first obstacle with its value and limit (m or rad).

    ``peaks``: (n, 5) per segment, columns SPEED … TURN_ACCELERATION (SI), and JOINT_SPEED as the greatest
    ratio of a joint's speed to its limit.
    """

    reason: Reason
    value: float
    limit: float
    peaks: Array


def survey(settings: ScanSettings, path: Path, q_start: Array) -> Survey:
    """The Survey of ``path``, followed on the branch of the joint angles ``q_start``."""
    code, value, limit, peaks = _survey(
        settings.table,
        settings.planned_range,
        settings.joint_speeds,
        settings.workspace,
        settings.config.motion.singular_value_min,
        path.polynomials,
        path.goals,
        path.durations,
        q_start,
    )
    return Survey(Reason(code), value, limit, peaks)


@kernel
def outside(workspace: Array, p: Array) -> tuple[float, float]:
    """The coordinate of ``p`` that leaves the workspace, and its bound (m); equal when it is inside."""
    for axis in range(3):
        low, high = workspace[2 * axis], workspace[2 * axis + 1]
        if p[axis] < low:
            return p[axis], low
        if p[axis] > high:
            return p[axis], high
    radius = math.hypot(p[0], p[1])
    if radius < workspace[6]:
        return radius, workspace[6]
    return 0.0, 0.0


@kernel
def _opened(bounds: Array, p: Array) -> Array:
    """The workspace, widened to contain ``p``: an arm that stands outside may come back, no further out."""
    wide = bounds.copy()
    for axis in range(3):
        wide[2 * axis] = min(wide[2 * axis], p[axis])
        wide[2 * axis + 1] = max(wide[2 * axis + 1], p[axis])
    wide[6] = min(wide[6], math.hypot(p[0], p[1]))
    return wide


@kernel
def _norm(x: Array) -> float:
    return math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])


@kernel
def _nearest_angles(table: Array, R_BT: Array, p_BT: Array, before: Array) -> tuple[int, Array, float, float]:
    """``joint_angles`` on whichever side of the wrist's singularity lies nearer to ``before``.

    A tool that passes straight over the singularity changes sides without a flip; one that passes beside
    it cannot.
    """
    verdict, q, value, limit = joint_angles(table, R_BT, p_BT, before)
    if verdict == REACHED and np.abs(q - before).max() > _FLIP_RAD:
        across = before.copy()
        across[4] = -before[4] - 2.0 * table[4, 2]
        _, other, _, _ = joint_angles(table, R_BT, p_BT, across)
        other[4] -= 2.0 * math.pi * round((other[4] - before[4]) / (2.0 * math.pi))
        if np.abs(other - before).max() < np.abs(q - before).max():
            q = other
    return verdict, q, value, limit


@kernel
def _stretch(table: Array, q: Array) -> float:
    """0 where the wrist is stretched, and wrist 1 and 3 turn about one axis."""
    return abs(math.sin(q[4] + table[4, 2]))


@kernel
def _joint_obstacle(bounds: Array, q: Array, before: Array) -> tuple[int, float, float]:
    for i in range(6):  # first of all, for a wrist that flips may well leave its range with it
        if abs(q[i] - before[i]) > _FLIP_RAD:
            return _SINGULAR, abs(q[i] - before[i]), _FLIP_RAD
    for i in range(6):
        if q[i] < bounds[0, i]:
            return _JOINT, q[i], bounds[0, i]
        if q[i] > bounds[1, i]:
            return _JOINT, q[i], bounds[1, i]
    return _ACCEPTED, 0.0, 0.0


@kernel
def _survey(
    table: Array,
    planned_range: Array,
    joint_speeds: Array,
    workspace: Array,
    singular_min: float,
    polynomials: Array,
    goals: Array,
    durations: Array,
    q_start: Array,
) -> tuple[int, float, float, Array]:
    peaks = np.zeros((durations.shape[0], 5))
    p, _, _, quaternion, _, _ = segment_motion(polynomials[0], goals[0], 0.0)
    space = _opened(workspace, p)
    verdict, q, value, limit = joint_angles(table, matrix_from_quaternion(quaternion), p, q_start)
    if verdict != REACHED:
        return _REACH, value, limit, peaks
    bounds = planned_range.copy()
    bounds[0] = np.minimum(bounds[0], q)
    bounds[1] = np.maximum(bounds[1], q)
    for n in range(durations.shape[0]):  # first what is out of reach, whatever would stop the arm on the way
        p, _, _, quaternion, _, _ = segment_motion(polynomials[n], goals[n], durations[n])
        value, limit = outside(space, p)
        if value != limit:
            return _WORKSPACE, value, limit, peaks
        verdict, _, value, limit = joint_angles(table, matrix_from_quaternion(quaternion), p, q)
        if verdict != REACHED:
            return _REACH, value, limit, peaks
    held = 0.0  # for how long (s) wrist 1 and 3 have rested beside the singularity
    for n in range(durations.shape[0]):
        for k in range(SAMPLES):
            parts = _PARTS if _stretch(table, q) < _BESIDE else 1
            step = durations[n] / (SAMPLES * parts)
            for part in range(1, parts + 1):
                p, v, a, quaternion, omega, alpha = segment_motion(
                    polynomials[n], goals[n], (k * parts + part) * step
                )
                value, limit = outside(space, p)
                if value != limit:
                    return _WORKSPACE, value, limit, peaks
                before = q
                verdict, q, value, limit = _nearest_angles(
                    table, matrix_from_quaternion(quaternion), p, before
                )
                if verdict != REACHED:
                    return _REACH, value, limit, peaks
                damped = _stretch(table, q) < _DAMPED
                if damped:
                    q[3], q[5] = before[3], before[5]
                elif held > 0.0 and abs(q[3] - before[3]) > _SWING_RAD:
                    return _SINGULAR, abs(q[3] - before[3]), _SWING_RAD, peaks
                code, value, limit = _joint_obstacle(bounds, q, before)
                if code != _ACCEPTED:
                    return code, value, limit, peaks
                peaks[n, SPEED] = max(peaks[n, SPEED], _norm(v))
                peaks[n, ACCELERATION] = max(peaks[n, ACCELERATION], _norm(a))
                peaks[n, TURN_SPEED] = max(peaks[n, TURN_SPEED], _norm(omega))
                peaks[n, TURN_ACCELERATION] = max(peaks[n, TURN_ACCELERATION], _norm(alpha))
                for i in range(6):
                    taken = step + held if i == 3 or i == 5 else step
                    ratio = abs(q[i] - before[i]) / (taken * joint_speeds[i])
                    peaks[n, JOINT_SPEED] = max(peaks[n, JOINT_SPEED], ratio)
                held = held + step if damped else 0.0
        _, least, _ = damped_inverse(geometric_jacobian(chain(table, q)), 0.0, 0.0)
        if least < singular_min:
            return _SINGULAR, least, singular_min, peaks
    return _ACCEPTED, 0.0, 0.0, peaks
