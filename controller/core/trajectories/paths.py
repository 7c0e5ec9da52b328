"""Paths of the tool: point to point and through waypoints, quintic in time, geodesic in orientation.

Source: Mäkinen et al. 2023, motion control: quintic polynomials at rest at both ends, orientation about
one axis by one angle with the same quintic. From a moving state the general quintic starts at the present
velocity and acceleration, of the position and of the rotation vector to the goal alike.

Jerk is not limited but bounded: from rest to rest over a distance d in T it is 60 d/T³ at both ends, the peak
acceleration 5.77 d/T² (10/√3), so jerk ≤ 10.4 · acceleration / T, and T is at least ``duration_min_s``: 5.2
m/s³ with 0.25 m/s² and 0.5 s. Acceleration is continuous, jerk steps at the ends. Streamed references are
limited in jerk itself (``approach``).
"""

from typing import NamedTuple

import numpy as np

from controller.core.kinematics.rotations import (
    Angles,
    Array,
    Quadruple,
    Triple,
    Vector,
    conjugate,
    exponential,
    product,
    quaternion_product,
    turning,
    vector_from_quaternion,
    vector_rates,
)
from foundation.compiled import kernel


@kernel
def coefficients(start: Array, end: Array, duration: float) -> Array:
    """Coefficients c (6,) of x(t) = Σ c_k t^k with ``start`` at 0 and ``end`` at ``duration`` (s).

    ``start`` and ``end`` are value, first and second derivative. From rest to rest: the 10-15-6 polynomial.
    """
    T = duration
    gap = end[0] - start[0] - start[1] * T - 0.5 * start[2] * T * T
    slope = (end[1] - start[1] - start[2] * T) * T
    bend = (end[2] - start[2]) * T * T
    return np.array(
        [
            start[0],
            start[1],
            0.5 * start[2],
            (10.0 * gap - 4.0 * slope + 0.5 * bend) / T**3,
            (-15.0 * gap + 7.0 * slope - bend) / T**4,
            (6.0 * gap - 3.0 * slope + 0.5 * bend) / T**5,
        ]
    )


@kernel
def evaluate(c: Vector, t: float) -> tuple[float, float, float]:
    """Value, first and second derivative at time ``t`` of the polynomial with coefficients ``c`` (6,)."""
    value = ((((c[5] * t + c[4]) * t + c[3]) * t + c[2]) * t + c[1]) * t + c[0]
    first = (((5.0 * c[5] * t + 4.0 * c[4]) * t + 3.0 * c[3]) * t + 2.0 * c[2]) * t + c[1]
    second = ((20.0 * c[5] * t + 12.0 * c[4]) * t + 6.0 * c[3]) * t + 2.0 * c[2]
    return value, first, second


class Desired(NamedTuple):
    """Desired motion of T in B: p, v, a (3,), unit quaternion (4,), angular velocity, acceleration (3,)."""

    p: Array
    v: Array
    a: Array
    quaternion: Array
    omega: Array
    alpha: Array


class Path(NamedTuple):
    """Quintic segments, at rest between them.

    ``polynomials``: (n, 6, 6), rows x, y, z and the rotation vector from the segment's goal (base frame).
    ``goals``: (n, 4) unit quaternions. ``durations``: (n,) seconds. ``dwell``: seconds at rest between
    segments. ``duration_s``: from the start to the last waypoint.
    """

    polynomials: Array
    goals: Array
    durations: Array
    dwell: float
    duration_s: float

    def sample(self, time_s: float) -> tuple[Desired, int]:
        """The desired motion ``time_s`` after the start (clamped to the ends), and the segment's index."""
        out = np.empty((6, 4))
        segment = _sample(self, time_s, out)
        return Desired(out[0, :3], out[1, :3], out[2, :3], out[3], out[4, :3], out[5, :3]), segment


def at_rest(p: Array, quaternion: Array) -> Desired:
    """Standing still at a pose."""
    zero = np.zeros(3)
    return Desired(p, zero, zero, quaternion, zero, zero)


