"""Play of a joint and the camera's delay, from odometry beside the joint's encoder; pure functions.

While the controller tries out a joint's valve, nothing but that joint moves. What odometry sees of the turn
then differs from the encoder's by the play, by the camera's delay and by what the boom bends:

    y(q) = c₀ + c₁ x + c₂ x² + c₃ x³ + c₁ (b s − τ v + e a + e′ v′) + Σ dₖ qₖ,    x = q − q̄

with s = ±1 the sense of motion, v and a the encoder's speed and acceleration, v′ the part of v that swings
(a boom swings on behind its encoder, and lags), qₖ the encoders of the other joints, which creep behind their
closed valves. Between s = −1 and s = +1 lie
2 b: b > 0 where the tool moves while the encoder stands (play on the encoder's side), b < 0 where the encoder
moves while the tool stands (loose steel behind it). Slow triangles pass the same angles out and back at
many speeds, which keeps b apart from τ. A long boom swings on beside all of that: where one frequency takes
clearly more away than chance, it is fitted along, either as a boom that the encoder's own motion drives, or
as a swing of each triangle's own.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import bilinear, lfilter
from scipy.spatial.transform import Rotation

from protocol.errors import MeasurementFailed
from vision_pc.core.se3 import Array

_LEAST_TURN_RAD = 8e-3  # of a triangle, out or back
_CONSTANT = 1e-3  # of the spool: a step's command stands
_SLOW_RAD_S = 2e-3  # above it the encoder surely moves, and the play is on one side
_CROSSED_RAD = 2e-3  # after so much of a triangle the load has come along
_WINDOW_S = 0.2  # of the encoder's speed and acceleration
_SWING_S = 0.8  # longer than a swing of the boom: what is left of the speed over it does not swing
_SWINGS_RAD_S = 2.0 * math.pi * np.arange(0.4, 4.6, 0.05)  # up to half of ten pictures a second
_DAMPINGS = (0.01, 0.03, 0.1)  # of a boom on its oil
_SWUNG = 0.85  # of what is left without: less is a swing
_LEAST_FRAMES = 8  # of a triangle's half
_LEAST_PAIRS = 2
_FLOOR_RAD = 2.0e-6  # what all triangles share: the arc beyond its third order, swing, the map's points
_FLOOR_SHARE = 0.03  # [M] of the play, lockstep on drawn machines
_DELAY_FLOOR_S = 5e-4


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


class PlayFound(NamedTuple):
    """``half`` ± ``half_std`` (rad): half the play, positive on the encoder's side. ``delay`` ± ``delay_std``
    (s): how late captures are stamped. ``residual`` (rad): what the model leaves. ``triangles``: that
    odometry saw.
    """

    half: float
    half_std: float
    delay: float
    delay_std: float
    residual: float
    triangles: int


class _Rows(NamedTuple):
    """Captures in the motion of one triangle: indices, sense."""

    rows: NDArray[np.intp]
    sense: float


class _Motion(NamedTuple):
    """The encoders at every capture at ``t`` (m,) s: angle, speed, its swinging part and acceleration (m,) of
    the joint, ``others`` (m, 5). ``behind`` (k, m): by what booms of k kinds lag behind it.
    """

    t: Array
    q: Array
    v: Array
    swing: Array
    a: Array
    others: Array
    behind: Array


def joint_play(seen: JointSeen) -> PlayFound:
    """The PlayFound of one joint.

    Raises MeasurementFailed (``measurement.play_unseen``) with fewer than two triangles out and back that
    odometry saw.
    """
    motion = _motion(seen)
    halves = _triangles(seen, motion)
    turns = min(sum(half.sense > 0.0 for half in halves), sum(half.sense < 0.0 for half in halves))
    if turns < _LEAST_PAIRS:
        raise MeasurementFailed(
            "measurement.play_unseen",
            f"{turns} triangles out and back that odometry saw: at least {_LEAST_PAIRS} are wanted",
        )
    turned = Rotation.from_matrix(seen.X_C0C[:, :3, :3]).as_rotvec()
    found = [_found(along, motion, halves) for along in (seen.X_C0C[:, :3, 3], turned)]
    return min(found, key=lambda one: one.residual)


def mean_delay(found: Sequence[PlayFound]) -> tuple[float, float]:
    """The camera's delay and its standard deviation (s) by all joints; there must be one."""
    weights = np.array([1.0 / one.delay_std**2 for one in found])
    delays = np.array([one.delay for one in found])
    mean = float(weights @ delays / weights.sum())
    scatter = math.sqrt(float(weights @ (delays - mean) ** 2) / max(len(found) - 1, 1))
    return mean, max(scatter, 1.0) / math.sqrt(float(weights.sum()))


def _motion(seen: JointSeen) -> _Motion:
    angle, times = seen.q[:, seen.joint], seen.seen_t

    def at(shift: float) -> Array:
        return np.asarray(np.interp(times + shift, seen.t, angle))

    half = 0.5 * _WINDOW_S
    before, here, after = at(-half), at(0.0), at(half)
    speed = (after - before) / _WINDOW_S
    steady = (at(0.5 * _SWING_S) - at(-0.5 * _SWING_S)) / _SWING_S
    columns = [np.interp(times, seen.t, q) for k, q in enumerate(seen.q.T) if k != seen.joint]
    others = np.column_stack(columns)
    return _Motion(
        times,
        here,
        speed,
        speed - steady,
        (after - 2.0 * here + before) / half**2,
        others - others.mean(axis=0) if len(others) else others,
        _behind(seen, times),
    )


