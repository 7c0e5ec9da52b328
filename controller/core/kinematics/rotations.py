"""Rotations: unit quaternions written w, x, y, z, rotation vectors, and the derivatives that link them.

Arrays in, arrays out. The formulas that kernels also need without arrays are in ``triples``.
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from foundation.compiled import kernel

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]
Angles = tuple[float, float, float, float, float, float]
Rows = tuple[Triple, Triple, Triple]
Vector = Sequence[float] | npt.NDArray[np.float64]

# Below this angle the trigonometric quotients are replaced by their series (truncation below 1e-16).
SMALL_ANGLE = 0.02  # [D]


@kernel
def cross_product(a: Vector, b: Vector) -> Triple:
    """The vector product a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def norm(x: Vector) -> float:
    """The length of a triple."""
    return math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])


@kernel
def product(a: Vector, b: Vector) -> Quadruple:
    """The quaternion product a ⊗ b, w first: rotation b first, then a."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@kernel
def exponential(theta: Vector) -> Quadruple:
    """The unit quaternion, w first, of a rotation vector."""
    angle = norm(theta)
    factor = 0.5 - angle * angle / 48.0 if angle < 1e-4 else math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), factor * theta[0], factor * theta[1], factor * theta[2]


@kernel
def rows(q: Vector) -> Rows:
    """The rotation matrix of a unit quaternion, by rows."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


@kernel
def turned(R: Rows, x: Vector) -> Triple:
    """R x."""
    return (
        R[0][0] * x[0] + R[0][1] * x[1] + R[0][2] * x[2],
        R[1][0] * x[0] + R[1][1] * x[1] + R[1][2] * x[2],
        R[2][0] * x[0] + R[2][1] * x[1] + R[2][2] * x[2],
    )


@kernel
def turning(theta: Vector, rate: Vector, bend: Vector) -> tuple[Triple, Triple]:
    """Angular velocity ω and acceleration α, base frame, of exp(θ(t)) R_0; ``rate`` θ̇, ``bend`` θ̈.

    ω = θ̇ + A θ×θ̇ + B θ×(θ×θ̇) with A = (1 − cos φ)/φ², B = (φ − sin φ)/φ³, φ = |θ| (the left Jacobian of
    SO(3)); α is its time derivative.
    """
    square = theta[0] * theta[0] + theta[1] * theta[1] + theta[2] * theta[2]
    phi = math.sqrt(square)
    if phi < SMALL_ANGLE:
        a = 0.5 - square / 24.0 + square * square / 720.0
        b = 1.0 / 6.0 - square / 120.0 + square * square / 5040.0
        a_slope = -1.0 / 12.0 + square / 180.0 - square * square / 6720.0
        b_slope = -1.0 / 60.0 + square / 1260.0 - square * square / 60480.0
    else:
        sine, cosine = math.sin(phi), math.cos(phi)
        a = (1.0 - cosine) / square
        b = (phi - sine) / (square * phi)
        a_slope = (phi * sine - 2.0 * (1.0 - cosine)) / (square * square)
        b_slope = (phi * (1.0 - cosine) - 3.0 * (phi - sine)) / (square * square * phi)
    along = theta[0] * rate[0] + theta[1] * rate[1] + theta[2] * rate[2]  # φ φ̇
    once = cross_product(theta, rate)
    twice = cross_product(theta, once)
    aside = cross_product(theta, bend)
    swing, sway = cross_product(rate, once), cross_product(theta, aside)
    omega = (
        rate[0] + a * once[0] + b * twice[0],
        rate[1] + a * once[1] + b * twice[1],
        rate[2] + a * once[2] + b * twice[2],
    )
    slope = (
        a_slope * once[0] + b_slope * twice[0],
        a_slope * once[1] + b_slope * twice[1],
        a_slope * once[2] + b_slope * twice[2],
    )
    alpha = (
        bend[0] + a * aside[0] + b * (swing[0] + sway[0]) + along * slope[0],
        bend[1] + a * aside[1] + b * (swing[1] + sway[1]) + along * slope[1],
        bend[2] + a * aside[2] + b * (swing[2] + sway[2]) + along * slope[2],
    )
    return omega, alpha


