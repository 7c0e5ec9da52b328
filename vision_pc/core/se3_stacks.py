"""Stacks of rigid transforms: the functions of ``se3``, by the same names, with leading batch dimensions.

A hand-eye solver treats all its samples (and all pairs of them) at once within a budget of milliseconds.
Poses are (..., 4, 4), rotations (..., 3, 3), quaternions (..., 4) written w, x, y, z. Conventions and limits
are those of ``se3``.
"""

import numpy as np

from vision_pc.core.se3 import HALF_TURN_COSINE, SMALL_ANGLE, Array, nearest_rotation

_GENERATORS = np.array(
    [[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]],
    dtype=np.float64,
)


def transform(R: Array, t: Array) -> Array:
    """Poses (..., 4, 4) from rotations (..., 3, 3) and translations (..., 3)."""
    X = np.zeros((*R.shape[:-2], 4, 4))
    X[..., :3, :3] = R
    X[..., :3, 3] = t
    X[..., 3, 3] = 1.0
    return X


def inverse(X: Array) -> Array:
    """The inverse poses (..., 4, 4)."""
    R_transposed = np.swapaxes(X[..., :3, :3], -1, -2)
    return transform(R_transposed, -(R_transposed @ X[..., :3, 3, None])[..., 0])


def hat(v: Array) -> Array:
    """Cross-product matrices (..., 3, 3) of vectors (..., 3)."""
    return (v @ _GENERATORS).reshape(*v.shape[:-1], 3, 3)


def exp_so3(v: Array) -> Array:
    """Rotations (..., 3, 3) of rotation vectors (..., 3), radians (Rodrigues)."""
    turn = np.sqrt(np.sum(v * v, axis=-1))
    small = turn < SMALL_ANGLE
    safe = np.where(small, 1.0, turn)
    first = np.where(small, 1.0, np.sin(safe) / safe)
    second = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    S = hat(v)
    rotations: Array = np.eye(3) + first[..., None, None] * S + second[..., None, None] * (S @ S)
    return rotations


def log_so3(R: Array) -> Array:
    """Rotation vectors (..., 3), radians, of rotations (..., 3, 3); exact up to and including a half turn."""
    cosine = 0.5 * (R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2] - 1.0)
    if cosine.min(initial=1.0) > HALF_TURN_COSINE:
        v = np.empty(R.shape[:-1])
        for k, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
            v[..., k] = 0.5 * (R[..., i, j] - R[..., j, i])
        sine = np.sqrt(np.sum(v * v, axis=-1))
        small = sine < SMALL_ANGLE
        scale = np.where(small, 1.0, np.arctan2(sine, cosine) / np.where(small, 1.0, sine))
    else:
        q = quaternion_from_rotation(R)
        v, norm = q[..., 1:], np.linalg.norm(q[..., 1:], axis=-1)
        small = norm < SMALL_ANGLE
        scale = np.where(small, 2.0, 2.0 * np.arctan2(norm, q[..., 0]) / np.where(small, 1.0, norm))
    vectors: Array = scale[..., None] * v
    return vectors


def angle(R: Array) -> Array:
    """Rotation angles (...), radians in [0, pi], of rotations (..., 3, 3); precise near zero and near pi."""
    q = quaternion_from_rotation(R)
    angles: Array = 2.0 * np.arctan2(np.linalg.norm(q[..., 1:], axis=-1), q[..., 0])
    return angles


def quaternion_from_rotation(R: Array) -> Array:
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


def rotation_from_quaternion(q: Array) -> Array:
    """Rotations (..., 3, 3) of quaternions (..., 4), w first, of any non-zero norm."""
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    w, v = q[..., 0, None, None], q[..., 1:]
    S = hat(v)
    rotations: Array = np.eye(3) + 2.0 * w * S + 2.0 * (S @ S)
    return rotations


def mean_pose(X: Array, weights: Array | None = None) -> Array:
    """The mean pose (..., 4, 4) of ``X`` (..., N, 4, 4): chordal mean rotation, arithmetic mean position."""
    w = np.ones(X.shape[:-2]) if weights is None else weights
    w = w / w.sum(axis=-1, keepdims=True)
    mean = np.einsum("...n,...nij->...ij", w, X)
    return transform(nearest_rotation(mean[..., :3, :3]), mean[..., :3, 3])
