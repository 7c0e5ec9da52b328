"""A joint trajectory as ROS says it: checked whole before anything moves, then read at any time."""

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import BPoly, PPoly

from longreach_ros2.kinematics import Array
from nominal_arm.description import JOINT_NAMES, NominalArm
from nominal_arm.dimensions import joint_ranges
from protocol.errors import RequestRefused

MOST_POINTS, LONGEST_S = 10_000, 3600.0
START_RAD = 0.01  # [D] of where the joints are commanded to be: as far as a first point at time 0 may be off
AT_REST_RAD_S = 1e-3  # [D] the last point's speed, below which it is rest
_STEP_S = 0.02  # the period of the references: what a path of a single point takes
_ROUNDING = 1e-6
_MOST = 1e6  # [D] rad, rad/s, rad/s²: what is computed of such numbers is finite, so that limits catch it
_NOTHING = 1e-12  # [D] of a segment's largest coefficient: what rounding leaves of a cubic among quintics
_NO_LIMIT = -1.0  # of a JointTolerance
_JOINTS = len(JOINT_NAMES)


class JointPath:
    """Joint angles over time, from 0 to ``duration_s``; at rest at ``goal`` (6,), rad, from there on.

    ``curve`` is the piecewise polynomial through the points, ``rate`` its derivative; joints in the order of
    JOINT_NAMES.
    """

    def __init__(self, curve: BPoly, duration_s: float) -> None:
        self.curve = curve
        self.rate = curve.derivative()
        self.duration_s = duration_s
        self.goal: Array = np.asarray(curve(duration_s))

    def at(self, time_s: float) -> tuple[Array, Array]:
        """Angles (6,), rad, and their rates (6,), rad/s, at ``time_s``."""
        if time_s >= self.duration_s:
            return self.goal, np.zeros(_JOINTS)
        return np.asarray(self.curve(time_s)), np.asarray(self.rate(time_s))


class Limits(NamedTuple):
    """What the joints may do: ``ranges`` (6, 2) rad, ``speeds`` (6,) rad/s."""

    ranges: Array
    speeds: Array


def limits_of(arm: NominalArm) -> Limits:
    """The ranges and speeds of arm.yaml."""
    speeds = [math.radians(joint.speed_deg_s) for joint in arm.joints]
    return Limits(np.array(list(joint_ranges(arm).values())), np.array(speeds))


def refused(what: str, words: str) -> RequestRefused:
    """The error for something that ROS asked and the bridge does not pass on; its cause names ``what``."""
    return RequestRefused(f"refused.ros_{what}", words)


def joint_path(message: Any, q_cmd: Sequence[float], limits: Limits) -> JointPath:
    """The path that a ``trajectory_msgs/JointTrajectory`` describes, from joints commanded to ``q_cmd``, rad.

    Between points: cubic by positions and velocities, quintic where both ends have accelerations. A first
    point later than 0 is reached from rest at ``q_cmd``. Raises RequestRefused that names the first thing
    that is wrong; nothing is resampled, cut or slowed down.
    """
    order = joint_order(message.joint_names)
    points = list(message.points)
    if not 1 <= len(points) <= MOST_POINTS:
        raise refused("points", f"{len(points)} points, at least 1 and at most {MOST_POINTS} are followed")
    times = [_seconds(point.time_from_start) for point in points]
    rows = [_rows(number, point, order) for number, point in enumerate(points)]
    _check_times(times)
    _check_rest(rows[-1][1])
    start = np.asarray(q_cmd, dtype=np.float64)
    if times[0] > 0.0:
        times, rows = [0.0, *times], [[start, np.zeros(_JOINTS)], *rows]
    _check_start(rows[0][0], start)
    if len(times) == 1:
        times, rows = [0.0, _STEP_S], [rows[0], [rows[0][0], np.zeros(_JOINTS)]]
    path = JointPath(BPoly.from_derivatives(times, rows), times[-1])
    _check_limits(path, limits)
    return path