Array = npt.NDArray[np.float64]


@kernel
def cross(a: Array, b: Array) -> Array:
    """The vector product a × b, both of shape (3,)."""
    return np.array(cross_product(a, b))


@kernel
def quaternion_product(a: Array, b: Array) -> Array:
    """The product a ⊗ b: rotation b first, then a; each of shape (4,), w first."""
    return np.array(product(a, b))


@kernel
def conjugate(q: Array) -> Array:
    """The inverse of a unit quaternion."""
    return np.array([q[0], -q[1], -q[2], -q[3]])


@kernel
def quaternion_from_matrix(R: Array) -> Array:
    """The unit quaternion (4,), w ≥ 0, of a rotation matrix (3, 3); after Shepperd."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    if trace >= R[0, 0] and trace >= R[1, 1] and trace >= R[2, 2]:
        q = np.array([1.0 + trace, R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    elif R[0, 0] >= R[1, 1] and R[0, 0] >= R[2, 2]:
        q = np.array([R[2, 1] - R[1, 2], 1.0 + 2.0 * R[0, 0] - trace, R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]])
    elif R[1, 1] >= R[2, 2]:
        q = np.array([R[0, 2] - R[2, 0], R[0, 1] + R[1, 0], 1.0 + 2.0 * R[1, 1] - trace, R[1, 2] + R[2, 1]])
    else:
        q = np.array([R[1, 0] - R[0, 1], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], 1.0 + 2.0 * R[2, 2] - trace])
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q / norm if q[0] >= 0.0 else -q / norm


@kernel
def orientation_error(desired: Array, actual: Array) -> Array:
    """δr = η ε_d − η_d ε − ε_d × ε, (3,), base frame: sin(angle/2) · axis, actual to desired, the short way.

    Both arguments are unit quaternions (4,); the sign of either does not matter.
    Source: Siciliano et al., used by Mäkinen et al. 2023 in (4).
    """
    product = 0.0
    for k in range(4):
        product += desired[k] * actual[k]
    sign = 1.0 if product >= 0.0 else -1.0  # q and −q are one rotation; a positive product is the short way
    error: Array = actual[0] * desired[1:4] - desired[0] * actual[1:4] - cross(desired[1:4], actual[1:4])
    return sign * error


@kernel
def vector_from_quaternion(q: Array) -> Array:
    """log: the rotation vector (3,), no longer than π, of a unit quaternion (4,); q and −q give the same."""
    s = math.sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    w = abs(q[0])
    sign = 1.0 if q[0] >= 0.0 else -1.0
    factor = 2.0 / w if s < 1e-12 else 2.0 * math.atan2(s, w) / s
    return sign * factor * q[1:4]


@kernel
def angular_motion(theta: Array, theta_dot: Array, theta_ddot: Array) -> tuple[Array, Array]:
    """Angular velocity ω and acceleration α, each (3,): see ``triples.turning``."""
    omega, alpha = turning(theta, theta_dot, theta_ddot)
    return np.array(omega), np.array(alpha)


@kernel
def vector_rates(theta: Array, omega: Array, alpha: Array) -> tuple[Array, Array]:
    """θ̇ and θ̈ that give ω and α: the inverse of ``angular_motion``, valid for |θ| < 2π."""
    theta_dot = _inverse_left_jacobian(theta, omega)
    _, bias = angular_motion(theta, theta_dot, np.zeros(3))
    return theta_dot, _inverse_left_jacobian(theta, alpha - bias)


@kernel
def _inverse_left_jacobian(theta: Array, vector: Array) -> Array:
    square = theta[0] * theta[0] + theta[1] * theta[1] + theta[2] * theta[2]
    phi = math.sqrt(square)
    if phi < SMALL_ANGLE:
        c = 1.0 / 12.0 + square / 720.0 + square * square / 30240.0
    else:
        c = (1.0 - 0.5 * phi / math.tan(0.5 * phi)) / square
    first = cross(theta, vector)
    result: Array = vector - 0.5 * first + c * cross(theta, first)
    return result
