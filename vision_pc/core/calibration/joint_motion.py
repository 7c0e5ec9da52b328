"""A joint's encoders and its triangles at the captures of a camera, while its valve is tried out; pure.

Two things would otherwise hide plays of 0.03 mrad. An encoder's digit is 0.05 mrad: its readings are smoothed
over a tenth of a second. Stamps of a host that is not real-time scatter by milliseconds, in which a joint
turns by 0.1 mrad, while the camera itself exposes evenly: stamps are put on the line through all of them.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from vision_pc.core.se3 import Array

_LEAST_TURN_RAD = 8e-3  # of a triangle, out or back
_CONSTANT = 1e-3  # of the spool: a step's command stands
_SLOW_RAD_S = 2e-3  # above it the encoder surely moves, and the play is on one side
_CROSSED_RAD = 2e-3  # after so much of a triangle the load has come along
_STANDS_RAD_S, _STANDS_S = 1.0e-3, 0.1  # no longer moving, and for how long
_SMOOTH_S = 0.1  # of an encoder, by parabolas: half a period of the quickest swing that can be seen
_ACCELERATION_S = 0.5  # of its second derivative, which an encoder's digit would drown otherwise
_LEAST_SMOOTHED = 5  # readings
_LEAST_FRAMES = 8  # of a triangle's half
_UNEVEN = 0.25  # of the period: captures further off their line are not evenly taken


class JointSeen(NamedTuple):
    """``joint`` (0…5) while its valve was tried out: ``t`` (n,) s, ``q`` (n, 6) rad, its ``valve`` (n,) as
    commanded.

    ``seen_t`` (m,) s on the same clock: captures; ``X_C0C`` (m, 4, 4): the camera's poses there by odometry.
    """

    joint: int
    t: Array
    q: Array
    valve: Array
    seen_t: Array
    X_C0C: Array


class Triangle(NamedTuple):
    """Captures in the motion of one triangle: indices, sense."""

    rows: NDArray[np.intp]
    sense: float


class JointMotion(NamedTuple):
    """Encoders at captures at ``t`` (m,) s: the joint's angle, speed, acceleration (m,); ``others`` (m, 5).

    ``fine_t``, ``fine_q`` (n,): the joint's smoothed angle at even steps.
    """

    t: Array
    q: Array
    v: Array
    a: Array
    others: Array
    fine_t: Array
    fine_q: Array


def evenly(stamps: Array) -> Array:
    """``stamps`` (m,) s on the line of a camera that exposes evenly; as they are where it does not."""
    steps = np.diff(stamps)
    if len(steps) < _LEAST_FRAMES:
        return stamps
    period = float(np.median(steps))
    number = np.concatenate([[0.0], np.cumsum(np.maximum(np.rint(steps / period), 1.0))])
    slope, first = np.polyfit(number, stamps, 1)
    line = first + slope * number
    return np.asarray(line if np.abs(stamps - line).max() < _UNEVEN * period else stamps)


def motion_at(seen: JointSeen, times: Array) -> JointMotion:
    """The encoders of ``seen`` at ``times`` (m,) s."""
    step = float(np.median(np.diff(seen.t)))
    fine_t = np.arange(seen.t[0], seen.t[-1] + step, step)
    window, wide = (
        max(2 * round(0.5 * span / step) + 1, _LEAST_SMOOTHED) for span in (_SMOOTH_S, _ACCELERATION_S)
    )
    raw = np.column_stack([np.interp(fine_t, seen.t, q) for q in seen.q.T])
    smooth = savgol_filter(raw, window, 2, axis=0)
    speed = savgol_filter(raw[:, seen.joint], window, 2, deriv=1, delta=step)
    gains = savgol_filter(raw[:, seen.joint], wide, 2, deriv=2, delta=step)
    at = [np.interp(times, fine_t, q) for q in smooth.T]
    others = [q - q.mean() for k, q in enumerate(at) if k != seen.joint]
    return JointMotion(
        t=times,
        q=np.asarray(at[seen.joint]),
        v=np.asarray(np.interp(times, fine_t, speed)),
        a=np.asarray(np.interp(times, fine_t, gains)),
        others=np.column_stack(others),
        fine_t=fine_t,
        fine_q=np.asarray(smooth[:, seen.joint]),
    )


def triangles_in(seen: JointSeen, motion: JointMotion) -> list[Triangle]:
    """The captures on every triangle, in order: runs of the valve that are neither steps nor searches."""
    sense = np.sign(seen.valve)
    starts = np.flatnonzero(np.diff(np.concatenate([[0.0], sense])) != 0.0)
    found = []
    for first, end in pairwise([*starts, len(sense)]):
        if sense[first] == 0.0 or end - first < _LEAST_FRAMES:
            continue
        constant = np.ptp(seen.valve[first:end]) < _CONSTANT
        if constant or np.ptp(seen.q[first:end, seen.joint]) < _LEAST_TURN_RAD:
            continue
        inside = (motion.t > seen.t[first]) & (motion.t < _stands_at(motion, seen.t[first], seen.t[end - 1]))
        turned = sense[first] * (motion.q - seen.q[first, seen.joint])
        moves = (sense[first] * motion.v > _SLOW_RAD_S) & (turned > _CROSSED_RAD)
        rows = np.flatnonzero(inside & moves)
        if len(rows) >= _LEAST_FRAMES:
            found.append(Triangle(rows, float(sense[first])))
    return found


def _stands_at(motion: JointMotion, first: float, last: float) -> float:
    """When (s) the joint, having moved between ``first`` and ``last``, stands; ``last`` if it never does.

    A load that swings stands at its turn and may come back through the play: from there on the side on which
    it lies is not known.
    """
    fine = (motion.fine_t >= first) & (motion.fine_t <= last)
    t, q = motion.fine_t[fine], motion.fine_q[fine]
    step = float(motion.fine_t[1] - motion.fine_t[0])
    stands = np.abs(np.gradient(q, step)) < _STANDS_RAD_S
    moved = np.abs(q - q[0]) > _CROSSED_RAD
    lasting = np.convolve(stands & moved, np.ones(max(round(_STANDS_S / step), 1)), mode="full")[: len(q)]
    found = np.flatnonzero(lasting >= round(_STANDS_S / step) - 0.5)
    return float(t[found[0]] - _STANDS_S) if len(found) else last
