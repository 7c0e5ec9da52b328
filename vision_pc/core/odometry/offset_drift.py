"""How a pose and the way behind it give way to an offset that all disparities share.

The offset puts every point at a wrong inverse depth, by the same amount wherever it is. Of a world that lies
square to the line of sight that is a change of scale; of one that is aslant or deep it bends the way too, and
what is bent goes on into the points that are found on it. All of it is linear in the offset, so one vector a
pose tells it.
"""

from typing import NamedTuple

import numpy as np

from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraModel


class HeldBy(NamedTuple):
    """The map's points (n, 3) in C0 that hold a pose, how far each is ``moved`` (n, 3) m already by a px of
    offset, how both eyes' views go with inverse depths (``by_depth`` (2, n, 2) px m), and the views'
    ``weights`` (2, n).
    """

    points: Array
    moved: Array
    by_depth: Array
    weights: Array


def moved(by_offset: Array, origins: Array, points: Array) -> Array:
    """How ``points`` (n, 3), first seen from ``origins`` (n, 3), go with poses that go by ``by_offset``
    (n, 6).
    """
    return np.asarray(by_offset[:, :3] + np.cross(by_offset[:, 3:], points - origins))


def pose_by_offset(
    eyes: tuple[CameraModel, CameraModel], X_C0C: Array, held: HeldBy, disparity_metres: float
) -> Array:
    """How the pose, [δp; δθ] (6,) in C0, goes by a px of the right eye's columns (picture minus model)."""
    R = X_C0C[:3, :3]
    levers = held.points - X_C0C[:3, 3]
    in_camera = levers @ R
    rows, missed = [], []
    for k, eye in enumerate(eyes):
        R_EC = eye.X_CE[:3, :3].T
        seen = (in_camera - eye.X_CE[:3, 3]) @ R_EC.T
        slopes = np.zeros((len(seen), 2, 3))
        for axis in range(2):
            slopes[:, axis, axis] = eye.K[axis, axis] / seen[:, 2]
            slopes[:, axis, 2] = -eye.K[axis, axis] * seen[:, axis] / seen[:, 2] ** 2
        by_point = slopes @ R_EC @ R.T  # px a metre of the point in C0
        goes = held.by_depth[k] / disparity_metres - np.einsum("nij,nj->ni", by_point, held.moved)
        goes[:, 0] += k
        turned = np.cross(by_point, levers[:, None, :])  # by · (L × θ) = (by × L) · θ
        weights = held.weights[k][:, None]
        rows.append((np.concatenate([-by_point, turned], axis=2) * weights[:, :, None]).reshape(-1, 6))
        missed.append((goes * weights).ravel())
    J, r = np.concatenate(rows), np.concatenate(missed)
    return np.asarray(np.linalg.solve(J.T @ J, J.T @ r))
