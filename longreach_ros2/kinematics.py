"""The nominal arm's frames under the names of its URDF, its tool and its Jacobian."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from nominal_arm.description import JOINT_NAMES, NominalArm
from nominal_arm.dimensions import dh_links, joint_turn, link_behind_joint

Array = NDArray[np.float64]

BASE, TOOL = "base", "tool"


class Twisted(NamedTuple):
    """A tool pose that moves: ``X_BT`` (4, 4), and ``twist`` (6,), m/s and rad/s in B."""

    X_BT: Array
    twist: Array


class NominalKinematics:
    """Forward kinematics of ``arm``, as controller and vision believe it (Mäkinen et al. 2023, Table 1)."""

    def __init__(self, arm: NominalArm) -> None:
        self._links = dh_links(arm)

    def frames(self, q: ArrayLike) -> dict[str, Array]:
        """X_BF (4, 4) of every frame F by its name: ``base``, ``slew_link`` … ``wrist3_link``, ``tool``.

        ``q``: six joint angles, rad. The link of a joint turns about the z axis of its frame.
        """
        angles = np.asarray(q, dtype=np.float64)
        X = np.eye(4)
        found = {BASE: X}
        for name, link, angle in zip(JOINT_NAMES, self._links, angles, strict=False):
            X = X @ joint_turn(angle + link.theta_offset)
            found[f"{name}_link"] = X
            X = X @ link_behind_joint(link)
        mock = self._links[-1]
        found[TOOL] = X @ joint_turn(mock.theta_offset) @ link_behind_joint(mock)
        return found

    def moving_tool(self, q: ArrayLike, q_rate: ArrayLike) -> Twisted:
        """The tool at joint angles ``q`` (rad) that change by ``q_rate`` (rad/s)."""
        frames = self.frames(q)
        X_BT = frames[TOOL]
        axes = np.array([frames[f"{name}_link"][:3, 2] for name in JOINT_NAMES])
        levers = np.array([X_BT[:3, 3] - frames[f"{name}_link"][:3, 3] for name in JOINT_NAMES])
        jacobian = np.vstack([np.cross(axes, levers).T, axes.T])
        return Twisted(X_BT, jacobian @ np.asarray(q_rate, dtype=np.float64))


def moved(X: Array, twist: Array, seconds: float) -> Array:
    """X (4, 4) after ``seconds`` of ``twist`` (6,), both in the outer frame."""
    Y = X.copy()
    Y[:3, 3] += seconds * twist[:3]
    Y[:3, :3] = Rotation.from_rotvec(seconds * twist[3:]).as_matrix() @ X[:3, :3]
    return Y
