"""Articulated-body dynamics of the arm, by product of exponentials, in base-aligned axes.

Every body frame coincides with the base frame when all coordinates are zero, so a pose is a plain product of
exponentials T_i = e^[ξ1]q1 … e^[ξi]qi (Brockett; Lynch & Park, Modern Robotics, 4.1) and a mass property is a
constant in base coordinates. Featherstone's articulated-body algorithm (Rigid Body Dynamics Algorithms, 2008,
table 7.1) then runs without a single change of coordinates: all spatial vectors are written in base-aligned
axes about one point, the present wrist centre, which keeps the light wrist bodies free of cancellation
against the 5 m reach.

Spatial motion vectors are [ω, v], forces [n, f]; a spatial inertia is its three blocks: J (angular), H
(coupling, upper right) and M (linear).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free
from plant_emulator.core.mechanics.spatial import (
    Matrix,
    Symmetric,
    Vector,
    cross,
    dot,
    less_outer,
    less_square,
    matrix,
    minus,
    plus,
    product,
    scaled,
    stretched,
    turned,
    turned_back,
    vector,
)

Array = NDArray[np.float64]


class Mechanism(NamedTuple):
    """A serial chain of ``n`` revolute coordinates and the body behind each, at home in base coordinates.

    ``axis`` (n, 3) unit, ``point`` (n, 3) on the axis, ``mass`` (n,), ``centre`` (n, 3), ``inertia`` (n, 3,
    3) about the centre (zero where the mass is), ``free`` (n,) 1 for a moving coordinate and 0 for a locked
    one, ``stiffness`` and ``damping`` (n,) of an elastic hinge at zero angle, ``gravity`` (3,) in base
    coordinates.
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
    velocity: Array  # (n, 6)
    bias: Array  # (n, 6) velocity-product acceleration
    projected: Array  # (n, 6) U = I_A S
    pivot: Array  # (n, 2) D = S·U and u = τ − S·p_A


def multibody_work(n: int) -> MultibodyWork:
    """Scratch memory for a chain of ``n`` coordinates."""
    return MultibodyWork(
        rotation=np.zeros((n + 1, 3, 3)),
        origin=np.zeros((n + 1, 3)),
        screw=np.zeros((n, 6)),
        velocity=np.zeros((n, 6)),
        bias=np.zeros((n, 6)),
        projected=np.zeros((n, 6)),
        pivot=np.zeros((n, 2)),
    )


