"""What odometry remembers: points of the static world, and keyframes that show them.

A point is held as the inverse of its depth along the ray on which its first keyframe shows it: of all that
is unknown about it, only that is uncertain, and about equally so for near and far points. Every later frame
adds what it saw.
"""

from typing import NamedTuple

import numpy as np

from foundation.compiled import allocation_free
from vision_pc.core import se3
from vision_pc.core.odometry.keyframes.keyframe import Indices, Keyframe
from vision_pc.core.odometry.keyframes.triangulation import disparity_metres
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, CameraModel

SHARED = 2.0  # depths share the errors of the poses at which they were learnt: measured against the truth
_REPORTED_PX = 0.03  # [E] by rendered sequences: what differs from point to point; the rest they share
_NOT_MOVED = np.zeros(6)


class HeldViews(NamedTuple):
    """Both eyes' views (2, n, 2) px of the points that hold a pose: what they miss by, their ``weights``
    (2, n) 0…1, and how they move with the points' inverse depths, px m.
    """

    errors_px: Array
    weights: Array
    by_depth: Array


class KeyframeMap:
    """Map points and the keyframes that show them, kept so that they are found again on the way back.

    ``points`` (n, 3) in C0.
    """

    def __init__(self, camera: CameraCalibration, depth_floor_px: float) -> None:
        self.keyframes: list[Keyframe] = []
        self.points = np.zeros((0, 3))
        self._eyes = (camera.left, camera.right)
        self._depth_floor_px = depth_floor_px
        self._disparity_metres = disparity_metres(camera)
        self._least_std = depth_floor_px / self._disparity_metres
        self._origins, self._directions = np.zeros((0, 3)), np.zeros((0, 3))
        self._reported_std = min(depth_floor_px, _REPORTED_PX) / self._disparity_metres
        self._inverse_depths, self._information, self._reported = np.zeros(0), np.zeros(0), np.zeros(0)
        # how inverse depths, 1/m, and keyframes, [δp; δθ] in C0, go by a px of an offset of all disparities
        self._by_offset, self._keyframes_by_offset = np.zeros(0), np.zeros((0, 6))
        self._first = np.zeros(0, dtype=np.int64)  # number of the keyframe that first shows each point
        self._forgotten = -1  # the greatest number of a keyframe that was left out

    def add_points(
        self,
        X_C0C: Array,
        points_C: Array,
        noise_px: Array | float,
        matched_px: float = 0.0,
        by_offset: Array = _NOT_MOVED,
    ) -> Indices:
        """The numbers given to new ``points_C`` (n, 3), triangulated by a camera at ``X_C0C``, which becomes
        the next keyframe, their disparities to ``noise_px`` (n,); ``matched_px``: what matching truly
        leaves, where that is known; ``by_offset`` (6,) of the camera, as of a ``PoseSpread``.
        """
        first, count = len(self.points), len(points_C)
        inverse_depths = 1.0 / points_C[:, 2]
        self._origins = np.vstack([self._origins, np.tile(X_C0C[:3, 3], (count, 1))])
        self._directions = np.vstack(
            [self._directions, (points_C * inverse_depths[:, None]) @ X_C0C[:3, :3].T]
        )
        self._inverse_depths = np.concatenate([self._inverse_depths, inverse_depths])
        std = np.full(count, noise_px) * self._least_std / self._depth_floor_px
        self._information = np.concatenate([self._information, _precisions(std)])
        reported = np.full(count, np.maximum(noise_px, matched_px)) / self._disparity_metres
        self._reported = np.concatenate([self._reported, _precisions(reported)])
        self._by_offset = np.concatenate([self._by_offset, np.full(count, -1.0 / self._disparity_metres)])
        number = self.next_number
        self._keyframes_by_offset = np.vstack([self._keyframes_by_offset[:number], by_offset])
        self._first = np.concatenate([self._first, np.full(count, number)])
        self.points = np.vstack([self.points, se3.apply(X_C0C, points_C)])
        return np.arange(first, first + count)

    @property
    def next_number(self) -> int:
        """The number of the next keyframe: no one's before, not even of one that was forgotten."""
        return max([keyframe.number for keyframe in self.keyframes[-1:]] + [self._forgotten]) + 1

    def shown_by(self, ids: Indices) -> Indices:
        """The numbers (n,) of the keyframes that first showed points ``ids``."""
        return self._first[ids]

    def sensitivity(self, ids: Indices, X_CC0: Array) -> Array:
        """How far the eyes' views of points ``ids`` move with their inverse depths, px m (2, n, 2)."""
        rates = -self._directions[ids] / self._inverse_depths[ids][:, None] ** 2
        return np.stack([_image_rates(eye, X_CC0, self.points[ids], rates) for eye in self._eyes])

    def pose_rates(self, ids: Indices, X_CC0: Array) -> Array:
        """How the eyes' views of points ``ids`` move with the camera's [δp; δθ] in C0, px (2, n, 2, 6)."""
        place, points = se3.inverse(X_CC0)[:3, 3], self.points[ids]
        rates = np.empty((2, len(ids), 2, 6))
        for eye, its in zip(self._eyes, rates, strict=True):
            focal = float(eye.K[0, 0]), float(eye.K[1, 1])
            _fill_pose_rates(se3.inverse(eye.X_CE) @ X_CC0, focal, place, points, its)
        return rates

    def stds(self, ids: Indices) -> Array:
        """Standard deviations (n,) of the inverse depths, 1/m."""
        return np.asarray(np.maximum(self._information[ids] ** -0.5, self._least_std))

    def reported_stds(self, ids: Indices) -> Array:
        """What inverse depths truly are known to (n,), 1/m: the floor of ``stds`` is what weighs them."""
        return np.asarray(np.maximum(self._reported[ids] ** -0.5, self._reported_std))

    def depths_by_offset(self, ids: Indices) -> Array:
        """How inverse depths of points ``ids`` go (n,), 1/m, by a px of an offset of all disparities. It puts
        each wrong by the same amount at first; what pictures show of depths on the way takes that back.
        """
        return np.asarray(self._by_offset[ids])

    def carried_by_offset(self, ids: Indices, place: Array) -> Array:
        """How a body at ``place`` goes, [δp; δθ] in C0 (n, 6), that the keyframes which first showed points
        ``ids`` carry along, by a px of an offset of all disparities.
        """
        gone = self._keyframes_by_offset[self._first[ids]]
        turned = np.cross(gone[:, 3:], place - self._origins[ids])
        return np.hstack([gone[:, :3] + turned, gone[:, 3:]])

    def update(self, ids: Indices, views: HeldViews, noise_px: float, views_by_offset: Array) -> None:
        """Correct the points ``ids`` by what a frame saw, to ``noise_px`` of one coordinate;
        ``views_by_offset`` (2, n, 2) as of a ``PoseSpread``.
        """
        J = views.by_depth
        precision = views.weights[:, :, None] / noise_px**2
        added = (precision * J * J).sum(axis=(0, 2))
        self._information[ids] += added
        self._reported[ids] += added / SHARED
        known = np.maximum(self._information[ids], self.stds(ids) ** -2.0)
        step = (precision * J * views.errors_px).sum(axis=(0, 2)) / known
        self._by_offset[ids] += (precision * J * views_by_offset).sum(axis=(0, 2)) / known
        limit = 3.0 * self.stds(ids)
        self._inverse_depths[ids] += np.clip(step, -limit, limit)
        self._information[ids] = np.minimum(self._information[ids], self._least_std**-2.0)
        self.points[ids] = self._origins[ids] + self._directions[ids] / self._inverse_depths[ids][:, None]

    def forget(self, keyframe: Keyframe) -> None:
        """Leave ``keyframe`` out of the map; its points stay for those that share them."""
        self._forgotten = max(self._forgotten, keyframe.number)
        self.keyframes = [kept for kept in self.keyframes if kept is not keyframe]

    def nearest(self, X_C0C: Array) -> list[Keyframe]:
        """Keyframes, those first that look most like what a camera at ``X_C0C`` sees."""
        likeness = [
            (keyframe.view_distance(self.points[keyframe.ids], X_C0C), -k)
            for k, keyframe in enumerate(self.keyframes)
        ]
        return [self.keyframes[-k] for _, k in sorted(likeness)]


