"""Can the arm follow a path? Answered before anything moves, by closed-form inverse kinematics along all
of it.

Every segment is sampled at SAMPLES instants: workspace, reach, joint range, wrist flips, and the peaks of
speed and acceleration in Cartesian and in joint terms. Beside the stretched wrist, where wrist 1 and 3 turn
fast, each of the steps is sampled _PARTS times.

While the wrist is as good as stretched, its servo is damped and lets wrist 1 rest, after it has gone on a
little. The survey does so too:
it passes from the angles with which the path goes in to those with which it comes out, and refuses what
wrist 1 would have to swing between them.
"""

import math
from typing import NamedTuple

import numpy as np

from controller.core.kinematics.denavit_hartenberg import chain, damped_inverse, geometric_jacobian
from controller.core.kinematics.inverse_kinematics import REACHED, ArmGeometry, geometry, solve
from controller.core.kinematics.rotations import Angles, Array, Quadruple, Triple, norm, rows
from controller.core.trajectories.paths import Path, pose_on_segment, rates_on_segment, straight
from controller.core.trajectories.workspace import WorkspaceBounds, opened, outside
from foundation.compiled import kernel
from protocol.faults import Reason

SAMPLES = (
    24  # a multiple of 2: the peak speed of a quintic is at its middle; peak acceleration is met to 0.1 %
)
JOINT_MARGIN_DEG = 0.5  # [D] of joint ranges that nothing planned uses
# Between two samples of a smooth joint path no joint turns this far; a wrist that flips does.
_FLIP_RAD = 0.6  # [D]
# Sines of wrist 2 from stretched: damped below the first, where the least singular value is 0.05; within the
# second the next of SAMPLES may lie beyond the singularity.
_DAMPED, _BESIDE = math.sin(math.radians(4.5)), math.sin(math.radians(25.0))
_PARTS = 8  # [D]
_SWING_RAD = 0.2  # [D] of wrist 1, left to the servo while damped
# A step in which no joint turns further, with a wrist bent by more (a sine) at both ends, hides nothing: seen
# from the singularity it is a short chord, so the wrist stays far from being damped, and further still from a
# flip.
_SHORT_RAD, _BENT = 0.05, math.sin(math.radians(10.0))  # [D]

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
    code, value, limit, peaks = _survey(limits, path, q_start, True)
    return Survey(Reason(code), value, limit, peaks)


def survey_straight(
    limits: PlanningLimits, p: Array, quaternion: Array, to: tuple[Array, Array], q_start: Array
) -> tuple[Reason, float, float]:
    """Reason, value and limit of ``survey`` for the straight way from rest at a pose to rest at another one.

    p (3,), quaternion (4,) of both. Ten times as fast: there are no peaks, and of the steps beside the
    stretched wrist only those are divided in which a joint turns far.
    """
    code, value, limit = _survey_straight(limits, p, quaternion, to, q_start)
    return Reason(code), value, limit


@kernel
def _furthest(q: Angles, before: Angles) -> float:
    most = 0.0
    for i in range(6):
        most = max(most, abs(q[i] - before[i]))
    return most


@kernel
def _nearest_angles(
    arm: ArmGeometry, pose: tuple[Triple, Quadruple], before: Angles
) -> tuple[int, Angles, float, float]:
    """``solve`` on whichever side of the wrist's singularity lies nearer to ``before``.

    A tool that passes straight over the singularity changes sides without a flip; one that passes beside
    it cannot.
    """
    R_BT = rows(pose[1])
    verdict, q, value, limit = solve(arm, R_BT, pose[0], before)
    if verdict == REACHED and _furthest(q, before) > _FLIP_RAD:
        wrist_2 = -before[4] - 2.0 * arm.offsets[4]
        across = before[0], before[1], before[2], before[3], wrist_2, before[5]
        _, other, _, _ = solve(arm, R_BT, pose[0], across)
        wrist_2 = other[4] - 2.0 * math.pi * round((other[4] - before[4]) / (2.0 * math.pi))
        other = other[0], other[1], other[2], other[3], wrist_2, other[5]
        if _furthest(other, before) < _furthest(q, before):
            q = other
    return verdict, q, value, limit


@kernel
def _stretch(arm: ArmGeometry, q: Angles) -> float:
    """0 where the wrist is stretched, and wrist 1 and 3 turn about one axis."""
    return abs(math.sin(q[4] + arm.offsets[4]))


