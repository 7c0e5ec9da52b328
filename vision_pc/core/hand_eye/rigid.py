"""Stacks of rigid motions: exponentials, logarithms, quaternions, dual quaternions, vectorised.

``vision_pc.core.se3`` treats one pose at a time; everything here takes leading batch dimensions, because a
hand-eye solver treats all its samples (and all pairs of them) at once within a budget of milliseconds.
Poses are (..., 4, 4), rotations (..., 3, 3), quaternions (..., 4) written w, x, y, z.
"""

import numpy as np

from vision_pc.core.se3 import Array

_SMALL_ANGLE = 1e-4
_FAR_FROM_HALF_TURN = -0.9  # cosine; below it the antisymmetric part has too few digits left

_GENERATORS = np.array(
    [[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]],
    dtype=np.float64,
)


def pose(R: Array, t: Array) -> Array:
    """Poses (..., 4, 4) from rotations (..., 3, 3) and translations (..., 3)."""
    X = np.zeros((*R.shape[:-2], 4, 4))
    X[..., :3, :3] = R
    X[..., :3, 3] = t
    X[..., 3, 3] = 1.0
    return X


def inverse(X: Array) -> Array:
    """The inverse poses (..., 4, 4)."""
    R_transposed = np.swapaxes(X[..., :3, :3], -1, -2)
    return pose(R_transposed, -(R_transposed @ X[..., :3, 3, None])[..., 0])


def skew(v: Array) -> Array:
    """Cross-product matrices (..., 3, 3) of vectors (..., 3)."""
    return (v @ _GENERATORS).reshape(*v.shape[:-1], 3, 3)


def rotation_exp(v: Array) -> Array:
    """Rotations (..., 3, 3) of rotation vectors (..., 3), radians (Rodrigues; series below 1e-4 rad)."""
    squared = np.sum(v * v, axis=-1)
    angle = np.sqrt(squared)
    small = angle < _SMALL_ANGLE
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 1.0 - squared / 6.0, np.sin(safe) / safe)
    second = np.where(small, 0.5 - squared / 24.0, (1.0 - np.cos(safe)) / safe**2)
    S = skew(v)
    rotations: Array = np.eye(3) + first[..., None, None] * S + second[..., None, None] * (S @ S)
    return rotations


def rotation_log(R: Array) -> Array:
    """Rotation vectors (..., 3), radians, of rotations (..., 3, 3); exact up to and including a half turn."""
    cosine = 0.5 * (R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2] - 1.0)
    if cosine.min(initial=1.0) > _FAR_FROM_HALF_TURN:
        v = np.empty(R.shape[:-1])
        for k, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
            v[..., k] = 0.5 * (R[..., i, j] - R[..., j, i])
        sine = np.sqrt(np.sum(v * v, axis=-1))
        small = sine < _SMALL_ANGLE
        scale = np.where(small, 1.0 + sine**2 / 6.0, np.arctan2(sine, cosine) / np.where(small, 1.0, sine))
    else:
        q = quaternion(R)
        v, norm = q[..., 1:], np.linalg.norm(q[..., 1:], axis=-1)
        small = norm < _SMALL_ANGLE
        scale = np.where(
            small, 2.0 + norm**2 / 3.0, 2.0 * np.arctan2(norm, q[..., 0]) / np.where(small, 1.0, norm)
        )
    vectors: Array = scale[..., None] * v
    return vectors


def rotation_angle(R: Array) -> Array:
    """Rotation angles (...), radians in [0, pi], of rotations (..., 3, 3); precise near zero and near pi."""
    q = quaternion(R)
    angles: Array = 2.0 * np.arctan2(np.linalg.norm(q[..., 1:], axis=-1), q[..., 0])
    return angles


def quaternion(R: Array) -> Array:
    """Unit quaternions (..., 4), w first and w >= 0, of rotations (..., 3, 3) (largest-pivot form)."""
    d = np.diagonal(R, axis1=-2, axis2=-1)
    trace = d.sum(axis=-1)
    squares = np.stack([1.0 + trace, *(1.0 - trace + 2.0 * d[..., k] for k in range(3))], axis=-1)
    a, b, c = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    e, f, g = R[..., 0, 1] + R[..., 1, 0], R[..., 0, 2] + R[..., 2, 0], R[..., 1, 2] + R[..., 2, 1]
    w, x, y, z = np.moveaxis(squares, -1, 0)
    rows = np.stack(
        [np.stack(row, axis=-1) for row in ((w, a, b, c), (a, x, e, f), (b, e, y, g), (c, f, g, z))], axis=-2
    )
    best = np.argmax(squares, axis=-1)
    q = np.take_along_axis(rows, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    signed: Array = np.where(q[..., :1] < 0.0, -q, q)
    return signed


def rotation_of_quaternion(q: Array) -> Array:
    """Rotations (..., 3, 3) of quaternions (..., 4), w first, of any non-zero norm."""
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    w, v = q[..., 0, None, None], q[..., 1:]
    S = skew(v)
    rotations: Array = np.eye(3) + 2.0 * w * S + 2.0 * (S @ S)
    return rotations


def left_product_matrix(q: Array) -> Array:
    """A(q), (..., 4, 4), with ``A(q) p`` = the quaternion product q p (Hua et al. eq. 25)."""
    M = np.empty((*q.shape[:-1], 4, 4))
    M[..., 0, 0] = q[..., 0]
    M[..., 0, 1:] = -q[..., 1:]
    M[..., 1:, 0] = q[..., 1:]
    M[..., 1:, 1:] = q[..., 0, None, None] * np.eye(3) + skew(q[..., 1:])
    return M


def right_product_matrix(q: Array) -> Array:
    """B(q), (..., 4, 4), with ``B(q) p`` = the quaternion product p q (Hua et al. eq. 25)."""
    M = left_product_matrix(q)
    M[..., 1:, 1:] = q[..., 0, None, None] * np.eye(3) - skew(q[..., 1:])
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


def nearest_rotation(M: Array) -> Array:
    """The proper rotations (..., 3, 3) nearest to ``M`` in the Frobenius norm (SVD with handedness)."""
    U, _, Vt = np.linalg.svd(M)
    U[..., :, 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    rotations: Array = U @ Vt
    return rotations


def mean_pose(X: Array, weights: Array | None = None) -> Array:
    """The mean pose (..., 4, 4) of ``X`` (..., N, 4, 4): chordal mean rotation, arithmetic mean position."""
    w = np.ones(X.shape[:-2]) if weights is None else weights
    w = w / w.sum(axis=-1, keepdims=True)
    mean = np.einsum("...n,...nij->...ij", w, X)
    return pose(nearest_rotation(mean[..., :3, :3]), mean[..., :3, 3])
