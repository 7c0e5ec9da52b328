"""A joint's encoders and its triangles at the captures of a camera, while its valve is tried out; pure.

Two things would otherwise hide plays of 0.03 mrad. An encoder's digit is 0.05 mrad: its readings are smoothed
over a tenth of a second. Stamps of a host that is not real-time scatter by milliseconds, in which a joint
turns by 0.1 mrad, while the camera itself exposes evenly: stamps are put on the line through all of them.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

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
    from scipy.signal import savgol_filter  # half a second of every start, were it imported above

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


_HERTZ = np.arange(0.8, 4.85, 0.1)  # up to half of ten pictures a second
_DAMPINGS = (0.02, 0.08)  # where the search begins
_LEAST_DAMPING, _MOST_DAMPING = 1e-3, 0.4
_FINE_S = 0.01  # steps in which a boom is driven
_TRIES = 60
_MOST_SWINGS = 2
_SWUNG = 0.85  # of what is left without: less is a swing


class Swing(NamedTuple):
    """``omega`` (rad/s) without damping, ``zeta``: its share of the critical one."""

    omega: float
    zeta: float


def swing_columns(swing: Swing, motion: JointMotion, triangles: Sequence[Triangle]) -> Array:
    """What ``swing`` may add to the turn at the captures of all triangles (m, 1 + 2 n), rad: driven first."""
    ends = np.cumsum([0, *(len(one.rows) for one in triangles)])
    found = np.zeros((ends[-1], 1 + 2 * len(triangles)))
    damped = swing.omega * math.sqrt(1.0 - swing.zeta**2)
    for k, one in enumerate(triangles):
        part = slice(ends[k], ends[k + 1])
        t = motion.t[one.rows]
        since = t - t[0]
        fades = np.exp(-swing.zeta * swing.omega * since)
        found[part, 0] = _swing_response(swing, motion, t)
        found[part, 1 + 2 * k] = fades * np.cos(damped * since)
        found[part, 2 + 2 * k] = fades * np.sin(damped * since)
    return found


def _swing_response(swing: Swing, motion: JointMotion, t: Array) -> Array:
    """The boom's own angle less its root's at ``t``, straight and at rest at the first of them.

    The filter is −s²/(s² + 2ζωs + ω²) with s = c (1 − z⁻¹)/(1 + z⁻¹), c two over a step.
    """
    from scipy.signal import lfilter

    step = float(motion.fine_t[1] - motion.fine_t[0])
    every = max(round(_FINE_S / step), 1)
    first = max(int(np.searchsorted(motion.fine_t, t[0])) - 1, 0)
    rows = slice(first, int(np.searchsorted(motion.fine_t, t[-1])) + every + 1, every)
    root = motion.fine_q[rows] - motion.fine_q[first]
    c, drag, spring = 2.0 / (every * step), 2.0 * swing.zeta * swing.omega, swing.omega**2
    a = (c * c + drag * c + spring, 2.0 * (spring - c * c), c * c - drag * c + spring)
    b = (-c * c, 2.0 * c * c, -c * c)
    return np.asarray(np.interp(t, motion.fine_t[rows], lfilter(b, a, root)))


def swings_in(
    turned: Array, fixed: Array, motion: JointMotion, triangles: Sequence[Triangle]
) -> tuple[Swing, ...]:
    """The swings, two at most, that take clearly more away than chance from what the columns ``fixed`` (m, k)
    leave of ``turned`` (m,)."""
    found: tuple[Swing, ...] = ()
    left = rest_of(turned, fixed)
    while len(found) < _MOST_SWINGS:
        known = np.hstack([fixed, *(swing_columns(one, motion, triangles) for one in found)])
        best = _best(turned, known, motion, triangles)
        less = rest_of(turned, np.hstack([known, swing_columns(best, motion, triangles)]))
        if less > _SWUNG * left:
            break
        found, left = (*found, best), less
    return found


def rest_of(turned: Array, columns: Array) -> float:
    """What the best sum of ``columns`` (m, k) leaves of ``turned`` (m,), rms over the degrees of freedom."""
    units = np.maximum(np.abs(columns).max(axis=0), 1e-12)
    solved, *_ = np.linalg.lstsq(columns / units, turned, rcond=None)
    left = turned - (columns / units) @ solved
    return math.sqrt(float(left @ left) / max(len(turned) - columns.shape[1], 1))


def _best(turned: Array, known: Array, motion: JointMotion, triangles: Sequence[Triangle]) -> Swing:
    """The swing that leaves the least beside ``known``: over a grid, and from its best on downhill."""
    basis, _ = np.linalg.qr(known / np.maximum(np.abs(known).max(axis=0), 1e-12))
    target = turned - basis @ (basis.T @ turned)

    def left(omega: float, zeta: float) -> float:
        columns = swing_columns(Swing(omega, zeta), motion, triangles)
        apart = columns - basis @ (basis.T @ columns)
        own, _ = np.linalg.qr(apart / np.maximum(np.abs(apart).max(axis=0), 1e-12))
        return float(np.linalg.norm(target - own @ (own.T @ target)))

    grid = [Swing(2.0 * math.pi * float(hertz), zeta) for hertz in _HERTZ for zeta in _DAMPINGS]
    start = min(grid, key=lambda one: left(*one))
    low, high = (2.0 * math.pi * float(hertz) for hertz in (_HERTZ[0], _HERTZ[-1]))

    def within(point: Array) -> Swing:
        zeta = min(max(math.exp(float(point[1])), _LEAST_DAMPING), _MOST_DAMPING)
        return Swing(min(max(start.omega * math.exp(float(point[0])), low), high), zeta)

    first = [0.0, math.log(start.zeta)]
    around = np.array([first, [0.03, first[1]], [0.0, first[1] + 0.5]])
    fit = minimize(  # type: ignore[call-overload]  # its stubs know no simplex beside a lambda
        lambda point: left(*within(point)),
        first,
        method="Nelder-Mead",
        options={"maxfev": _TRIES, "xatol": 1e-3, "fatol": 1e-9, "initial_simplex": around},
    )
    return within(fit.x)
