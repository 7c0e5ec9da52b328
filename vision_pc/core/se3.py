"""Rigid transforms as 4×4 float64 arrays in the monogram way: ``X_AC = X_AB @ X_BC``, ``X_AB`` is B in A."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.compiled import kernel
from protocol.pose import Pose

Array = NDArray[np.float64]

SMALL_ANGLE = 1e-6  # rad; below it the series' next term is under 1e-13 relative
_IDENTITY = np.eye(4)  # to be copied: that is five times as fast as making one anew
HALF_TURN_COSINE = math.cos(math.pi - 1e-4)  # below it the antisymmetric part of R has lost half its digits


def identity() -> Array:
    """A new 4×4 identity."""
    return _IDENTITY.copy()


def transform(R: ArrayLike, p: ArrayLike) -> Array:
    """X (4×4) with rotation ``R`` (3×3) and translation ``p`` (3,)."""
    X = _IDENTITY.copy()
    X[:3, :3] = R
    X[:3, 3] = np.reshape(np.asarray(p, dtype=np.float64), 3)
    return X


def inverse(X: Array) -> Array:
    """X_BA from X_AB, by transposition."""
    Y = _IDENTITY.copy()
    Y[:3, :3] = X[:3, :3].T
    Y[:3, 3] = -X[:3, :3].T @ X[:3, 3]
    return Y


def inverse_covariance(X: Array, covariance: Array) -> Array:
    """The covariance (6×6) of ``inverse(X)`` when ``covariance`` is that of X."""
    J = np.zeros((6, 6))
    J[:3, :3] = J[3:, 3:] = -X[:3, :3].T
    J[:3, 3:] = -X[:3, :3].T @ hat(X[:3, 3])
    return J @ covariance @ J.T


def apply(X_AB: Array, points_B: Array) -> Array:
    """``points_B`` (n, 3) expressed in A."""
    return points_B @ X_AB[:3, :3].T + X_AB[:3, 3]


def hat(v: ArrayLike) -> Array:
    """The 3×3 cross-product matrix of ``v`` (3,)."""
    x, y, z = np.asarray(v, dtype=np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exp_so3(w: ArrayLike) -> Array:
    """R (3×3) that turns by the rotation vector ``w`` (3,), rad."""
    return np.asarray(rodrigues(np.array(w, dtype=np.float64)))


@kernel(nogil=True)
def rodrigues(w: Array) -> Array:
    """R (3×3) of the rotation vector ``w`` (3,), for compiled callers; others want ``exp_so3``."""
    x, y, z = w
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < SMALL_ANGLE:
        a, b = 1.0, 0.5
    else:
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle**2
    return np.array(
        [
            [1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
            [b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x],
            [b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)],
        ]
    )


def log_so3(R: Array) -> Array:
    """The rotation vector (3,) of R, of length 0…π rad; at π either sign of the axis may come."""
    cosine = 0.5 * (float(np.trace(R)) - 1.0)
    if cosine < HALF_TURN_COSINE:
        w, v = np.split(quaternion_from_rotation(R), [1])
        half = float(np.linalg.norm(v))
        return np.asarray(v * (2.0 * math.atan2(half, float(w[0])) / half))
    v = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    angle = math.atan2(float(np.linalg.norm(v)), cosine)
    return v if angle < SMALL_ANGLE else v * (angle / math.sin(angle))


def angle_between(R_A: Array, R_B: Array) -> float:
    """The angle (rad, 0…π) of the rotation from ``R_A`` to ``R_B``."""
    return float(np.linalg.norm(log_so3(R_A.T @ R_B)))


def retract(X: Array, delta: ArrayLike) -> Array:
    """X moved by ``delta`` = [δp; δθ] (6,): p + δp and exp(δθ) R, both in the axes of the outer frame.

    All 6×6 covariances of the vision side are of this perturbation.
    """
    d = np.asarray(delta, dtype=np.float64)
    return transform(exp_so3(d[3:]) @ X[:3, :3], X[:3, 3] + d[:3])


def local(X: Array, Y: Array) -> Array:
    """The ``delta`` (6,) with ``retract(X, delta) == Y``."""
    return np.concatenate([Y[:3, 3] - X[:3, 3], log_so3(Y[:3, :3] @ X[:3, :3].T)])


def interpolate(X: Array, Y: Array, fraction: float) -> Array:
    """The pose at ``fraction`` (0…1) between X and Y: straight line and geodesic."""
    return retract(X, fraction * local(X, Y))


def nearest_rotation(M: Array) -> Array:
    """The proper rotations nearest to M (..., 3, 3) in the Frobenius norm."""
    U, _, Vt = np.linalg.svd(M)
    proper = np.broadcast_to(np.eye(3), M.shape).copy()
    proper[..., 2, 2] = np.sign(np.linalg.det(U @ Vt))
    return np.asarray(U @ proper @ Vt)


def euler_xyz(R: Array) -> Array:
    """(α, β, γ) in rad with R = Rx(α) Ry(β) Rz(γ): the error angles of Mäkinen et al. 2023, Table 2."""
    return np.array(
        [
            math.atan2(-R[1, 2], R[2, 2]),
            math.atan2(R[0, 2], math.hypot(R[0, 0], R[0, 1])),
            math.atan2(-R[0, 1], R[0, 0]),
        ]
    )


def rotation_from_quaternion(q_wxyz: ArrayLike) -> Array:
    """R (3×3) of the quaternion (w, x, y, z), which is normalised first."""
    q = np.asarray(q_wxyz, dtype=np.float64)
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(R: Array) -> Array:
    """The unit quaternion (w, x, y, z), w ≥ 0, of R.

    Source: Shepperd 1978: the largest component is found first, so nothing is divided by a small number.
    """
    t = float(np.trace(R))
    squares = np.array([t, R[0, 0], R[1, 1], R[2, 2]])
    k = int(np.argmax(squares))
    v = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    q = np.empty(4)
    if k == 0:
        q[0], q[1:] = 1.0 + t, v
    else:
        q[0] = v[k - 1]
        q[1:] = R[:, k - 1] + R[k - 1, :]
        q[k] = 1.0 + 2.0 * R[k - 1, k - 1] - t
    q /= np.linalg.norm(q)
    return q if q[0] >= 0.0 else -q


def to_pose(X: Array) -> Pose:
    """X as it crosses process boundaries."""
    p = X[:3, 3]
    q = quaternion_from_rotation(X[:3, :3])
    return Pose((float(p[0]), float(p[1]), float(p[2])), (float(q[0]), float(q[1]), float(q[2]), float(q[3])))


def from_pose(pose: Pose) -> Array:
    """The 4×4 array of a boundary pose."""
    return transform(rotation_from_quaternion(pose.q_wxyz), pose.p_m)