def _precisions(stds: Array) -> Array:
    """Inverse variances, one by one: a whole array's power differs in the last bit, and runs repeat."""
    return np.array([std**-2.0 for std in stds.tolist()])


def _image_rates(eye: CameraModel, X_CC0: Array, points: Array, rates: Array) -> Array:
    """Velocity (n, 2) px of the image of ``points`` (n, 3) that move with ``rates`` (n, 3), both in C0."""
    X_EC0 = se3.inverse(eye.X_CE) @ X_CC0
    seen, moved = se3.apply(X_EC0, points), rates @ X_EC0[:3, :3].T
    slopes = (moved[:, :2] - seen[:, :2] / seen[:, 2:] * moved[:, 2:]) / seen[:, 2:]
    return np.asarray(slopes * (eye.K[0, 0], eye.K[1, 1]))


@allocation_free
def _fill_pose_rates(
    X_EC0: Array, focal: tuple[float, float], place: Array, points: Array, rates: Array
) -> None:
    """Fill ``rates`` (n, 2, 6): how what an eye sees of ``points`` (n, 3) goes by the [δp; δθ] of the camera
    at ``place`` that carries it, all in C0, px/m and px/rad.
    """
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        depth = X_EC0[2, 0] * x + X_EC0[2, 1] * y + X_EC0[2, 2] * z + X_EC0[2, 3]
        lx, ly, lz = x - place[0], y - place[1], z - place[2]
        for k in range(2):
            ray = (X_EC0[k, 0] * x + X_EC0[k, 1] * y + X_EC0[k, 2] * z + X_EC0[k, 3]) / depth
            scale = focal[k] / depth
            bx = scale * (X_EC0[k, 0] - ray * X_EC0[2, 0])
            by = scale * (X_EC0[k, 1] - ray * X_EC0[2, 1])
            bz = scale * (X_EC0[k, 2] - ray * X_EC0[2, 2])
            rates[n, k, 0], rates[n, k, 1], rates[n, k, 2] = -bx, -by, -bz
            # b · (L × θ) = (b × L) · θ
            rates[n, k, 3] = by * lz - bz * ly
            rates[n, k, 4] = bz * lx - bx * lz
            rates[n, k, 5] = bx * ly - by * lx
