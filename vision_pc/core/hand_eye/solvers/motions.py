"""Relative motions of hand and camera, A X = X B, as dual quaternions.

From poses every pair i < j gives one motion, so no choice of pairs can depend on the order of the samples.
"""

import math
from typing import NamedTuple

import numpy as np

from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.se3 import Array
from vision_pc.core.se3_stacks import hat

_SIGN_IN_DOUBT_COS = math.cos(math.radians(80.0))  # half angle: motions beyond 160 degrees


class Motions(NamedTuple):
    """Motions A (hand) and B (camera), (m, 4, 4) each, with A X = X B."""

    A: Array
    B: Array


class DualQuaternions(NamedTuple):
    """The motions as unit dual quaternions ``x`` + ε ``x_dual`` of A, ``y`` + ε ``y_dual`` of B, (m, 4).

    Signs are consistent: x g = g y holds, not only up to sign.
    """

    x: Array
    x_dual: Array
    y: Array
    y_dual: Array

    def rotation_rows(self) -> Array:
        """The matrices A(x) − B(y), (m, 4, 4), of the rotation equation (Hua et al. eq. 26)."""
        return left_product_matrix(self.x) - right_product_matrix(self.y)

    def dual_rows(self) -> Array:
        """The matrices A(x') − B(y'), (m, 4, 4), of the dual equation (Hua et al. eq. 26)."""
        return left_product_matrix(self.x_dual) - right_product_matrix(self.y_dual)


def all_motions(pairs: PosePairs) -> Motions:
    """The motions of all pairs of samples i < j: A = H_j⁻¹ H_i, B = P_j P_i⁻¹ (Hua et al. eq. 1)."""
    i, j = np.triu_indices(len(pairs), k=1)
    return Motions(stacks.inverse(pairs.H[j]) @ pairs.H[i], pairs.P[j] @ stacks.inverse(pairs.P[i]))


def dual_quaternions(motions: Motions) -> DualQuaternions:
    """The motions as unit dual quaternions with consistent signs.

    Both scalar parts are made positive, which is right up to noise because hand and camera turn by the same
    angle. Near a half turn noise can flip one of them; there the sign is taken that fits the rotation which
    the unambiguous motions give (a defect of other tools: opencv issue 24871).
    """
    x, y = (
        stacks.quaternion_from_rotation(motions.A[:, :3, :3]),
        stacks.quaternion_from_rotation(motions.B[:, :3, :3]),
    )
    doubtful = (x[:, 0] < _SIGN_IN_DOUBT_COS) | (y[:, 0] < _SIGN_IN_DOUBT_COS)
    if doubtful.any() and (~doubtful).sum() >= 2:
        rows = left_product_matrix(x[~doubtful]) - right_product_matrix(y[~doubtful])
        g = np.linalg.eigh(np.einsum("mij,mik->jk", rows, rows))[1][:, 0]
        x_g, g_y = (
            left_product_matrix(x) @ g,
            right_product_matrix(y) @ g,
        )
        flip = doubtful & (np.sum(x_g * g_y, axis=-1) < 0.0)
        y = np.where(flip[:, None], -y, y)
    return DualQuaternions(
        x,
        dual_part(x, motions.A[:, :3, 3]),
        y,
        dual_part(y, motions.B[:, :3, 3]),
    )


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
