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
from controller.core.trajectories.paths import Desired, Path, segment_motion
from controller.core.trajectories.workspace import WorkspaceBounds, opened, outside
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


class PlanningLimits(NamedTuple):
    """The arm that is surveyed, and what a planned path may ask of it.

    ``table``: as from ``denavit_hartenberg.dh_table``. ``planned_range`` (2, 6): joint range less its margin.
    ``joint_speeds`` (6,): rad/s. ``singular_value_min``: least singular value of the Jacobian at a waypoint.
    """

    table: Array
    planned_range: Array
    joint_speeds: Array
    workspace: WorkspaceBounds
    singular_value_min: float


class Survey(NamedTuple):
    """What the survey found: ACCEPTED, or the first obstacle with its value and limit (m or rad).

    ``peaks``: (n, 5) per segment, columns SPEED … TURN_ACCELERATION (SI), and JOINT_SPEED as the greatest
    ratio of a joint's speed to its limit.
    """

    reason: Reason
    value: float
    limit: float
    peaks: Array


def survey(limits: PlanningLimits, path: Path, q_start: Array) -> Survey:
    """The Survey of ``path``, followed on the branch of the joint angles ``q_start``."""
    code, value, limit, peaks = _survey(limits, path, q_start)
    return Survey(Reason(code), value, limit, peaks)


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
def _including(limits: PlanningLimits, p: Array, q: Array) -> PlanningLimits:
    """``limits`` with range and workspace widened to contain where the arm starts."""
    bounds = limits.planned_range.copy()
    bounds[0] = np.minimum(bounds[0], q)
    bounds[1] = np.maximum(bounds[1], q)
    space = opened(limits.workspace, p)
    return PlanningLimits(limits.table, bounds, limits.joint_speeds, space, limits.singular_value_min)


@kernel
def _obstacle_at_ends(limits: PlanningLimits, path: Path, q: Array) -> tuple[int, float, float]:
    """The first waypoint that is out of reach, whatever would stop the arm on the way there."""
    for n in range(path.durations.shape[0]):
        end = segment_motion(path, n, path.durations[n])
        value, limit = outside(limits.workspace, end.p)
        if value != limit:
            return _WORKSPACE, value, limit
        verdict, _, value, limit = joint_angles(
            limits.table, matrix_from_quaternion(end.quaternion), end.p, q
        )
        if verdict != REACHED:
            return _REACH, value, limit
    return _ACCEPTED, 0.0, 0.0


@kernel
def _follow(
    limits: PlanningLimits, desired: Desired, before: Array, held: float
) -> tuple[int, float, float, Array, bool]:
    """The obstacle at ``desired``, the joint angles there, and whether the servo is damped.

    ``before``: the joint angles one sample earlier; ``held`` (s): how long wrist 1 and 3 have rested.
    """
    value, limit = outside(limits.workspace, desired.p)
    if value != limit:
        return _WORKSPACE, value, limit, before, False
    R_BT = matrix_from_quaternion(desired.quaternion)
    verdict, q, value, limit = _nearest_angles(limits.table, R_BT, desired.p, before)
    if verdict != REACHED:
        return _REACH, value, limit, q, False
    damped = _stretch(limits.table, q) < _DAMPED
    if damped:
        q[3], q[5] = before[3], before[5]
    elif held > 0.0 and abs(q[3] - before[3]) > _SWING_RAD:
        return _SINGULAR, abs(q[3] - before[3]), _SWING_RAD, q, damped
    code, value, limit = _joint_obstacle(limits.planned_range, q, before)
    return code, value, limit, q, damped


@kernel
def _raise_peaks(peaks: Array, desired: Desired, turned: Array, reach: Array) -> None:
    """Raise ``peaks`` (5,) to those of ``desired`` and of joints that ``turned`` (6,).

    ``reach`` (6,): how far the joints' speed limits would have let them turn.
    """
    peaks[SPEED] = max(peaks[SPEED], _norm(desired.v))
    peaks[ACCELERATION] = max(peaks[ACCELERATION], _norm(desired.a))
    peaks[TURN_SPEED] = max(peaks[TURN_SPEED], _norm(desired.omega))
    peaks[TURN_ACCELERATION] = max(peaks[TURN_ACCELERATION], _norm(desired.alpha))
    for i in range(6):
        peaks[JOINT_SPEED] = max(peaks[JOINT_SPEED], abs(turned[i]) / reach[i])


@kernel
def _obstacle_on_segment(
    limits: PlanningLimits, path: Path, n: int, q: Array, held: float, peaks: Array
) -> tuple[int, float, float, Array, float]:
    """The first obstacle on segment ``n``; joint angles and ``held`` at its end; raises ``peaks`` (5,)."""
    reach = np.empty(6)
    for k in range(SAMPLES):
        parts = _PARTS if _stretch(limits.table, q) < _BESIDE else 1
        step = path.durations[n] / (SAMPLES * parts)
        for part in range(1, parts + 1):
            desired = segment_motion(path, n, (k * parts + part) * step)
            before = q
            code, value, limit, q, damped = _follow(limits, desired, before, held)
            if code != _ACCEPTED:
                return code, value, limit, q, held
            for i in range(6):
                reach[i] = (step + held if i == 3 or i == 5 else step) * limits.joint_speeds[i]
            _raise_peaks(peaks, desired, q - before, reach)
            held = held + step if damped else 0.0
    _, least, _ = damped_inverse(geometric_jacobian(chain(limits.table, q)), 0.0, 0.0)
    if least < limits.singular_value_min:
        return _SINGULAR, least, limits.singular_value_min, q, held
    return _ACCEPTED, 0.0, 0.0, q, held


@kernel
def _survey(limits: PlanningLimits, path: Path, q_start: Array) -> tuple[int, float, float, Array]:
    count = path.durations.shape[0]
    peaks = np.zeros((count, 5))
    start = segment_motion(path, 0, 0.0)
    R_BT = matrix_from_quaternion(start.quaternion)
    verdict, q, value, limit = joint_angles(limits.table, R_BT, start.p, q_start)
    if verdict != REACHED:
        return _REACH, value, limit, peaks
    wide = _including(limits, start.p, q)
    code, value, limit = _obstacle_at_ends(wide, path, q)
    held = 0.0  # for how long (s) wrist 1 and 3 have rested beside the singularity
    for n in range(count):
        if code != _ACCEPTED:
            break
        code, value, limit, q, held = _obstacle_on_segment(wide, path, n, q, held, peaks[n])
    return code, value, limit, peaks
