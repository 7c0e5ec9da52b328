"""Closed-form inverse kinematics of Table 1's structure: lift and tilt in a slewing plane, a spherical wrist.

The servo never uses it (its law is (4) and (5)); it answers, before anything moves, whether a reference can
be reached.
"""

import math
from typing import NamedTuple

import numpy as np

from controller.core.kinematics.rotations import Angles, Array, Rows, Triple, Vector
from foundation.compiled import fused, kernel

REACHED = 0
TOO_FAR = 1  # the wrist centre lies beyond the outstretched boom, or inside its folded reach


class ArmGeometry(NamedTuple):
    """What the closed form needs of a table: lengths (m), and sines and cosines that do not change.

    ``offsets``: of the joint angles (rad). ``aside``, ``height``: of the lift's pivot. ``inner``, ``outer``:
    the boom's two parts, ``bend`` (rad) between the outer one and its link. ``hand``: wrist centre to T.
    """

    offsets: Angles
    aside: float
    height: float
    inner: float
    outer: float
    bend: float
    hand: float
    s6: float
    c6: float
    s7: float
    c7: float


@kernel
def geometry(table: Array) -> ArmGeometry:
    """The ArmGeometry of a table as from ``denavit_hartenberg.dh_table``."""
    offsets = (table[0, 2], table[1, 2], table[2, 2], table[3, 2], table[4, 2], table[5, 2])
    outer, bend = math.hypot(table[2, 1], table[3, 3]), math.atan2(table[3, 3], table[2, 1])
    s6, c6 = math.sin(table[5, 0]), math.cos(table[5, 0])
    s7, c7 = math.sin(table[6, 0]), math.cos(table[6, 0])
    return ArmGeometry(
        offsets, table[0, 1], table[0, 3], table[1, 1], outer, bend, table[5, 3], s6, c6, s7, c7
    )


@kernel
def _near(angle: float, branch: float) -> float:
    """``angle`` plus the whole turns that bring it nearest to ``branch``."""
    return angle - 2.0 * math.pi * round((angle - branch) / (2.0 * math.pi))


@kernel
def _hand_axes(arm: ArmGeometry, row: Triple) -> Triple:
    """A row of R_BT with the turns of the mock link and of link 6 about their x undone, by 90° each."""
    y = row[1] * arm.c7 - row[2] * arm.s7
    z = row[1] * arm.s7 + row[2] * arm.c7
    return row[0], y * arm.c6 - z * arm.s6, y * arm.s6 + z * arm.c6


@kernel
def _wrist(
    arm: ArmGeometry, hand: Rows, slew: float, elevation: float, branch: Vector
) -> tuple[float, float, float]:
    """The wrist's angles behind an outer boom at ``elevation``: z-y-z Euler angles of R_03ᵀ ``hand``."""
    s1, c1, s23, c23 = math.sin(slew), math.cos(slew), math.sin(elevation), math.cos(elevation)
    x, y, z = (c1 * c23, s1 * c23, s23), (s1, -c1, 0.0), (c1 * s23, s1 * s23, -c23)
    xz, yz, zz = _along(x, hand, 2), _along(y, hand, 2), _along(z, hand, 2)
    side = -1.0 if math.sin(branch[4] + arm.offsets[4]) < 0.0 else 1.0
    sine = math.hypot(xz, yz)
    q4 = _near(math.atan2(side * sine, zz) - arm.offsets[4], branch[4])
    # At the wrist's singularity only wrist 1 and 3 together are fixed: wrist 1 stays where it was.
    if sine > 1e-9:
        q3 = _near(math.atan2(-side * yz, -side * xz) - arm.offsets[3], branch[3])
        turn = math.atan2(-side * _along(z, hand, 1), side * _along(z, hand, 0))
    elif zz > 0.0:
        q3 = branch[3]
        turn = math.atan2(_along(y, hand, 0), _along(y, hand, 1)) - (q3 + arm.offsets[3])
    else:
        q3 = branch[3]
        turn = math.atan2(_along(x, hand, 1), _along(y, hand, 1)) + (q3 + arm.offsets[3])
    return q3, q4, _near(turn - arm.offsets[5], branch[5])


@kernel
def _along(axis: Triple, hand: Rows, column: int) -> float:
    return fused(axis[2], hand[2][column], fused(axis[1], hand[1][column], axis[0] * hand[0][column]))


@kernel
def solve(arm: ArmGeometry, R_BT: Rows, p_BT: Vector, branch: Vector) -> tuple[int, Angles, float, float]:
    """``joint_angles`` without arrays; ``branch`` may be an array or a tuple."""
    hand = _hand_axes(arm, R_BT[0]), _hand_axes(arm, R_BT[1]), _hand_axes(arm, R_BT[2])
    x = p_BT[0] - arm.hand * hand[0][2]
    y = p_BT[1] - arm.hand * hand[1][2]
    up = p_BT[2] - arm.hand * hand[2][2] - arm.height
    slew = _near(math.atan2(y, x), branch[0] + arm.offsets[0])
    forward = math.hypot(x, y) - arm.aside
    distance = math.hypot(forward, up)
    stays = branch[0], branch[1], branch[2], branch[3], branch[4], branch[5]
    if distance > arm.inner + arm.outer:
        return TOO_FAR, stays, distance, arm.inner + arm.outer
    if distance < abs(arm.inner - arm.outer):
        return TOO_FAR, stays, distance, abs(arm.inner - arm.outer)
    cosine = distance * distance - arm.inner * arm.inner - arm.outer * arm.outer
    elbow = math.acos(max(-1.0, min(1.0, cosine / (2.0 * arm.inner * arm.outer))))
    if math.sin(branch[2] + arm.offsets[2] - arm.bend) < 0.0:
        elbow = -elbow
    ahead, above = arm.inner + arm.outer * math.cos(elbow), arm.outer * math.sin(elbow)
    lift = math.atan2(up, forward) - math.atan2(above, ahead)
    tilt = elbow + arm.bend
    wrist = _wrist(arm, hand, slew, lift + tilt, branch)
    q1 = _near(lift - arm.offsets[1], branch[1])
    q2 = _near(tilt - arm.offsets[2], branch[2])
    q = slew - arm.offsets[0], q1, q2, wrist[0], wrist[1], wrist[2]
    return REACHED, q, distance, arm.inner + arm.outer


@kernel
def joint_angles(table: Array, R_BT: Array, p_BT: Array, branch: Array) -> tuple[int, Array, float, float]:
    """(verdict, q, value, limit): the joint angles (6,) of X_BT on the branch of the joint angles ``branch``.

    The branch fixes elbow up or down, and the wrist's flip. When the verdict is TOO_FAR, ``value`` is the
    distance from the lift pivot to the wrist centre and ``limit`` the boom's reach that it misses, in metres.
    ``table`` as from ``denavit_hartenberg.dh_table``; ``R_BT`` (3, 3), ``p_BT`` (3,).
    """
    R = (
        (R_BT[0, 0], R_BT[0, 1], R_BT[0, 2]),
        (R_BT[1, 0], R_BT[1, 1], R_BT[1, 2]),
        (R_BT[2, 0], R_BT[2, 1], R_BT[2, 2]),
    )
    verdict, q, value, limit = solve(geometry(table), R, p_BT, branch)
    return verdict, np.array(q), value, limit
