"""How a map, and a pose that it holds, give way to an offset that all disparities share.

The offset puts every point at a wrong inverse depth, by the same amount wherever it is. Of a world that lies
square to the line of sight that is a change of scale; of one that is aslant or deep it bends the way too.
What the way itself shows of depths then takes that back: each picture's corrections of inverse depths, and
each adjustment of keyframes, go with the offset as well. All of it is linear in the offset, so one vector a
keyframe and one number a point tell it, per px of the right eye's columns (picture minus model).
"""

from typing import NamedTuple

import numpy as np

from vision_pc.core import se3
from vision_pc.core.odometry.keyframes import bundle_adjustment
from vision_pc.core.odometry.keyframes.keyframe import Indices
from vision_pc.core.odometry.keyframes.triangulation import disparity_metres
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, CameraModel


class Lines(NamedTuple):
    """Where points (n) lie: numbers of their ``first`` keyframes (n,), from whose ``origins`` (n, 3) they go
    along ``directions`` (n, 3) of depth 1, both in C0, and their ``inverse_depths`` (n,) there, 1/m.
    """

    first: Indices
    origins: Array
    directions: Array
    inverse_depths: Array

    def by_depth(self) -> Array:
        """How the points (n, 3) go with their inverse depths, m²."""
        return -self.directions / self.inverse_depths[:, None] ** 2


class PoseDrift(NamedTuple):
    """How a ``pose`` goes, [δp; δθ] (6,) in C0, and what its ``views`` (2, n, 2) px miss by then, measured
    minus expected.
    """

    pose: Array
    views: Array


class MapDrift:
    """How keyframes and inverse depths of a map go."""

    def __init__(self, camera: CameraCalibration) -> None:
        self._eyes = (camera.left, camera.right)
        self._at_first = -1.0 / disparity_metres(camera)
        self._keyframes = np.zeros((0, 6))
        self._inverse_depths = np.zeros(0)

    def add(self, number: int, count: int, pose: Array | None) -> None:
        """Keyframe ``number`` shows ``count`` new points and goes by ``pose`` (6,), None: not at all."""
        gone = np.zeros((1, 6)) if pose is None else pose[None]
        self._keyframes = np.vstack([self._keyframes[:number], gone])
        self._inverse_depths = np.concatenate([self._inverse_depths, np.full(count, self._at_first)])

    def learn(self, ids: Indices, corrections: Array) -> None:
        """The inverse depths of points ``ids`` (n,) were corrected, and that went by ``corrections`` (n,)."""
        self._inverse_depths[ids] += corrections

    def of_points(self, ids: Indices, lines: Lines) -> Array:
        """How points ``ids``, which lie on ``lines``, go (n, 3) in C0."""
        along = lines.by_depth()
        return self._with_keyframe(lines) + along * self._inverse_depths[ids][:, None]

    def of_pose(self, X_C0C: Array, points: Array, gone: Array, weights: Array) -> PoseDrift:
        """How a camera at ``X_C0C`` goes that ``points`` (n, 3), ``gone`` (n, 3), hold by views in both eyes
        that count by ``weights`` (2, n).
        """
        J, r = [], []
        for k, eye in enumerate(self._eyes):
            by_point, by_camera = view_rates(eye, X_C0C, points)
            J.append(by_camera)
            r.append(np.array([float(k), 0.0]) - np.einsum("nij,nj->ni", by_point, gone))
        by_pose, missed, each = np.stack(J), np.stack(r), weights[:, :, None]
        A, b = (by_pose * each[..., None]).reshape(-1, 6), (missed * each).ravel()
        pose = np.asarray(np.linalg.solve(A.T @ A, A.T @ b), dtype=np.float64)
        return PoseDrift(pose, np.asarray(missed - by_pose @ pose))

    def adjust(
        self,
        problem: bundle_adjustment.Problem,
        numbers: list[int],
        ids: Indices,
        lines: Lines,
        px: tuple[float, float],
    ) -> None:
        """Keyframes ``numbers`` and points ``ids``, which lay on ``lines``, were adjusted together: they are
        where ``problem`` has them now. ``px``: its noise, and from where on views count less.
        """
        into = np.linalg.inv(problem.X_CC0)[:, None, :3, :3]
        before, gone = self._keyframes[numbers], self.of_points(ids, lines)
        twists = -(np.swapaxes(into, 2, 3) @ before.reshape(-1, 2, 3, 1)).reshape(-1, 6)
        drifts = bundle_adjustment.Drifts(twists, gone)
        turned, moved = bundle_adjustment.moved_by_offset(problem, self._eyes, px, drifts)
        free = slice(problem.fixed, None)
        self._keyframes[numbers[free]] -= (into[free] @ turned.reshape(-1, 2, 3, 1)).reshape(-1, 6)
        alone, along = gone + moved - self._with_keyframe(lines), lines.by_depth()
        self._inverse_depths[ids] = (alone * along).sum(axis=1) / (along**2).sum(axis=1)

    def _with_keyframe(self, lines: Lines) -> Array:
        """How points (n, 3) go with the keyframes that first showed them."""
        keyframe, lever = self._keyframes[lines.first], lines.directions / lines.inverse_depths[:, None]
        return np.asarray(keyframe[:, :3] + np.cross(keyframe[:, 3:], lever))


def view_rates(eye: CameraModel, X_C0C: Array, points: Array) -> tuple[Array, Array]:
    """How what ``eye`` of a camera at ``X_C0C`` sees goes with ``points`` (n, 3) in C0, px/m (n, 2, 3), and
    with the camera, by [δp; δθ] in C0 (n, 2, 6).
    """
    X_EC0 = se3.inverse(X_C0C @ eye.X_CE)
    seen = se3.apply(X_EC0, points)
    slopes = np.zeros((len(seen), 2, 3))
    for axis in range(2):
        slopes[:, axis, axis] = eye.K[axis, axis] / seen[:, 2]
        slopes[:, axis, 2] = -eye.K[axis, axis] * seen[:, axis] / seen[:, 2] ** 2
    by_point = slopes @ X_EC0[:3, :3]
    turned = np.cross(by_point, (points - X_C0C[:3, 3])[:, None, :])  # by · (L × θ) = (by × L) · θ
    return np.asarray(by_point), np.concatenate([-by_point, turned], axis=2)