@allocation_free
def _put_pose(work: MultibodyWork, i: int, rotation: Matrix, origin: Vector) -> None:
    for k in range(9):
        work.rotation[i, k // 3, k % 3] = rotation[k]
    for k in range(3):
        work.origin[i, k] = origin[k]


@allocation_free
def _put(table: Array, i: int, angular: Vector, linear: Vector) -> None:
    """Write a spatial vector into row ``i``."""
    table[i, 0], table[i, 1], table[i, 2] = angular
    table[i, 3], table[i, 4], table[i, 5] = linear


@allocation_free
def _turn_less_one(axis: Vector, angle: float) -> Matrix:
    """E − 1 with E the rotation by ``angle`` about ``axis`` (Rodrigues), 1 − cos without cancellation."""
    sine, cosine = math.sin(0.5 * angle), math.cos(0.5 * angle)
    s, c1 = 2.0 * sine * cosine, 2.0 * sine * sine
    x, y, z = axis
    return (
        c1 * (x * x - 1.0), c1 * x * y - s * z, c1 * x * z + s * y,
        c1 * x * y + s * z, c1 * (y * y - 1.0), c1 * y * z - s * x,
        c1 * x * z - s * y, c1 * y * z + s * x, c1 * (z * z - 1.0),
    )  # fmt: skip


@allocation_free
def forward_kinematics(q: Array, mech: Mechanism, work: MultibodyWork) -> None:
    """Fill ``rotation`` and ``origin`` of every body: x_base = R_i x_home + t_i."""
    r = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    t = (0.0, 0.0, 0.0)
    _put_pose(work, 0, r, t)
    for i in range(q.shape[0]):
        turn = _turn_less_one(vector(mech.axis, i, 0), q[i])
        t = minus(t, turned(r, turned(turn, vector(mech.point, i, 0))))
        d = product(r, turn)
        r = (
            r[0] + d[0], r[1] + d[1], r[2] + d[2],
            r[3] + d[3], r[4] + d[4], r[5] + d[5],
            r[6] + d[6], r[7] + d[7], r[8] + d[8],
        )  # fmt: skip
        _put_pose(work, i + 1, r, t)


@allocation_free
def _place(work: MultibodyWork, i: int, home: Vector) -> Vector:
    """Where the point of body ``i`` − 1 that is at ``home`` in the home pose is now; body −1 is the base."""
    return plus(turned(matrix(work.rotation, i), home), vector(work.origin, i, 0))


@allocation_free
def _body_inertia(r: Matrix, home: Matrix, mass: float, c: Vector) -> Symmetric:
    """R J Rᵀ plus what ``mass`` at ``c`` adds (Steiner)."""
    h = product(r, home)
    x, y, z = c
    return (
        h[0] * r[0] + h[1] * r[1] + h[2] * r[2] + mass * (y * y + z * z),
        h[0] * r[3] + h[1] * r[4] + h[2] * r[5] - mass * x * y,
        h[0] * r[6] + h[1] * r[7] + h[2] * r[8] - mass * x * z,
        h[3] * r[3] + h[4] * r[4] + h[5] * r[5] + mass * (x * x + z * z),
        h[3] * r[6] + h[4] * r[7] + h[5] * r[8] - mass * y * z,
        h[6] * r[6] + h[7] * r[7] + h[8] * r[8] + mass * (x * x + y * y),
    )


@allocation_free
def _velocities(rate: Array, mech: Mechanism, work: MultibodyWork, centre: Vector) -> None:
    """First pass, outward: screws, velocities and velocity-product accelerations about ``centre``."""
    turn, speed = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for i in range(rate.shape[0]):
        axis = turned(matrix(work.rotation, i), vector(mech.axis, i, 0))
        moment = cross(minus(_place(work, i, vector(mech.point, i, 0)), centre), axis)
        d = rate[i]
        _put(work.screw, i, axis, moment)
        linear = plus(cross(turn, moment), cross(speed, axis))
        _put(work.bias, i, scaled(d, cross(turn, axis)), scaled(d, linear))
        turn, speed = plus(turn, scaled(d, axis)), plus(speed, scaled(d, moment))
        _put(work.velocity, i, turn, speed)


@allocation_free
def _inertias(force: Array, mech: Mechanism, work: MultibodyWork, centre: Vector) -> None:
    """Second pass, inward: articulated inertia and bias force, projected on each coordinate."""
    J, M = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    H = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    n, f = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for i in range(force.shape[0] - 1, -1, -1):
        m = mech.mass[i]
        if m > 0.0:
            at = minus(_place(work, i + 1, vector(mech.centre, i, 0)), centre)
            own = _body_inertia(matrix(work.rotation, i + 1), matrix(mech.inertia, i), m, at)
            x, y, z = scaled(m, at)
            turn, speed = vector(work.velocity, i, 0), vector(work.velocity, i, 3)
            spin = plus(stretched(own, turn), cross((x, y, z), speed))
            momentum = plus(scaled(m, speed), cross(turn, (x, y, z)))
            n = plus(n, plus(cross(turn, spin), cross(speed, momentum)))
            f = plus(f, cross(turn, momentum))
            J = (J[0] + own[0], J[1] + own[1], J[2] + own[2], J[3] + own[3], J[4] + own[4], J[5] + own[5])
            H = (H[0], H[1] - z, H[2] + y, H[3] + z, H[4], H[5] - x, H[6] - y, H[7] + x, H[8])
            M = (M[0] + m, M[1], M[2], M[3] + m, M[4], M[5] + m)
        if mech.free[i] == 0.0:
            continue
        axis, moment = vector(work.screw, i, 0), vector(work.screw, i, 3)
        u, v = plus(stretched(J, axis), turned(H, moment)), plus(turned_back(H, axis), stretched(M, moment))
        d, e = dot(axis, u) + dot(moment, v), force[i] - dot(axis, n) - dot(moment, f)
        _put(work.projected, i, u, v)
        work.pivot[i, 0], work.pivot[i, 1] = d, e
        k = 1.0 / d
        J, H, M = less_square(J, k, u), less_outer(H, k, u, v), less_square(M, k, v)
        a, b = vector(work.bias, i, 0), vector(work.bias, i, 3)
        n = plus(n, plus(scaled(k * e, u), plus(stretched(J, a), turned(H, b))))
        f = plus(f, plus(scaled(k * e, v), plus(turned_back(H, a), stretched(M, b))))


@allocation_free
def _accelerations(mech: Mechanism, work: MultibodyWork, acceleration: Array) -> None:
    """Third pass, outward from the base, which accelerates upwards in place of gravity."""
    a, b = (0.0, 0.0, 0.0), (-mech.gravity[0], -mech.gravity[1], -mech.gravity[2])
    for i in range(acceleration.shape[0]):
        if mech.free[i] == 0.0:
            acceleration[i] = 0.0
            continue
        a, b = plus(a, vector(work.bias, i, 0)), plus(b, vector(work.bias, i, 3))
        drag = dot(vector(work.projected, i, 0), a) + dot(vector(work.projected, i, 3), b)
        d = (work.pivot[i, 1] - drag) / work.pivot[i, 0]
        acceleration[i] = d
        a = plus(a, scaled(d, vector(work.screw, i, 0)))
        b = plus(b, scaled(d, vector(work.screw, i, 3)))


@allocation_free
def forward_dynamics(
    q: Array, rate: Array, force: Array, mech: Mechanism, work: MultibodyWork, acceleration: Array
) -> None:
    """Fill ``acceleration`` (n,) at angles ``q``, rates ``rate`` and generalised ``force``, all (n,)."""
    forward_kinematics(q, mech, work)
    n = q.shape[0]
    wrist = _place(work, n, vector(mech.point, n - 1, 0))
    _velocities(rate, mech, work, wrist)
    _inertias(force, mech, work, wrist)
    _accelerations(mech, work, acceleration)
