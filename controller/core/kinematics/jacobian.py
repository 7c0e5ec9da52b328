"""Geometric Jacobian and its damped inverse.

Source: Mäkinen et al. 2023, (2) and (3); variable damping after Chiaverini, IEEE T-RA 13 (1997) 398.
"""

import numpy as np

from controller.core.kinematics.rotations import Array
from foundation.compiled import kernel

JOINTS = 6


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
