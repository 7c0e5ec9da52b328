"""The nominal kinematic model of the arm, and how the model's errors move the hand.

The errors are those of the encoders' zeros, the links' dimensions, bending under load and backlash. Each may
put the hand off the pose that the controller reports. Perturbations of the hand are [δp; δθ] in the hand's
own axes: X_BT becomes X_BT·exp.
Source: Mäkinen et al. 2023, (23), (24) and Table 1, for the chain; its numbers are those of arm.yaml.
"""

import math

import numpy as np

from nominal_arm.dimensions import DhLink
from vision_pc.config.hand_eye import JOINTS, ArmUncertainty
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.se3 import Array

Links = tuple[DhLink, ...]
ZEROS = slice(0, 8 * JOINTS, 8)  # columns of the encoders' zeros in ``shared_errors``


def frames(links: Links, q: Array) -> Array:
    """The links' frames in B (n, links + 1, 4, 4) at angles ``q`` (n, 6) rad; the last is the hand's."""
    F = np.tile(np.eye(4), (len(q), len(links) + 1, 1, 1))
    for k, link in enumerate(links):
        theta = np.full(len(q), link.theta_offset)
        if k < JOINTS:
            theta = theta + q[:, k]
        c, s, ca, sa = np.cos(theta), np.sin(theta), math.cos(link.alpha), math.sin(link.alpha)
        T = np.tile(np.eye(4), (len(q), 1, 1))
        T[:, 0, :3] = np.stack([c, -s * ca, s * sa], axis=1)
        T[:, 1, :3] = np.stack([s, c * ca, -c * sa], axis=1)
        T[:, 2, 1], T[:, 2, 2] = sa, ca
        T[:, :3, 3] = np.stack([link.a * c, link.a * s, np.full(len(q), link.d)], axis=1)
        F[:, k + 1] = F[:, k] @ T
    return F


def mismatch(links: Links, q: Array, X_BT: Array) -> tuple[Array, Array]:
    """How far ``links`` put the hand at ``q`` (n, 6) off ``X_BT`` (n, 4, 4): metres and radians (n,)."""
    nominal = frames(links, q)[:, -1]
    turn = stacks.angle(np.swapaxes(nominal[:, :3, :3], -1, -2) @ X_BT[:, :3, :3])
    return np.linalg.norm(nominal[:, :3, 3] - X_BT[:, :3, 3], axis=1), turn


def joint_motions(F: Array) -> Array:
    """How the hand moves for each joint's radian, (n, 6, 6): rows [δp; δθ] in the hand's axes."""
    axes, places = F[:, :JOINTS, :3, 2], F[:, :JOINTS, :3, 3]
    shifts = np.cross(axes, F[:, -1:, :3, 3] - places)
    in_base = np.concatenate([shifts, axes], axis=2)
    to_hand = np.swapaxes(F[:, -1, :3, :3], -1, -2)
    parts = [np.einsum("nij,nkj->nik", to_hand, in_base[..., rows]) for rows in (slice(3), slice(3, 6))]
    return np.concatenate(parts, axis=1)


def shared_errors(links: Links, arm: ArmUncertainty, q: Array) -> Array:
    """What is the same in all poses, one column each for one standard deviation: (n, 6, 48).

    Eight for each joint, in the order of the chain: its encoder's zero (``ZEROS``), its bending under a load
    at the hand, by the load's lever, and three places and three turns of its link's end, the hand at last.
    Joint 1's zero moves as the target in B does, joint 6's as the camera in the hand: no sample tells.
    """
    F = frames(links, q)
    to_hand = stacks.inverse(F[:, -1:])
    by_joint = joint_motions(F)
    raised = np.cross(F[:, :JOINTS, :3, 2], F[:, -1:, :3, 3] - F[:, :JOINTS, :3, 3])[..., 2]
    columns = []
    for k in range(JOINTS):
        axis = by_joint[:, :, k : k + 1]
        columns.append(1e-3 * arm.zero_std_mrad * axis)
        columns.append(-1e-3 * arm.bending_mrad_m[k] * raised[:, k, None, None] * axis)
        end = F[:, k + 1] if k + 1 < JOINTS else F[:, -1]
        scale = 1e-3 * np.repeat([arm.link_offset_std_mm[k], arm.link_tilt_std_mrad[k]], 3)
        columns.append(_adjoints(to_hand[:, 0] @ end) * scale)
    return np.concatenate(columns, axis=2)


def backlash(links: Links, arm: ArmUncertainty, q: Array) -> Array:
    """How far each joint's backlash moves the hand, one standard deviation a column: (n, 6, 6)."""
    return np.asarray(joint_motions(frames(links, q)) * 1e-3 * np.array(arm.play_mrad))


def _adjoints(X: Array) -> Array:
    """Motions of a frame seen as motions of another that it lies in at X (n, 4, 4): (n, 6, 6)."""
    R = X[:, :3, :3]
    A = np.zeros((len(X), 6, 6))
    A[:, :3, :3] = A[:, 3:, 3:] = R
    A[:, :3, 3:] = stacks.hat(X[:, :3, 3]) @ R
    return A
