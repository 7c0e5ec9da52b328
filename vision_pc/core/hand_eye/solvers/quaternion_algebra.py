"""Products of quaternions as matrices, and unit dual quaternions, for stacks (..., 4) written w, x, y, z.

Source: Hua et al. 2024, eq. 25.
"""

import numpy as np

from vision_pc.core.se3 import Array
from vision_pc.core.se3_stacks import hat


def left_product_matrix(q: Array) -> Array:
    """A(q), (..., 4, 4), with ``A(q) p`` = the quaternion product q p (Hua et al. eq. 25)."""
    M = np.empty((*q.shape[:-1], 4, 4))
    M[..., 0, 0] = q[..., 0]
    M[..., 0, 1:] = -q[..., 1:]
    M[..., 1:, 0] = q[..., 1:]
    M[..., 1:, 1:] = q[..., 0, None, None] * np.eye(3) + hat(q[..., 1:])
    return M


def right_product_matrix(q: Array) -> Array:
    """B(q), (..., 4, 4), with ``B(q) p`` = the quaternion product p q (Hua et al. eq. 25)."""
    M = left_product_matrix(q)
    M[..., 1:, 1:] = q[..., 0, None, None] * np.eye(3) - hat(q[..., 1:])
    return M


def dual_part(q: Array, t: Array) -> Array:
    """Dual parts (..., 4) of the unit dual quaternions of ``q`` (..., 4) and translation ``t`` (..., 3)."""
    pure = np.concatenate([np.zeros((*t.shape[:-1], 1)), t], axis=-1)
    product: Array = 0.5 * (left_product_matrix(pure) @ q[..., None])[..., 0]
    return product


def translation_of_dual(q: Array, q_dual: Array) -> Array:
    """The translation (3,) of one unit dual quaternion: the vector part of ``2 q' q*``."""
    conjugate = q * np.array([1.0, -1.0, -1.0, -1.0])
    product: Array = 2.0 * (left_product_matrix(q_dual) @ conjugate)[1:]
    return product