@kernel
def _joint_obstacle(bounds: Array, q: Angles, before: Angles) -> tuple[int, float, float]:
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
def _including(limits: PlanningLimits, p: Triple, q: Angles) -> PlanningLimits:
    """``limits`` with range and workspace widened to contain where the arm starts."""
    bounds = limits.planned_range.copy()
    for i in range(6):
        bounds[0, i] = min(bounds[0, i], q[i])
        bounds[1, i] = max(bounds[1, i], q[i])
    space = opened(limits.workspace, p)
    return PlanningLimits(limits.table, bounds, limits.joint_speeds, space, limits.singular_value_min)


@kernel
def _obstacle_at_ends(
    limits: PlanningLimits, arm: ArmGeometry, path: Path, q: Angles
) -> tuple[int, float, float]:
    """The first waypoint that is out of reach, whatever would stop the arm on the way there."""
    for n in range(path.durations.shape[0]):
        p, quaternion = pose_on_segment(path, n, path.durations[n])
        value, limit = outside(limits.workspace, p)
        if value != limit:
            return _WORKSPACE, value, limit
        verdict, _, value, limit = solve(arm, rows(quaternion), p, q)
        if verdict != REACHED:
            return _REACH, value, limit
    return _ACCEPTED, 0.0, 0.0


@kernel
def _coasting_obstacle(
    bounds: Array, arm: ArmGeometry, q: Angles, before: Angles
) -> tuple[int, float, float]:
    """Whether wrist 1 or 3 would leave its range while damping takes hold: they go on by less than a straight
    line, from the last step that was not damped to the singularity, would have them.
    """
    left, gone = math.sin(before[4] + arm.offsets[4]), math.sin(q[4] + arm.offsets[4])
    if abs(left) < _DAMPED or abs(left) <= abs(gone):
        return _ACCEPTED, 0.0, 0.0
    for i in (3, 5):
        end = before[i] + (q[i] - before[i]) * left / (left - gone)
        if end < bounds[0, i]:
            return _JOINT, end, bounds[0, i]
        if end > bounds[1, i]:
            return _JOINT, end, bounds[1, i]
    return _ACCEPTED, 0.0, 0.0


@kernel
def _follow(
    limits: PlanningLimits, arm: ArmGeometry, pose: tuple[Triple, Quadruple], before: Angles, held: float
) -> tuple[int, float, float, Angles, bool]:
    """The obstacle at ``pose``, the joint angles there, and whether the servo is damped.

    ``before``: the joint angles one sample earlier; ``held`` (s): how long wrist 1 and 3 have rested.
    """
    value, limit = outside(limits.workspace, pose[0])
    if value != limit:
        return _WORKSPACE, value, limit, before, False
    verdict, q, value, limit = _nearest_angles(arm, pose, before)
    if verdict != REACHED:
        return _REACH, value, limit, q, False
    damped = _stretch(arm, q) < _DAMPED
    if damped:
        code, value, limit = _coasting_obstacle(limits.planned_range, arm, q, before)
        if code != _ACCEPTED:
            return code, value, limit, q, damped
        q = q[0], q[1], q[2], before[3], q[4], before[5]
    elif held > 0.0 and abs(q[3] - before[3]) > _SWING_RAD:
        return _SINGULAR, abs(q[3] - before[3]), _SWING_RAD, q, damped
    code, value, limit = _joint_obstacle(limits.planned_range, q, before)
    return code, value, limit, q, damped


@kernel
def _raise_peaks(peaks: Array, path: Path, n: int, first: int, last: int, step: float) -> None:
    """Raise ``peaks`` (n, 5) of segment ``n`` to the tool's at its times ``first`` … ``last`` × ``step``."""
    for k in range(first, last + 1):
        v, a, omega, alpha = rates_on_segment(path, n, k * step)
        peaks[n, SPEED] = max(peaks[n, SPEED], norm(v))
        peaks[n, ACCELERATION] = max(peaks[n, ACCELERATION], norm(a))
        peaks[n, TURN_SPEED] = max(peaks[n, TURN_SPEED], norm(omega))
        peaks[n, TURN_ACCELERATION] = max(peaks[n, TURN_ACCELERATION], norm(alpha))


@kernel
def _raise_joint_peak(peaks: Array, n: int, ratio: float) -> None:
    peaks[n, JOINT_SPEED] = max(peaks[n, JOINT_SPEED], ratio)


