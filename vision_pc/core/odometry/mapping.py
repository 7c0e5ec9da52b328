"""New map points where a picture shows none yet, and new keyframes of them."""

from typing import NamedTuple

import numpy as np

from vision_pc.config.vision import OdometrySettings
from vision_pc.core import se3
from vision_pc.core.odometry import contradiction, patches, tracking
from vision_pc.core.odometry.frame import Frame, PoseEstimate
from vision_pc.core.odometry.keyframes.keyframe import Keyframe
from vision_pc.core.odometry.keyframes.keyframe_map import KeyframeMap
from vision_pc.core.odometry.keyframes.templates import Templates
from vision_pc.core.odometry.keyframes.triangulation import triangulated
from vision_pc.core.odometry.limits import MINIMUM_INLIERS, NOISE_PX, PATCH_PX, ROW_ERROR_PX
from vision_pc.core.odometry.pose_spread import EXACT
from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration

_MOST = 0.8
_WINDOW_PX, _LEVELS = 31, 6  # wider than odometry's own: nothing is known of where to look


def fault(frame: Frame, settings: OdometrySettings) -> str:
    """``bad_rectification: …``, ``swapped_eyes: …`` with what was found, else ``no_texture``."""
    left, right = frame.pair.left, frame.pair.right
    pixels = tracking.features(left, frame.left_static, np.zeros((0, 2)), settings.features)
    if len(pixels) < MINIMUM_INLIERS:
        return "no_texture"
    found = tracking.track(left, right, pixels, pixels.copy(), _WINDOW_PX, _LEVELS)
    if int(found.good.sum()) < MINIMUM_INLIERS:
        return "no_texture"
    moved: Array = found.points[found.good] - pixels[found.good]
    rows, columns = np.median(moved, axis=0)[::-1]
    spread = 1.4826 * float(np.median(np.abs(moved[:, 1] - rows)))
    if abs(rows) > max(ROW_ERROR_PX, spread):  # matches in noise spread wider than they are off
        return (
            f"bad_rectification: right rows {rows:+.1f} px off, spread {spread:.1f} px, {len(moved)} points"
        )
    backwards = int((moved[:, 0] > settings.least_disparity_px).sum())
    if columns > 0.0 and backwards > _MOST * len(moved):
        return f"swapped_eyes: {backwards} of {len(moved)} points farther right in the right picture"
    return "no_texture"


class _NewPoints(NamedTuple):
    """Points (m, 3) in C, their left pixels (m, 2) and right rays (m, 2)."""

    points_C: Array
    pixels: Array
    right_rays: Array


