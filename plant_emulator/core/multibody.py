"""Articulated-body dynamics of the arm, by product of exponentials, in base-aligned axes.

Every body frame coincides with the base frame when all coordinates are zero, so a pose is a plain product of
exponentials T_i = e^[ξ1]q1 … e^[ξi]qi (Brockett; Lynch & Park, Modern Robotics, 4.1) and a mass property is a
constant in base coordinates. Featherstone's articulated-body algorithm (Rigid Body Dynamics Algorithms, 2008,
table 7.1) then runs without a single change of coordinates: all spatial vectors are written in base-aligned
axes about one point, the present wrist centre, which keeps the light wrist bodies free of cancellation
against the 5 m reach.

Spatial motion vectors are [ω, v], forces [n, f].
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Mechanism(NamedTuple):
    """A serial chain of ``n`` revolute coordinates and the body behind each, at home in base coordinates.

    ``axis`` (n, 3) unit, ``point`` (n, 3) on the axis, ``mass`` (n,), ``centre`` (n, 3), ``inertia`` (n, 3,
    3) about the centre, ``free`` (n,) 1 for a moving coordinate and 0 for a locked one, ``stiffness`` and
    ``damping`` (n,) of an elastic hinge at zero angle, ``gravity`` (3,) in base coordinates.
    """

    axis: Array
    point: Array
    mass: Array
    centre: Array
    inertia: Array
    free: Array
    stiffness: Array
    damping: Array
    gravity: Array


class MultibodyWork(NamedTuple):
    """Scratch memory of the recursion, so that no evaluation allocates."""

    rotation: Array  # (n + 1, 3, 3) of each body, base first
    origin: Array  # (n + 1, 3)
    screw: Array  # (n, 6)
    bias: Array  # (n, 6) velocity-product acceleration
    velocity: Array  # (n + 1, 6)
    spatial_inertia: Array  # (n, 6, 6)
    wrench: Array  # (n, 6) velocity-product force
    articulated: Array  # (6, 6)
    articulated_wrench: Array  # (6,)
    projected: Array  # (n, 6) U = I_A S
    pivot_inertia: Array  # (n,) D = S·U
    pivot_force: Array  # (n,) u


def multibody_work(n: int) -> MultibodyWork:
    """Scratch memory for a chain of ``n`` coordinates."""
    return MultibodyWork(
        rotation=np.zeros((n + 1, 3, 3)),
        origin=np.zeros((n + 1, 3)),
        screw=np.zeros((n, 6)),
        bias=np.zeros((n, 6)),
        velocity=np.zeros((n + 1, 6)),
        spatial_inertia=np.zeros((n, 6, 6)),
        wrench=np.zeros((n, 6)),
        articulated=np.zeros((6, 6)),
        articulated_wrench=np.zeros(6),
        projected=np.zeros((n, 6)),
        pivot_inertia=np.zeros(n),
        pivot_force=np.zeros(n),
    )


@njit(cache=True, error_model="numpy")
def forward_kinematics(q: Array, mech: Mechanism, work: MultibodyWork) -> None:
    """Fill ``rotation`` and ``origin`` of every body: x_base = R_i x_home + t_i."""
    for r in range(3):
        work.origin[0, r] = 0.0
        for c in range(3):
            work.rotation[0, r, c] = 1.0 if r == c else 0.0
    for i in range(q.shape[0]):
        s, c1 = math.sin(q[i]), 2.0 * math.sin(0.5 * q[i]) ** 2  # 1 − cos without cancellation
        ax, ay, az = mech.axis[i, 0], mech.axis[i, 1], mech.axis[i, 2]
        px, py, pz = mech.point[i, 0], mech.point[i, 1], mech.point[i, 2]
        # E − 1 with E the rotation by q about the axis (Rodrigues)
        e00, e01, e02 = c1 * (ax * ax - 1.0), c1 * ax * ay - s * az, c1 * ax * az + s * ay
        e10, e11, e12 = c1 * ax * ay + s * az, c1 * (ay * ay - 1.0), c1 * ay * az - s * ax
        e20, e21, e22 = c1 * ax * az - s * ay, c1 * ay * az + s * ax, c1 * (az * az - 1.0)
        dx = -(e00 * px + e01 * py + e02 * pz)
        dy = -(e10 * px + e11 * py + e12 * pz)
        dz = -(e20 * px + e21 * py + e22 * pz)
        for r in range(3):
            r0, r1, r2 = work.rotation[i, r, 0], work.rotation[i, r, 1], work.rotation[i, r, 2]
            work.rotation[i + 1, r, 0] = r0 + r0 * e00 + r1 * e10 + r2 * e20
            work.rotation[i + 1, r, 1] = r1 + r0 * e01 + r1 * e11 + r2 * e21
            work.rotation[i + 1, r, 2] = r2 + r0 * e02 + r1 * e12 + r2 * e22
            work.origin[i + 1, r] = work.origin[i, r] + r0 * dx + r1 * dy + r2 * dz


@njit(cache=True, error_model="numpy")
def _body_inertia(
    rot: Array, at: Array, ox: float, oy: float, oz: float, m: float, centre: Array, home: Array, out: Array
) -> None:
    """Fill the spatial inertia ``out`` (6, 6) of a body at ``rot``, ``at``, about the point (ox, oy, oz)."""
    c0, c1, c2 = centre[0], centre[1], centre[2]
    x = rot[0, 0] * c0 + rot[0, 1] * c1 + rot[0, 2] * c2 + at[0] - ox
    y = rot[1, 0] * c0 + rot[1, 1] * c1 + rot[1, 2] * c2 + at[1] - oy
    z = rot[2, 0] * c0 + rot[2, 1] * c1 + rot[2, 2] * c2 + at[2] - oz
    for r in range(3):
        h0 = rot[r, 0] * home[0, 0] + rot[r, 1] * home[1, 0] + rot[r, 2] * home[2, 0]
        h1 = rot[r, 0] * home[0, 1] + rot[r, 1] * home[1, 1] + rot[r, 2] * home[2, 1]
        h2 = rot[r, 0] * home[0, 2] + rot[r, 1] * home[1, 2] + rot[r, 2] * home[2, 2]
        for c in range(r + 1):
            value = h0 * rot[c, 0] + h1 * rot[c, 1] + h2 * rot[c, 2]
            out[r, c] = value
            out[c, r] = value
    out[0, 0] += m * (y * y + z * z)
    out[1, 1] += m * (x * x + z * z)
    out[2, 2] += m * (x * x + y * y)
    out[0, 1] -= m * x * y
    out[1, 0] -= m * x * y
    out[0, 2] -= m * x * z
    out[2, 0] -= m * x * z
    out[1, 2] -= m * y * z
    out[2, 1] -= m * y * z
    for r in range(3):
        for c in range(3):
            out[r + 3, c + 3] = m if r == c else 0.0
    _cross_blocks(out, m * x, m * y, m * z)


@njit(cache=True, error_model="numpy")
def _cross_blocks(out: Array, hx: float, hy: float, hz: float) -> None:
    """Fill the off-diagonal blocks [h]× and [h]×ᵀ of a spatial inertia with first moment h."""
    for k in range(3):
        out[k, k + 3] = 0.0
        out[k + 3, k] = 0.0
    out[0, 4] = -hz
    out[0, 5] = hy
    out[1, 3] = hz
    out[1, 5] = -hx
    out[2, 3] = -hy
    out[2, 4] = hx
    for r in range(3):
        for c in range(3):
            out[c + 3, r] = out[r, c + 3]


@njit(cache=True, error_model="numpy")
def _screws(rate: Array, mech: Mechanism, work: MultibodyWork) -> None:
    """Fill screws, velocities, velocity-product terms and inertias of all bodies about the wrist centre."""
    n = rate.shape[0]
    rot, at, home = work.rotation[n - 1], work.origin[n - 1], mech.point[n - 1]
    ox = rot[0, 0] * home[0] + rot[0, 1] * home[1] + rot[0, 2] * home[2] + at[0]
    oy = rot[1, 0] * home[0] + rot[1, 1] * home[1] + rot[1, 2] * home[2] + at[1]
    oz = rot[2, 0] * home[0] + rot[2, 1] * home[1] + rot[2, 2] * home[2] + at[2]
    for k in range(6):
        work.velocity[0, k] = 0.0
    for i in range(n):
        r, t, a, p = work.rotation[i], work.origin[i], mech.axis[i], mech.point[i]
        ax = r[0, 0] * a[0] + r[0, 1] * a[1] + r[0, 2] * a[2]
        ay = r[1, 0] * a[0] + r[1, 1] * a[1] + r[1, 2] * a[2]
        az = r[2, 0] * a[0] + r[2, 1] * a[1] + r[2, 2] * a[2]
        px = r[0, 0] * p[0] + r[0, 1] * p[1] + r[0, 2] * p[2] + t[0] - ox
        py = r[1, 0] * p[0] + r[1, 1] * p[1] + r[1, 2] * p[2] + t[1] - oy
        pz = r[2, 0] * p[0] + r[2, 1] * p[1] + r[2, 2] * p[2] + t[2] - oz
        mx, my, mz = py * az - pz * ay, pz * ax - px * az, px * ay - py * ax
        s, v, w, d = work.screw[i], work.velocity[i], work.velocity[i + 1], rate[i]
        s[0], s[1], s[2], s[3], s[4], s[5] = ax, ay, az, mx, my, mz
        for k in range(6):
            w[k] = v[k] + s[k] * d
        b = work.bias[i]
        b[0] = (v[1] * az - v[2] * ay) * d
        b[1] = (v[2] * ax - v[0] * az) * d
        b[2] = (v[0] * ay - v[1] * ax) * d
        b[3] = (v[1] * mz - v[2] * my + v[4] * az - v[5] * ay) * d
        b[4] = (v[2] * mx - v[0] * mz + v[5] * ax - v[3] * az) * d
        b[5] = (v[0] * my - v[1] * mx + v[3] * ay - v[4] * ax) * d
        inertia, f = work.spatial_inertia[i], work.wrench[i]
        pose, place = work.rotation[i + 1], work.origin[i + 1]
        _body_inertia(pose, place, ox, oy, oz, mech.mass[i], mech.centre[i], mech.inertia[i], inertia)
        m0 = m1 = m2 = m3 = m4 = m5 = 0.0
        for k in range(6):
            m0 += inertia[0, k] * w[k]
            m1 += inertia[1, k] * w[k]
            m2 += inertia[2, k] * w[k]
            m3 += inertia[3, k] * w[k]
            m4 += inertia[4, k] * w[k]
            m5 += inertia[5, k] * w[k]
        f[0] = w[1] * m2 - w[2] * m1 + w[4] * m5 - w[5] * m4
        f[1] = w[2] * m0 - w[0] * m2 + w[5] * m3 - w[3] * m5
        f[2] = w[0] * m1 - w[1] * m0 + w[3] * m4 - w[4] * m3
        f[3] = w[1] * m5 - w[2] * m4
        f[4] = w[2] * m3 - w[0] * m5
        f[5] = w[0] * m4 - w[1] * m3


@njit(cache=True, error_model="numpy")
def forward_dynamics(
    q: Array, rate: Array, force: Array, mech: Mechanism, work: MultibodyWork, acceleration: Array
) -> None:
    """Fill ``acceleration`` (n,) at angles ``q``, rates ``rate`` and generalised ``force``, all (n,)."""
    forward_kinematics(q, mech, work)
    _screws(rate, mech, work)
    n = q.shape[0]
    total, pull = work.articulated, work.articulated_wrench
    for r in range(6):
        pull[r] = 0.0
        for c in range(6):
            total[r, c] = 0.0
    for back in range(n):
        i = n - 1 - back
        s, u, b, own, f = (
            work.screw[i],
            work.projected[i],
            work.bias[i],
            work.spatial_inertia[i],
            work.wrench[i],
        )
        for r in range(6):
            pull[r] += f[r]
            for c in range(6):
                total[r, c] += own[r, c]
        if mech.free[i] == 0.0:
            continue
        d = 0.0
        e = force[i]
        for r in range(6):
            value = 0.0
            for c in range(6):
                value += total[r, c] * s[c]
            u[r] = value
            d += value * s[r]
            e -= pull[r] * s[r]
        work.pivot_inertia[i] = d
        work.pivot_force[i] = e
        inverse = 1.0 / d
        for r in range(6):
            scaled = u[r] * inverse
            for c in range(6):
                total[r, c] -= scaled * u[c]
        for r in range(6):
            value = u[r] * e * inverse
            for c in range(6):
                value += total[r, c] * b[c]
            pull[r] += value
    _outward(mech, work, acceleration)


@njit(cache=True, error_model="numpy")
def _outward(mech: Mechanism, work: MultibodyWork, acceleration: Array) -> None:
    """Third pass: accelerations from the base, which accelerates upwards in place of gravity."""
    a0 = a1 = a2 = 0.0
    a3, a4, a5 = -mech.gravity[0], -mech.gravity[1], -mech.gravity[2]
    for i in range(acceleration.shape[0]):
        if mech.free[i] == 0.0:
            acceleration[i] = 0.0
            continue
        s, b, u = work.screw[i], work.bias[i], work.projected[i]
        a0 += b[0]
        a1 += b[1]
        a2 += b[2]
        a3 += b[3]
        a4 += b[4]
        a5 += b[5]
        drag = u[0] * a0 + u[1] * a1 + u[2] * a2 + u[3] * a3 + u[4] * a4 + u[5] * a5
        d = (work.pivot_force[i] - drag) / work.pivot_inertia[i]
        acceleration[i] = d
        a0 += s[0] * d
        a1 += s[1] * d
        a2 += s[2] * d
        a3 += s[3] * d
        a4 += s[4] * d
        a5 += s[5] * d