def _behind(seen: JointSeen, times: Array) -> Array:
    """For every frequency and damping (k, m): the angle of a boom that the encoder drives, less its own.

    Driven at its root by q the boom's own angle is q through (2ζωs + ω²)/(s² + 2ζωs + ω²): no derivative of
    q is wanted.
    """
    step = float(np.median(np.diff(seen.t)))
    even = np.arange(seen.t[0], seen.t[-1] + step, step)
    q = np.interp(even, seen.t, seen.q[:, seen.joint])
    moved = q - q[0]
    found = []
    for omega in _SWINGS_RAD_S:
        for zeta in _DAMPINGS:
            down = [1.0, 2.0 * zeta * omega, omega**2]
            b, a = bilinear(down[1:], down, 1.0 / step)
            found.append(np.interp(times, even, lfilter(b, a, moved) - moved))
    return np.array(found)


def _triangles(seen: JointSeen, motion: _Motion) -> list[_Rows]:
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
        inside = (seen.seen_t > seen.t[first]) & (seen.seen_t < seen.t[end - 1])
        turned = sense[first] * (motion.q - seen.q[first, seen.joint])
        moves = (sense[first] * motion.v > _SLOW_RAD_S) & (turned > _CROSSED_RAD)
        rows = np.flatnonzero(inside & moves)
        if len(rows) >= _LEAST_FRAMES:
            found.append(_Rows(rows, float(sense[first])))
    return found


class _Fit(NamedTuple):
    """Half the play (rad), delay (s), and what the fit leaves (rad)."""

    half: float
    delay: float
    residual: float


def _found(along: Array, motion: _Motion, halves: Sequence[_Rows]) -> PlayFound:
    """By ``along`` (m, 3), camera positions or rotation vectors.

    The spread is that of leaving out one triangle after the other: what a swing leaves in a triangle is alike
    from frame to frame.
    """
    whole, swing = _fit(along, motion, halves), _STIFF
    ways = [*(_Swing(float(omega)) for omega in _SWINGS_RAD_S), *(_Swing(0.0, e) for e in motion.behind)]
    swings = [_fit(along, motion, halves, each) for each in ways]
    best = int(np.argmin([fit.residual for fit in swings]))
    if swings[best].residual < _SWUNG * whole.residual:
        whole, swing = swings[best], ways[best]
    n = len(halves)
    others = [_fit(along, motion, [*halves[:k], *halves[k + 1 :]], swing) for k in range(n)]
    widened = (n - 1) / math.sqrt(n) * math.sqrt((n - 1) / (n - 3))
    half_std, delay_std = (widened * float(np.std([fit[k] for fit in others])) for k in (0, 1))
    return PlayFound(
        half=whole.half,
        half_std=math.hypot(half_std, _FLOOR_RAD, _FLOOR_SHARE * whole.half),
        delay=whole.delay,
        delay_std=math.hypot(delay_std, _DELAY_FLOOR_S),
        residual=whole.residual,
        triangles=n,
    )


class _Swing(NamedTuple):
    """``omega`` (rad/s) of each triangle's own swing, 0: none; ``behind`` (m,): of a driven boom."""

    omega: float
    behind: Array | None = None


_STIFF = _Swing(0.0)


def _fit(along: Array, motion: _Motion, halves: Sequence[_Rows], swing: _Swing = _STIFF) -> _Fit:
    """What is left counts by its degrees of freedom."""
    rows = np.concatenate([half.rows for half in halves])
    senses = np.concatenate([np.full(len(half.rows), half.sense) for half in halves])
    x = motion.q[rows] - motion.q[rows].mean()
    slopes = np.polyfit(x, along[rows], 1)[0]
    size = float(np.linalg.norm(slopes))
    if size == 0.0:
        raise MeasurementFailed("measurement.play_unseen", "odometry saw the camera stand still")
    turned = along[rows] @ (slopes / size**2)  # in radians of the joint
    matrix = np.column_stack(
        [np.ones_like(x), x, x**2, x**3, senses, motion.v[rows], motion.swing[rows], motion.a[rows],
         motion.others[rows], *_swings(motion.t, halves, swing.omega),
         *([] if swing.behind is None else [swing.behind[rows]])]
    )  # fmt: skip
    units = np.maximum(np.abs(matrix).max(axis=0), 1e-12)
    scaled, *_ = np.linalg.lstsq(matrix / units, turned, rcond=None)
    solved = scaled / units
    left = turned - matrix @ solved
    free = max(len(turned) - matrix.shape[1], 1)
    rms = math.sqrt(float(left @ left) / free)
    return _Fit(float(solved[4] / solved[1]), -float(solved[5] / solved[1]), rms)


def _swings(t: Array, halves: Sequence[_Rows], omega: float) -> list[Array]:
    """Cosine and sine, (m, 2), over the captures of every triangle, 0 elsewhere; none without ``omega``."""
    if omega == 0.0:
        return []
    ends = np.cumsum([0, *(len(half.rows) for half in halves)])
    found = []
    for half, first, end in zip(halves, ends, ends[1:], strict=False):
        phase = omega * (t[half.rows] - t[half.rows[0]])
        both = np.zeros((ends[-1], 2))
        both[first:end] = np.column_stack([np.cos(phase), np.sin(phase)])
        found.append(both)
    return found