@kernel
def _joint_ratio(speeds: Array, q: Angles, before: Angles, step: float, held: float) -> float:
    """The greatest share of its speed limit that a joint takes; wrist 1 and 3 have ``held`` (s) more time."""
    most = 0.0
    for i in range(6):
        reach = (step + held if i == 3 or i == 5 else step) * speeds[i]
        most = max(most, abs(q[i] - before[i]) / reach)
    return most


@kernel
def _is_short(
    limits: PlanningLimits, arm: ArmGeometry, X_BT: tuple[Triple, Quadruple], q: Angles, held: float
) -> tuple[bool, Angles]:
    """Whether the step from ``q`` to pose ``X_BT`` has no obstacle that samples within it could find, and the
    joint angles at its end. Joint speeds change by less than 1 % within it."""
    if _stretch(arm, q) < _BENT:
        return False, q
    code, _, _, end, _ = _follow(limits, arm, X_BT, q, held)
    short = code == _ACCEPTED and _stretch(arm, end) >= _BENT and _furthest(end, q) <= _SHORT_RAD
    return short, end


@kernel
def _obstacle_on_segment(
    limits: PlanningLimits, arm: ArmGeometry, path: Path, n: int, q: Angles, held: float, peaks: Array
) -> tuple[int, float, float, Angles, float]:
    """The first obstacle on segment ``n``; joint angles and ``held`` at its end; raises ``peaks`` (n, 5).

    No rows in ``peaks``: nobody asked for them. The joint angles within short steps are not looked at.
    """
    timed = n < peaks.shape[0]
    for k in range(SAMPLES):
        parts = _PARTS if _stretch(arm, q) < _BESIDE else 1
        step = path.durations[n] / (SAMPLES * parts)
        if parts > 1:
            there = pose_on_segment(path, n, (k + 1) * path.durations[n] / SAMPLES)
            short, end = _is_short(limits, arm, there, q, held)
            if short:
                if timed:
                    _raise_peaks(peaks, path, n, k * _PARTS + 1, (k + 1) * _PARTS, step)
                    _raise_joint_peak(
                        peaks, n, _joint_ratio(limits.joint_speeds, end, q, _PARTS * step, held)
                    )
                q, held = end, 0.0
                continue
        for part in range(1, parts + 1):
            t = (k * parts + part) * step
            before = q
            code, value, limit, q, damped = _follow(limits, arm, pose_on_segment(path, n, t), before, held)
            if code != _ACCEPTED:
                return code, value, limit, q, held
            if timed:
                _raise_peaks(peaks, path, n, k * parts + part, k * parts + part, step)
                _raise_joint_peak(peaks, n, _joint_ratio(limits.joint_speeds, q, before, step, held))
            held = held + step if damped else 0.0
    _, least, _ = damped_inverse(geometric_jacobian(chain(limits.table, np.array(q))), 0.0, 0.0)
    if least < limits.singular_value_min:
        return _SINGULAR, least, limits.singular_value_min, q, held
    return _ACCEPTED, 0.0, 0.0, q, held


@kernel
def _survey(
    limits: PlanningLimits, path: Path, q_start: Array, timed: bool
) -> tuple[int, float, float, Array]:
    count = path.durations.shape[0]
    peaks = np.zeros((count if timed else 0, 5))
    arm = geometry(limits.table)
    p, quaternion = pose_on_segment(path, 0, 0.0)
    verdict, q, value, limit = solve(arm, rows(quaternion), p, q_start)
    if verdict != REACHED:
        return _REACH, value, limit, peaks
    wide = _including(limits, p, q)
    code, value, limit = _obstacle_at_ends(wide, arm, path, q)
    held = 0.0  # for how long (s) wrist 1 and 3 have rested beside the singularity
    for n in range(count):
        if code != _ACCEPTED:
            break
        code, value, limit, q, held = _obstacle_on_segment(wide, arm, path, n, q, held, peaks)
    return code, value, limit, peaks


@kernel
def _survey_straight(
    limits: PlanningLimits, p: Array, quaternion: Array, to: tuple[Array, Array], q_start: Array
) -> tuple[int, float, float]:
    code, value, limit, _ = _survey(limits, straight(p, quaternion, to[0], to[1]), q_start, False)
    return code, value, limit
