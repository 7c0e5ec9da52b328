"""Rotations: unit quaternions written w, x, y, z, rotation vectors, and the derivatives that link them.

Arrays in, arrays out. The formulas that kernels also need without arrays are in ``triples``.
"""

import math

import numpy as np
import numpy.typing as npt

from controller.core.kinematics.triples import SMALL_ANGLE, cross_product, exponential, product, rows, turning
from foundation.compiled import kernel

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
def matrix_from_quaternion(q: Array) -> Array:
    """The rotation matrix, (3, 3), of a unit quaternion (4,)."""
    return np.array(rows(q))


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
def quaternion_from_vector(theta: Array) -> Array:
    """exp: the unit quaternion (4,) of a rotation vector (3,)."""
    return np.array(exponential(theta))


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