def joint_order(names: Iterable[str]) -> list[int]:
    """Where each of our joints stands among ``names``. Raises RequestRefused unless they are all, once."""
    given = list(names)
    missing = [name for name in JOINT_NAMES if name not in given]
    unknown = [name for name in given if name not in JOINT_NAMES]
    if missing or unknown or len(given) != _JOINTS:
        parts = [("missing", missing), ("unknown", unknown)]
        why = (
            "; ".join(f"{word}: {', '.join(some)}" for word, some in parts if some) or "some are named twice"
        )
        raise refused(
            "joints", f"joints {', '.join(given) or 'none'}, this arm has {', '.join(JOINT_NAMES)} ({why})"
        )
    return [given.index(name) for name in JOINT_NAMES]


def tolerances(given: Iterable[Any], usual: float) -> Array:
    """(6,) rad of ``control_msgs/JointTolerance``: 0 means ``usual``, −1 none (infinite).

    Raises RequestRefused for another joint, one twice, another negative value or one that is not finite, and
    for a tolerance of speed or acceleration: neither is judged.
    """
    found = dict.fromkeys(JOINT_NAMES, usual)
    left = set(JOINT_NAMES)
    for one in given:
        if one.name not in left:
            known = "named twice" if one.name in found else f"this arm has {', '.join(JOINT_NAMES)}"
            raise refused("joints", f"tolerance of joint {one.name!r}, {known}")
        left.remove(one.name)
        for what in ("velocity", "acceleration"):
            if math.isfinite(tolerance(f"{one.name}, {what}", getattr(one, what), math.inf)):
                raise refused("tolerance", f"{one.name}: tolerances of {what} are not judged")
        found[one.name] = tolerance(f"{one.name}, position", one.position, usual)
    return np.array(list(found.values()))


def tolerance(what: str, value: float, usual: float) -> float:
    """A tolerance as control_msgs means it: 0 is ``usual``, −1 none (infinite), else positive and finite.

    Raises RequestRefused that names ``what``. ros2_control takes its defaults for what is wrong, with a log.
    """
    if value == 0.0:
        return usual
    if value == _NO_LIMIT:
        return math.inf
    if value > 0.0 and math.isfinite(value):
        return value
    raise refused(
        "tolerance", f"{what}: tolerance {value:g}, allowed are positive ones, 0 (usual), -1 (none)"
    )


def check_within(what: str, q: Sequence[float], desired: Array, most: Array) -> None:
    """Raise RequestRefused if a joint of ``q`` is further from ``desired`` than ``most``, all (6,) rad.

    ``what``, path or goal, is named, as in the cause ``refused.ros_goal_tolerance``.
    """
    off = np.abs(np.asarray(q) - desired)
    worst = int(np.argmax(off / most))
    if off[worst] > most[worst]:
        words = f"{JOINT_NAMES[worst]} is {1e3 * off[worst]:.2f} mrad off the {what}"
        raise refused(f"{what}_tolerance", f"{words}, limit {1e3 * most[worst]:.2f} mrad")


def _seconds(duration: Any) -> float:
    return float(duration.sec) + 1e-9 * float(duration.nanosec)


def _rows(number: int, point: Any, order: list[int]) -> list[Array]:
    """Positions, velocities and, if there are any, accelerations of one point, in our joints' order."""
    if len(point.velocities) == 0:
        raise refused("velocities", f"point {number} has no velocities: how fast to pass it is not guessed")
    if len(point.effort) > 0:
        raise refused("effort", f"point {number} has efforts: forces are not followed")
    rows = []
    for name in ("positions", "velocities", "accelerations"):
        values = np.asarray(getattr(point, name), dtype=np.float64)
        if name == "accelerations" and len(values) == 0:
            continue
        if len(values) != _JOINTS:
            raise refused("points", f"point {number} has {len(values)} {name}, this arm has {_JOINTS} joints")
        if not np.all(np.abs(values) <= _MOST):
            words = f"point {number}: {name} {values.tolist()} are not all finite, {_MOST:g} at most"
            raise refused("not_finite", words)
        rows.append(values[order])
    return rows


