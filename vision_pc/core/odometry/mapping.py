"""New map points where a picture shows none yet, and new keyframes of them."""

import cv2
import numpy as np

from vision_pc.config.vision import OdometrySettings
from vision_pc.core import se3
from vision_pc.core.odometry import patches, tracking
from vision_pc.core.odometry.frame import Frame, PoseEstimate
from vision_pc.core.odometry.keyframes.keyframe import Keyframe
from vision_pc.core.odometry.keyframes.keyframe_map import KeyframeMap
from vision_pc.core.odometry.keyframes.templates import Templates
from vision_pc.core.odometry.keyframes.triangulation import triangulated
from vision_pc.core.odometry.limits import MINIMUM_INLIERS, NOISE_PX, PATCH_PX, ROW_ERROR_PX
from vision_pc.core.odometry.moving_regions import without
from vision_pc.core.odometry.pose_spread import EXACT
from vision_pc.core.odometry.shared_offset import SharedOffset
from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, Image

_MOST = 0.8
_WINDOW_PX, _LEVELS = 31, 6  # wider than odometry's own: nothing is known of where to look
_ADJUSTED = 5  # [D] the newest keyframes, adjusted with their points


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


_COARSE = 4  # the coarse disparity is sought in pictures this much smaller
_COARSE_DISPARITIES = 64
_COARSE_BLOCK = 15


class Mapper:
    """Adds keyframes to ``keyframe_map``."""

    def __init__(
        self,
        camera: CameraCalibration,
        settings: OdometrySettings,
        keyframe_map: KeyframeMap,
        offset: SharedOffset,
    ) -> None:
        self._camera = camera
        self._settings = settings
        self._map = keyframe_map
        self._offset = offset

    def begin(self, frame: Frame, X_C0C: Array) -> PoseEstimate | str:
        """The first keyframe at ``X_C0C``, or why the pair shows too little to hold on to: ``no_texture``,
        ``bad_rectification``, ``swapped_eyes``; the last two with their figure behind a colon.
        """
        points_C, pixels, right_rays, stds = self._new_points(frame, np.zeros((0, 2)))
        if len(pixels) < MINIMUM_INLIERS:
            return fault(frame, self._settings)
        ids = self._map.add_points(X_C0C, points_C, np.hypot(NOISE_PX, stds[1]))
        self._map.initialise_scale(ids)
        estimate = PoseEstimate(
            X_C0C, EXACT, ids, pixels, right_rays, np.ones(len(ids), dtype=bool), 0.0, stds
        )
        self._add_keyframe(frame, estimate)
        return estimate

    def extend(self, frame: Frame, estimate: PoseEstimate) -> PoseEstimate:
        """``frame``'s pose after it has become a keyframe, adjusted together with the newest ones: with the
        points that hold it, and new ones where there are none. Where the map is full, the keyframe least
        like it is forgotten.
        """
        if len(self._map.keyframes) >= self._settings.keyframes:
            self._map.forget(self._map.nearest(estimate.X_C0C)[-1])
        if len(estimate.moving):
            frame = frame._replace(left_static=without(frame.left_static, estimate.moving))
        points_C, pixels, right_rays, stds = self._new_points(frame, estimate.pixels)
        ids = self._map.add_points(
            estimate.X_C0C,
            points_C,
            np.hypot(NOISE_PX, stds[1]),
            estimate.residual_px,
            estimate.spread.by_offset,
        )
        grown = estimate._replace(
            ids=np.concatenate([estimate.ids, ids]),
            pixels=np.vstack([estimate.pixels, pixels]),
            right_rays=np.vstack([estimate.right_rays, right_rays]),
            seen_right=np.concatenate([estimate.seen_right, np.ones(len(ids), dtype=bool)]),
            match_stds=np.hstack([estimate.match_stds, stds]),
        )
        self._add_keyframe(frame, grown)
        self._map.adjust(_ADJUSTED)
        self._offset.learn(self._map)
        return estimate._replace(X_C0C=self._map.keyframes[-1].X_C0C)

    def _add_keyframe(self, frame: Frame, estimate: PoseEstimate) -> None:
        points_C = se3.apply(se3.inverse(estimate.X_C0C), self._map.points[estimate.ids])
        rays = intrinsics.normalised(self._camera.left, estimate.pixels)
        left = frame.pair.left.copy()
        self._map.keyframes.append(
            Keyframe(
                self._map.next_number,
                estimate.X_C0C,
                left,
                frame.halved,
                estimate.ids,
                estimate.pixels,
                rays,
                patches.planes(rays, points_C[:, 2]),
                estimate.right_rays,
                estimate.seen_right,
                estimate.match_stds,
                self._templates(left, estimate.pixels),
                np.arange(len(rays)),
            )
        )

    def _templates(self, image: Image, pixels: Array) -> Templates:
        return Templates(image, pixels, PATCH_PX)

    def _new_points(self, frame: Frame, taken: Array) -> tuple[Array, Array, Array, Array]:
        """New points (m, 3) in C, their left pixels (m, 2), right rays (m, 2) and what their patches tell of
        both (2, m), px, where the picture holds none of ``taken`` (n, 2).
        """
        left, right = frame.pair.left, frame.pair.right
        pixels = tracking.features(left, frame.left_static, taken, self._settings.features)
        guess = pixels - np.column_stack([self._coarse_disparity(left, right, pixels), np.zeros(len(pixels))])
        coarse = tracking.track(left, right, pixels, guess)
        points_C, good = self._triangulated(frame, pixels, coarse.points)
        good &= coarse.good
        pixels, points_C, found = pixels[good], points_C[good], coarse.points[good]
        rays = points_C[:, :2] / points_C[:, 2:]
        patch = Keyframe(
            0,
            se3.identity(),
            left,
            frame.halved,
            np.arange(len(rays)),
            pixels,
            rays,
            patches.planes(rays, points_C[:, 2]),
            rays,
            np.zeros(len(rays), dtype=bool),
            np.zeros((2, len(rays))),
            self._templates(left, pixels),
            np.arange(len(rays)),
        )
        found, matched, found_stds = patches.found(
            patch, right, found, se3.identity(), self._camera.left, self._camera.right
        )
        points_C, good = self._triangulated(frame, pixels, found)
        good &= matched
        stds = np.stack([np.zeros(int(good.sum())), found_stds[good]])  # the left eye shows what is sought
        right_rays = intrinsics.normalised(self._camera.right, found)[good]
        return points_C[good], pixels[good], right_rays, stds

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

    def _coarse_disparity(self, left: Image, right: Image, pixels: Array) -> Array:
        """Roughly the disparity (n,) at ``pixels`` of the left picture, from block matching in small
        pictures.
        """
        shape = (left.shape[1] // _COARSE, left.shape[0] // _COARSE)
        small = [cv2.resize(image, shape, interpolation=cv2.INTER_AREA) for image in (left, right)]
        blocks = (
            cv2.StereoBM.create(_COARSE_DISPARITIES, _COARSE_BLOCK)
            .compute(small[0], small[1])
            .astype(np.float64)
            / 16.0
        )
        known = blocks[blocks > 0.0]
        blocks[blocks <= 0.0] = float(np.median(known)) if known.size else 0.0
        column = np.clip(pixels[:, 0] / _COARSE, 0, shape[0] - 1).astype(int)
        row = np.clip(pixels[:, 1] / _COARSE, 0, shape[1] - 1).astype(int)
        return np.asarray(blocks[row, column] * _COARSE)
