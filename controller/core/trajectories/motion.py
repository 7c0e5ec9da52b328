"""Where the desired motion stands: on a path, slowing down along it, or at rest."""

from typing import NamedTuple

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.trajectories.approach import ApproachTrajectory
from controller.core.trajectories.paths import Desired, Path, at_rest


class StopLimits(NamedTuple):
    """What bounds a stop: deceleration (m/s², rad/s²), and the least time it takes (s)."""

    acceleration: float
    turn_acceleration: float
    time_min: float


class DesiredMotion(NamedTuple):
    """Progress along ``path`` (None: holding ``desired``).

    ``time_s``: path time. ``ramp_s``: seconds since a stop began, negative when none did;
    ``ramp_length_s``: how long that stop takes. ``motion_id``: command id of the last accepted reference;
    ``done``: it was passed to its end.
    """

    path: Path | ApproachTrajectory | None
    time_s: float
    ramp_s: float
    ramp_length_s: float
    desired: Desired
    segment: int
    motion_id: int
    done: bool


def holding(p: Array, quaternion: Array, motion_id: int = 0) -> DesiredMotion:
    """Rest at a pose."""
    return DesiredMotion(None, 0.0, -1.0, 0.0, at_rest(p, quaternion), 0, motion_id, False)


def start_motion(path: Path | ApproachTrajectory, motion_id: int) -> DesiredMotion:
    """The start of ``path``."""
    desired, segment = path.sample(0.0)
    return DesiredMotion(path, 0.0, -1.0, 0.0, desired, segment, motion_id, False)


def start_stop(limits: StopLimits, motion: DesiredMotion) -> DesiredMotion:
    """``motion`` with a smooth stop begun: path time slows from 1 to 0, so the tool stays on its path.

    The rate is 1 − 3x² + 2x³, steepest with 1.5 over the stop's length; that gives the length its
    deceleration limit.
    """
    if motion.path is None or motion.ramp_s >= 0.0:
        return motion
    desired = motion.desired
    speed = float(np.linalg.norm(desired.v) + limits.time_min * np.linalg.norm(desired.a))
    turn = float(np.linalg.norm(desired.omega) + limits.time_min * np.linalg.norm(desired.alpha))
    length = max(limits.time_min, 1.5 * speed / limits.acceleration, 1.5 * turn / limits.turn_acceleration)
    return motion._replace(ramp_s=0.0, ramp_length_s=length)


def at_standstill(motion: DesiredMotion) -> bool:
    """Whether the desired motion has come to rest, by the path's end or by a stop."""
    return motion.path is None


def advance(motion: DesiredMotion, dt_s: float) -> DesiredMotion:
    """``motion`` after ``dt_s``; at the end of the path or of a stop it holds there."""
    if motion.path is None:
        return motion
    if motion.ramp_s >= 0.0:
        return _advance_stop(motion, motion.path, dt_s)
    time_s = motion.time_s + dt_s
    desired, segment = motion.path.sample(time_s)
    if time_s >= motion.path.duration_s:
        return motion._replace(path=None, time_s=time_s, desired=desired, segment=segment, done=True)
    return motion._replace(time_s=time_s, desired=desired, segment=segment)


def _advance_stop(motion: DesiredMotion, path: Path | ApproachTrajectory, dt_s: float) -> DesiredMotion:
    length = motion.ramp_length_s
    before = motion.ramp_s / length
    after = min(before + dt_s / length, 1.0)
    time_s = motion.time_s + length * (_travelled(after) - _travelled(before))
    rate = 1.0 - 3.0 * after**2 + 2.0 * after**3
    slope = 6.0 * (after**2 - after) / length
    on_path, segment = path.sample(time_s)
    if after >= 1.0:
        rest = at_rest(on_path.p, on_path.quaternion)
        return motion._replace(path=None, time_s=time_s, ramp_s=-1.0, desired=rest, segment=segment)
    desired = Desired(
        on_path.p,
        on_path.v * rate,
        on_path.a * rate**2 + on_path.v * slope,
        on_path.quaternion,
        on_path.omega * rate,
        on_path.alpha * rate**2 + on_path.omega * slope,
    )
    return motion._replace(time_s=time_s, ramp_s=after * length, desired=desired, segment=segment)


def _travelled(x: float) -> float:
    """The integral of the rate 1 − 3x² + 2x³."""
    return x - x**3 + 0.5 * x**4