class Mapper:
    """Adds keyframes to ``keyframe_map``."""

    def __init__(
        self, camera: CameraCalibration, settings: OdometrySettings, keyframe_map: KeyframeMap
    ) -> None:
        self._camera = camera
        self._settings = settings
        self._map = keyframe_map

    def begin(self, frame: Frame, X_C0C: Array) -> PoseEstimate | str:
        """The first keyframe at ``X_C0C``, or why the pair shows too little to hold on to: ``no_texture``,
        ``bad_rectification``, ``swapped_eyes``; the last two with their figure behind a colon.
        """
        disparity = self._disparity(frame)
        new = self._new_points(frame, np.zeros((0, 2)), disparity)
        if len(new.pixels) < MINIMUM_INLIERS:
            return fault(frame, self._settings)
        ids = self._map.add_points(X_C0C, new.points_C, NOISE_PX)
        seen = np.ones(len(ids), dtype=bool)
        estimate = PoseEstimate(X_C0C, EXACT, ids, new.pixels, new.right_rays, seen, 0.0)
        self._add_keyframe(frame, estimate, disparity)
        return estimate

    def extend(self, frame: Frame, estimate: PoseEstimate) -> None:
        """Make ``frame`` a keyframe, with the points that hold it and new ones where there are none. Where
        the map is full, the keyframe least like it is forgotten.
        """
        if len(self._map.keyframes) >= self._settings.keyframes:
            self._map.forget(self._map.nearest(estimate.X_C0C)[-1])
        disparity = self._disparity(frame)
        new = self._new_points(frame, estimate.pixels, disparity)
        ids = self._map.add_points(
            estimate.X_C0C, new.points_C, NOISE_PX, estimate.residual_px, estimate.spread.by_offset
        )
        grown = estimate._replace(
            ids=np.concatenate([estimate.ids, ids]), pixels=np.vstack([estimate.pixels, new.pixels])
        )
        self._add_keyframe(frame, grown, disparity)

    def _disparity(self, frame: Frame) -> Array:
        """Disparity of the small pictures, px; 0 or less: unknown."""
        return contradiction.disparities(*map(contradiction.small, (frame.pair.left, frame.pair.right)))

    def _add_keyframe(self, frame: Frame, estimate: PoseEstimate, disparity: Array) -> None:
        points_C = se3.apply(se3.inverse(estimate.X_C0C), self._map.points[estimate.ids])
        depths = contradiction.depths(
            contradiction.small(frame.pair.left), disparity, frame.left_static, self._camera
        )
        made = self._keyframe(frame, estimate.pixels, points_C)
        self._map.keyframes.append(
            made._replace(number=self._map.next_number, X_C0C=estimate.X_C0C, ids=estimate.ids, depths=depths)
        )

    def _keyframe(self, frame: Frame, pixels: Array, points_C: Array) -> Keyframe:
        """A keyframe at C0 that shows ``points_C`` (n, 3) at ``pixels`` (n, 2)."""
        rays, rows = intrinsics.normalised(self._camera.left, pixels), np.arange(len(pixels))
        left = frame.pair.left.copy()
        surfaces = patches.planes(rays, points_C[:, 2])
        templates = Templates(left, pixels, PATCH_PX)
        return Keyframe(0, se3.identity(), left, frame.halved, rows, pixels, rays, surfaces, templates, rows)

    def _new_points(self, frame: Frame, taken: Array, disparity: Array) -> _NewPoints:
        """Those where the picture holds none of ``taken`` (n, 2); ``disparity`` as of ``_disparity``."""
        left, right = frame.pair.left, frame.pair.right
        pixels = tracking.features(left, frame.left_static, taken, self._settings.features)
        coarse = np.column_stack([_at(disparity, pixels), np.zeros(len(pixels))])
        tracked = tracking.track(left, right, pixels, pixels - coarse)
        points_C, good = self._triangulated(frame, pixels, tracked.points)
        good &= tracked.good
        pixels, points_C = pixels[good], points_C[good]
        here = self._keyframe(frame, pixels, points_C)
        found, matched = patches.found(
            here, right, tracked.points[good], se3.identity(), self._camera.left, self._camera.right
        )
        points_C, good = self._triangulated(frame, pixels, found)
        good &= matched
        right_rays = intrinsics.normalised(self._camera.right, found)
        return _NewPoints(points_C[good], pixels[good], right_rays[good])

    def _triangulated(self, frame: Frame, left: Array, right: Array) -> tuple[Array, Flags]:
        """Points (n, 3) in C of matched pixels (n, 2) of both eyes, and which of them make sense (n,)."""
        points_C, sensible = triangulated(
            intrinsics.normalised(self._camera.left, left),
            intrinsics.normalised(self._camera.right, right),
            self._camera,
            self._settings.least_disparity_px,
        )
        row_error = np.nan_to_num(
            right[:, 1] - intrinsics.project(self._camera.right, points_C)[:, 1], nan=np.inf
        )
        on_row = np.abs(row_error) < ROW_ERROR_PX
        return points_C, sensible & on_row & tracking.inside(right, frame.right_static)


def _at(disparity: Array, pixels: Array) -> Array:
    """Roughly the disparity (n,) px at ``pixels`` (n, 2), from that of the small pictures."""
    known = disparity > 0.0
    filled = np.where(known, disparity, np.median(disparity[known]) if known.any() else 0.0)
    rows, columns = disparity.shape
    column = np.clip(pixels[:, 0] / contradiction.SMALLER, 0, columns - 1).astype(int)
    row = np.clip(pixels[:, 1] / contradiction.SMALLER, 0, rows - 1).astype(int)
    return np.asarray(filled[row, column] * contradiction.SMALLER)