def _check_times(times: list[float]) -> None:
    if times[0] < 0.0:
        raise refused("times", f"point 0 is at {times[0]:g} s, before the start")
    for number, (before, after) in enumerate(pairwise(times), 1):
        if after <= before:
            raise refused(
                "times", f"point {number} is at {after:g} s, not after {before:g} s of the one before"
            )
    if times[-1] > LONGEST_S:
        raise refused("times", f"it takes {times[-1]:g} s, limit {LONGEST_S:g} s")


def _check_rest(rate: Array) -> None:
    joint = int(np.argmax(np.abs(rate)))
    if abs(rate[joint]) > AT_REST_RAD_S:
        words = f"it ends with {JOINT_NAMES[joint]} at {rate[joint]:g} rad/s"
        raise refused("moving_end", f"{words}, limit {AT_REST_RAD_S:g} rad/s: the last point is rest")


def _check_start(first: Array, start: Array) -> None:
    off = np.abs(first - start)
    joint = int(np.argmax(off))
    if off[joint] > START_RAD:
        words = f"it begins {1e3 * off[joint]:.1f} mrad from where {JOINT_NAMES[joint]} is commanded to be"
        raise refused("start", f"{words}, limit {1e3 * START_RAD:g} mrad")


def _check_limits(path: JointPath, limits: Limits) -> None:
    """At each extreme of angles and speeds, not at samples: a polynomial may swing over its points."""
    below, above = limits.ranges.T
    found = _outside(path.curve, below - _ROUNDING, above + _ROUNDING)
    if found is not None:
        joint, time_s, q = found
        words = f"{JOINT_NAMES[joint]} at {math.degrees(q):.2f} deg after {time_s:.9g} s"
        end = limits.ranges[joint, 0 if q < below[joint] else 1]
        raise refused("joint_limit", f"{words}, limit {math.degrees(end):.2f} deg")
    most = limits.speeds * (1.0 + _ROUNDING)
    found = _outside(path.rate, -most, most)
    if found is not None:
        joint, time_s, speed = found
        words = f"{JOINT_NAMES[joint]} at {math.degrees(abs(speed)):.2f} deg/s after {time_s:.9g} s"
        raise refused("too_fast", f"{words}, limit {math.degrees(limits.speeds[joint]):.2f} deg/s")


def _outside(curve: BPoly, low: Array, high: Array) -> tuple[int, float, float] | None:
    """The first joint that leaves ``low`` to ``high`` (6,) anywhere on ``curve``: which, when it is furthest
    out, s, and where it is then. None where all stay inside.

    Looked at are the points and the roots of the derivative, each segment in a unit of its own length, so
    that one of a nanosecond is judged as one of an hour. Joints whose Bernstein coefficients are all
    inside are inside themselves (convex hull: Farouki, CAGD 29, 2012).
    """
    ends = np.arange(len(curve.x), dtype=np.float64)
    for joint in np.flatnonzero(np.any((curve.c < low) | (curve.c > high), axis=(0, 1))):
        piece = BPoly(curve.c[:, :, joint], ends)
        slope = PPoly.from_bernstein_basis(piece.derivative())
        slope.c[np.abs(slope.c) < _NOTHING * np.max(np.abs(slope.c), axis=0)] = 0.0
        roots = slope.roots(extrapolate=False)
        places = np.concatenate((ends, roots[np.isfinite(roots)]))
        values = piece(places)
        out = np.maximum(low[joint] - values, values - high[joint])
        worst = int(np.argmax(out))
        if out[worst] > 0.0:
            return int(joint), float(np.interp(places[worst], ends, curve.x)), float(values[worst])
    return None
