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
    Array,
    angular_motion,
    conjugate,
    quaternion_from_vector,
    quaternion_product,
    vector_from_quaternion,
    vector_rates,
)
from controller.core.trajectories.quintic import coefficients, evaluate
from foundation.compiled import kernel


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
        desired, segment = _sample(self, time_s)
        return desired, segment


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
def segment_motion(path: Path, n: int, t: float) -> Desired:
    """The desired motion on segment ``n`` of ``path`` at the segment's own time ``t``."""
    values = np.empty((3, 6))
    for row in range(6):
        values[0, row], values[1, row], values[2, row] = evaluate(path.polynomials[n, row], t)
    theta = values[0, 3:].copy()
    omega, alpha = angular_motion(theta, values[1, 3:].copy(), values[2, 3:].copy())
    quaternion = quaternion_product(quaternion_from_vector(theta), path.goals[n])
    return Desired(values[0, :3].copy(), values[1, :3].copy(), values[2, :3].copy(), quaternion, omega, alpha)


@kernel
def _sample(path: Path, time_s: float) -> tuple[Desired, int]:
    last = path.durations.shape[0] - 1
    n, t = 0, max(time_s, 0.0)
    while n < last and t >= path.durations[n] + path.dwell:
        t -= path.durations[n] + path.dwell
        n += 1
    desired = segment_motion(path, n, min(t, path.durations[n]))
    if t >= path.durations[n]:  # at rest on the waypoint, exactly
        zero = np.zeros(3)
        return Desired(desired.p, zero, zero, path.goals[n].copy(), zero, zero), n
    return desired, n