def path_from(start: Desired, p: Array, quaternions: Array, durations: Array, dwell: float) -> Path:
    """The path from ``start`` through waypoints ``p`` (n, 3), ``quaternions`` (n, 4), each reached at rest.

    From rest, every segment is a straight line and one turn about one axis, the short way round.
    """
    duration_s = float(durations.sum()) + dwell * (len(durations) - 1)
    return Path(_polynomials(start, p, quaternions, durations), quaternions, durations, dwell, duration_s)


@kernel
def _polynomials(start: Desired, way_p: Array, way_q: Array, T: Array) -> Array:
    p, v, a, quaternion, omega, alpha = start
    count = way_p.shape[0]
    result = np.empty((count, 6, 6))
    for n in range(count):
        theta = vector_from_quaternion(quaternion_product(quaternion, conjugate(way_q[n])))
        rate, bend = vector_rates(theta, omega, alpha)
        for k in range(3):
            result[n, k] = coefficients(np.array([p[k], v[k], a[k]]), np.array([way_p[n, k], 0.0, 0.0]), T[n])
            result[n, k + 3] = coefficients(np.array([theta[k], rate[k], bend[k]]), np.zeros(3), T[n])
        p, quaternion = way_p[n], way_q[n]
        v, a, omega, alpha = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    return result


@kernel
def straight(p: Array, quaternion: Array, to_p: Array, to_quaternion: Array) -> Path:
    """The straight way from rest at a pose, p (3,) and quaternion (4,), to rest at another, in a second."""
    goals, durations = np.empty((1, 4)), np.ones(1)
    goals[0] = to_quaternion
    zero = np.zeros(3)
    start = Desired(p, zero, zero, quaternion, zero, zero)
    return Path(_polynomials(start, to_p.copy().reshape(1, 3), goals, durations), goals, durations, 0.0, 1.0)


@kernel
def _coefficients(path: Path, n: int, row: int) -> Angles:
    c = path.polynomials
    return c[n, row, 0], c[n, row, 1], c[n, row, 2], c[n, row, 3], c[n, row, 4], c[n, row, 5]


@kernel
def _three(path: Path, n: int, row: int, t: float) -> tuple[Triple, Triple, Triple]:
    """Values, first and second derivatives of three rows from ``row`` on."""
    x, dx, ddx = evaluate(_coefficients(path, n, row), t)
    y, dy, ddy = evaluate(_coefficients(path, n, row + 1), t)
    z, dz, ddz = evaluate(_coefficients(path, n, row + 2), t)
    return (x, y, z), (dx, dy, dz), (ddx, ddy, ddz)


@kernel
def pose_on_segment(path: Path, n: int, t: float) -> tuple[Triple, Quadruple]:
    """Position and quaternion on segment ``n`` of ``path`` at the segment's own time ``t``."""
    p, _, _ = _three(path, n, 0, t)
    theta, _, _ = _three(path, n, 3, t)
    return p, product(exponential(theta), path.goals[n])


@kernel
def rates_on_segment(path: Path, n: int, t: float) -> tuple[Triple, Triple, Triple, Triple]:
    """v, a, ω and α on segment ``n`` of ``path`` at the segment's own time ``t``."""
    _, v, a = _three(path, n, 0, t)
    omega, alpha = turning(*_three(path, n, 3, t))
    return v, a, omega, alpha


@kernel
def _sample(path: Path, time_s: float, out: Array) -> int:
    """The segment at ``time_s``; fills ``out`` (6, 4), rows as in ``Desired``, with the desired motion."""
    last = path.durations.shape[0] - 1
    n, t = 0, max(time_s, 0.0)
    while n < last and t >= path.durations[n] + path.dwell:
        t -= path.durations[n] + path.dwell
        n += 1
    p, quaternion = pose_on_segment(path, n, min(t, path.durations[n]))
    v, a, omega, alpha = rates_on_segment(path, n, min(t, path.durations[n]))
    rests = t >= path.durations[n]  # on the waypoint, exactly
    for k in range(4):
        out[3, k] = path.goals[n, k] if rests else quaternion[k]
    for k in range(3):
        out[0, k] = p[k]
        out[1, k], out[2, k] = (0.0, 0.0) if rests else (v[k], a[k])
        out[4, k], out[5, k] = (0.0, 0.0) if rests else (omega[k], alpha[k])
    return n
