"""Closed-form inverse kinematics of Table 1's structure: lift and tilt in a slewing plane, a spherical wrist.

The servo never uses it (its law is (4) and (5)); it answers, before anything moves, whether a reference can
be reached.
"""

import math

import numpy as np

from controller.core.kinematics.rotations import Array
from foundation.compiled import kernel

REACHED = 0
TOO_FAR = 1  # the wrist centre lies beyond the outstretched boom, or inside its folded reach


@kernel
def _near(angle: float, branch: float) -> float:
    """``angle`` plus the whole turns that bring it nearest to ``branch``."""
    return angle - 2.0 * math.pi * round((angle - branch) / (2.0 * math.pi))


@kernel
def _before_mock_link(table: Array, R_BT: Array) -> Array:
    """R_B6: the mock link turns about x by 90°; undone, it leaves frame 6, whose y is the axis of d6."""
    s7, c7 = math.sin(table[6, 0]), math.cos(table[6, 0])
    R_B6 = np.empty((3, 3))
    for row in range(3):
        R_B6[row, 0] = R_BT[row, 0]
        R_B6[row, 1] = R_BT[row, 1] * c7 - R_BT[row, 2] * s7
        R_B6[row, 2] = R_BT[row, 1] * s7 + R_BT[row, 2] * c7
    return R_B6


@kernel
def _set_wrist(table: Array, R_B6: Array, arm: tuple[float, float], branch: Array, q: Array) -> None:
    """Fill in the wrist's angles of ``q``; ``arm``: the slewing angle and the outer boom's elevation."""
    slew, elevation = arm
    s6, c6 = math.sin(table[5, 0]), math.cos(table[5, 0])
    # R_03 columns in B, then the wrist as z-y-z Euler angles of R_03ᵀ R_B6 Rx(−90°).
    s1, c1, s23, c23 = math.sin(slew), math.cos(slew), math.sin(elevation), math.cos(elevation)
    R_03 = np.array([[c1 * c23, s1, c1 * s23], [s1 * c23, -c1, s1 * s23], [s23, 0.0, -c23]])
    turned = np.empty((3, 3))
    turned[:, 0] = R_B6[:, 0]
    turned[:, 1] = R_B6[:, 1] * c6 - R_B6[:, 2] * s6
    turned[:, 2] = R_B6[:, 1] * s6 + R_B6[:, 2] * c6
    wrist = R_03.T.copy() @ turned
    side = -1.0 if math.sin(branch[4] + table[4, 2]) < 0.0 else 1.0
    sine = math.hypot(wrist[0, 2], wrist[1, 2])
    q[4] = _near(math.atan2(side * sine, wrist[2, 2]) - table[4, 2], branch[4])
    # At the wrist's singularity only wrist 1 and 3 together are fixed: wrist 1 stays where it was.
    if sine > 1e-9:
        q[3] = _near(math.atan2(-side * wrist[1, 2], -side * wrist[0, 2]) - table[3, 2], branch[3])
        q[5] = _near(math.atan2(-side * wrist[2, 1], side * wrist[2, 0]) - table[5, 2], branch[5])
    elif wrist[2, 2] > 0.0:
        turn = math.atan2(wrist[1, 0], wrist[1, 1]) - (branch[3] + table[3, 2])
        q[5] = _near(turn - table[5, 2], branch[5])
    else:
        turn = math.atan2(wrist[0, 1], wrist[1, 1]) + (branch[3] + table[3, 2])
        q[5] = _near(turn - table[5, 2], branch[5])


@kernel
def joint_angles(table: Array, R_BT: Array, p_BT: Array, branch: Array) -> tuple[int, Array, float, float]:
    """(verdict, q, value, limit): the joint angles (6,) of X_BT on the branch of the joint angles ``branch``.

    The branch fixes elbow up or down, and the wrist's flip. When the verdict is TOO_FAR, ``value`` is the
    distance from the lift pivot to the wrist centre and ``limit`` the boom's reach that it misses, in metres.
    ``table`` as from ``denavit_hartenberg.dh_table``; ``R_BT`` (3, 3), ``p_BT`` (3,).
    """
    a1, d1, a2, a3, d4, d6 = table[0, 1], table[0, 3], table[1, 1], table[2, 1], table[3, 3], table[5, 3]
    q = branch.copy()

    R_B6 = _before_mock_link(table, R_BT)
    s6, c6 = math.sin(table[5, 0]), math.cos(table[5, 0])
    axis_6 = R_B6[:, 1] * s6 + R_B6[:, 2] * c6
    centre = p_BT - d6 * axis_6

    slew = _near(math.atan2(centre[1], centre[0]), branch[0] + table[0, 2])
    forward = math.hypot(centre[0], centre[1]) - a1
    up = centre[2] - d1
    boom = math.hypot(a3, d4)
    bend = math.atan2(d4, a3)
    distance = math.hypot(forward, up)
    if distance > a2 + boom:
        return TOO_FAR, q, distance, a2 + boom
    if distance < abs(a2 - boom):
        return TOO_FAR, q, distance, abs(a2 - boom)
    cosine = (distance * distance - a2 * a2 - boom * boom) / (2.0 * a2 * boom)
    elbow = math.acos(max(-1.0, min(1.0, cosine)))
    if math.sin(branch[2] + table[2, 2] - bend) < 0.0:
        elbow = -elbow
    lift = math.atan2(up, forward) - math.atan2(boom * math.sin(elbow), a2 + boom * math.cos(elbow))
    tilt = elbow + bend
    q[0] = slew - table[0, 2]
    q[1] = _near(lift - table[1, 2], branch[1])
    q[2] = _near(tilt - table[2, 2], branch[2])

    _set_wrist(table, R_B6, (slew, lift + tilt), branch, q)
    return REACHED, q, distance, a2 + boom
