"""Forward kinematics by Denavit-Hartenberg parameters, rigid and nominal.

Source: Mäkinen et al. 2023, (23) and (24), Table 1.
"""

import math

import numpy as np

from controller.core.kinematics.rotations import Array
from foundation.compiled import kernel
from nominal_arm.description import DhRow


@kernel
def geometric_jacobian(frames: Array) -> Array:
    """J_BT, (6, 6): rows linear, then angular velocity of T in B (m and rad per rad); columns joints.

    ``frames`` as from ``denavit_hartenberg.chain``. Source: (2).
    """
    J = np.empty((6, JOINTS))
    tip = frames.shape[0] - 1
    for i in range(JOINTS):
        zx, zy, zz = frames[i, 0, 2], frames[i, 1, 2], frames[i, 2, 2]
        rx = frames[tip, 0, 3] - frames[i, 0, 3]
        ry = frames[tip, 1, 3] - frames[i, 1, 3]
        rz = frames[tip, 2, 3] - frames[i, 2, 3]
        J[0, i] = zy * rz - zz * ry
        J[1, i] = zz * rx - zx * rz
        J[2, i] = zx * ry - zy * rx
        J[3, i], J[4, i], J[5, i] = zx, zy, zz
    return J


@kernel
def damped_inverse(J: Array, onset: float, damping_max: float) -> tuple[Array, float, float]:
    """The inverse (6, 6), the least singular value σ, and the squared damping λ² that was used.

    Source: (3), q̇ = J⁻¹ ẋ.

    λ² = λ_max² (1 − (σ/σ_onset)²) below the onset; exactly 0 at and above it, where the result is J⁻¹ itself.
    Lengths count in metres and turns in radians, so at 1 m of lever both weigh alike.
    """
    U, singular, Vt = np.linalg.svd(J)
    least = singular[JOINTS - 1]
    square = 0.0
    if least < onset:
        square = damping_max * damping_max * (1.0 - (least / onset) ** 2)
    scaled = Vt.T.copy()
    for k in range(JOINTS):
        weight = 0.0
        if singular[k] > 0.0:
            weight = singular[k] / (singular[k] * singular[k] + square)
        scaled[:, k] *= weight
    return scaled @ U.T.copy(), least, square


LINKS = 7
JOINTS = 6


def dh_table(rows: tuple[DhRow, ...]) -> Array:
    """Array (7, 4) with columns alpha, a, theta offset, d in radians and metres."""
    return np.array(
        [[math.radians(row.alpha_deg), row.a_m, math.radians(row.theta_offset_deg), row.d_m] for row in rows]
    )


@kernel
def chain(table: Array, q: Array) -> Array:
    """Frames 0…7 of the arm in B as an array (8, 3, 4) of [R | p]; frame 0 is B, frame 7 is T.

    ``table``: (7, 4) from ``dh_table``; ``q``: six joint angles (the seventh link is a mock
    frame without a joint).
    Source: (23), T_i = Rz(θ_i) Tz(d_i) Tx(a_i) Rx(α_i); (24), X_BT = T_1 … T_7.
    """
    frames = np.zeros((LINKS + 1, 3, 4))
    for axis in range(3):
        frames[0, axis, axis] = 1.0
    for i in range(LINKS):
        theta = table[i, 2] + (q[i] if i < JOINTS else 0.0)
        st, ct = math.sin(theta), math.cos(theta)
        sa, ca = math.sin(table[i, 0]), math.cos(table[i, 0])
        a, d = table[i, 1], table[i, 3]
        for row in range(3):
            x, y, z, p = frames[i, row, 0], frames[i, row, 1], frames[i, row, 2], frames[i, row, 3]
            turned = y * ct - x * st
            frames[i + 1, row, 0] = x * ct + y * st
            frames[i + 1, row, 1] = turned * ca + z * sa
            frames[i + 1, row, 2] = z * ca - turned * sa
            frames[i + 1, row, 3] = (x * ct + y * st) * a + z * d + p
    return frames


def tool_pose(table: Array, q: Array) -> Array:
    """X_BT as a homogeneous matrix (4, 4) for six joint angles. Source: (1), (24)."""
    X_BT = np.eye(4)
    X_BT[:3] = chain(table, q)[LINKS]
    return X_BT
