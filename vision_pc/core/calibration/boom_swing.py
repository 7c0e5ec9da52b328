"""How a boom swings beside its joint's encoder while the joint turns in triangles; pure functions.

A boom that its root drives by q(t) lags behind it by −s²/(s² + 2ζωs + ω²) q, and goes on with the swing that
it had before. So one way of swinging, ω and ζ, has one unknown for how it is driven, which all triangles
share, and two for each triangle: the swing with which it began.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.signal import lfilter

from vision_pc.core.calibration.joint_motion import JointMotion, Triangle
from vision_pc.core.se3 import Array

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
        found[part, 0] = _driven(swing, motion, t)
        found[part, 1 + 2 * k] = fades * np.cos(damped * since)
        found[part, 2 + 2 * k] = fades * np.sin(damped * since)
    return found


def _driven(swing: Swing, motion: JointMotion, t: Array) -> Array:
    """The boom's own angle less its root's at ``t``, straight and at rest at the first of them.

    The filter is −s²/(s² + 2ζωs + ω²) with s = c (1 − z⁻¹)/(1 + z⁻¹), c two over a step.
    """
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
