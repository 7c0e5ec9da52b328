"""The pose of one pair against a keyframe: patches found, the motion chosen that they show, both eyes'
residuals, and a bill of health.
"""

from typing import NamedTuple

import numpy as np

from vision_pc.config.vision import OdometrySettings
from vision_pc.core import se3
from vision_pc.core.odometry import patches, tracking
from vision_pc.core.odometry.frame import Frame, PoseEstimate
from vision_pc.core.odometry.keyframes.keyframe import Indices, Keyframe, TeachingPictures
from vision_pc.core.odometry.keyframes.keyframe_map import HeldViews, KeyframeMap
from vision_pc.core.odometry.keyframes.templates import Templates
from vision_pc.core.odometry.limits import (
    HUBER_PX,
    MINIMUM_COVERAGE,
    MINIMUM_INLIERS,
    NOISE_PX,
    ROW_ERROR_PX,
)
from vision_pc.core.odometry.motion_choice import FoundPoints, MotionChoice
from vision_pc.core.odometry.motion_prior import Foreseen
from vision_pc.core.odometry.pose_spread import pose_spread
from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.perception import intrinsics, stereo_pose
from vision_pc.core.perception.stereo_pose import BodyPoses, BodyView, Priors
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, CameraModel, Image, StereoOffset

_NO_OFFSET = StereoOffset(0.0, 0.0, 1e-9, 1e-9)
_NO_SCALE = 1e-9
_KEPT = 3  # keyframes whose patches are kept: 4 MB each
_NOTHING_FORESEEN = Foreseen()
_LEAST_NOISE_PX = 0.03  # what matching leaves even in clean pictures


class _Views(NamedTuple):
    """Where the eyes see points: left ``pixels`` (n, 2), ``rays`` (2, n, 2), which are ``seen`` (2, n), and
    what their patches tell of that, ``match_stds`` (2, n) px. ``by_depth`` (2, n, 2): how views
    move with inverse depths, px m.
    """

    pixels: Array
    rays: Array
    seen: Array
    match_stds: Array
    by_depth: Array


class Localiser:
    """Finds the camera against the keyframes of ``keyframe_map``, whose points learn from every success."""

    def __init__(
        self,
        camera: CameraCalibration,
        settings: OdometrySettings,
        keyframe_map: KeyframeMap,
        doubted: bool = False,
    ) -> None:
        self._camera = camera
        self._settings = settings
        self._map = keyframe_map
        self._noise_px = NOISE_PX
        self._kept: list[Templates] = []
        self._choice = MotionChoice(camera, settings, keyframe_map, doubted)
        self._teaching = TeachingPictures()

    @property
    def mixed_since(self) -> int | None:
        """The keyframe from which on both motions of the last picture were in the map; None: one was seen."""
        return self._choice.mixed_since

    def localise(
        self,
        frame: Frame,
        keyframe: Keyframe,
        expected: Array,
        both_eyes: bool,
        foreseen: Foreseen = _NOTHING_FORESEEN,
        other_light: bool = False,
    ) -> PoseEstimate | str:
        """The pose of ``frame``, expected about at ``expected`` (X_C0C), or why the keyframe's points do
        not hold. Of both eyes, or of the left one alone: quicker, and it teaches less about depths.
        Where two motions fit, what is ``foreseen`` decides, if it can. In ``other_light`` the points are
        followed by what a shadow does not change: not so finely, and two milliseconds longer.
        """
        guess = intrinsics.project(
            self._camera.left, se3.apply(se3.inverse(expected), self._map.points[keyframe.ids])
        )
        visible = tracking.inside(guess, frame.left_static)
        part = keyframe.only(visible)
        self._keep(keyframe.templates)
        before, after = self._halves(keyframe, frame, other_light)
        coarse = tracking.track_halved(before, after, part.pixels, guess[visible])
        pixels, good, stds = self._find_points(
            part, frame.pair.left, coarse.points, expected, self._camera.left
        )
        good &= coarse.good & tracking.inside(pixels, frame.left_static)
        part, pixels, stds = part.only(good), pixels[good], stds[good]
        if len(pixels) >= MINIMUM_INLIERS:
            chosen = self._choice.chosen(frame, FoundPoints(keyframe, part, pixels), expected, foreseen)
            if isinstance(chosen, str):
                return chosen
            inliers = chosen.inliers
            if int(inliers.sum()) >= MINIMUM_INLIERS:
                left = pixels[inliers], stds[inliers]
                found = self._refined(frame, part.only(inliers), left, chosen.X_CC0, both_eyes)
                return found if isinstance(found, str) else found._replace(moving=pixels[chosen.moving])
        return "too_few_points"

    def _halves(self, keyframe: Keyframe, frame: Frame, other_light: bool) -> tuple[Image, Image]:
        """The halved pictures of both, for flow between them."""
        before, after = keyframe.halved, frame.halved
        if other_light:
            return tracking.evened(before), tracking.evened(after)
        return tracking.alike(before, after), after

    def _keep(self, templates: Templates) -> None:
        """Keep these and those of the few keyframes looked for last; the others are forgotten."""
        self._kept = [kept for kept in self._kept if kept is not templates] + [templates]
        for old in self._kept[:-_KEPT]:
            old.forget()
        self._kept = self._kept[-_KEPT:]

    def _refined(
        self, frame: Frame, keyframe: Keyframe, left: tuple[Array, Array], X_CC0: Array, both_eyes: bool
    ) -> PoseEstimate | str:
        """The pose from the eyes' residuals, robustly, and its health. ``left``: where that eye sees the
        points (n, 2), and to what (n,), px.
        """
        points, pixels = self._map.points[keyframe.ids], left[0]
        right = intrinsics.project(self._camera.right, se3.apply(X_CC0, points))
        seen_right, right_stds = np.zeros(len(points), dtype=bool), np.zeros(len(points))
        if both_eyes:
            right, seen_right, right_stds = self._seen_right(frame, keyframe, right, X_CC0)
        rays = np.stack(
            [
                intrinsics.normalised(eye, there)
                for eye, there in ((self._camera.left, pixels), (self._camera.right, right))
            ]
        )
        seen = np.stack([np.ones(len(points)), seen_right.astype(np.float64)])
        stds = np.stack([left[1], right_stds])
        by_depth = self._map.sensitivity(keyframe.ids, X_CC0)
        weights = seen * self._weights(keyframe.ids, by_depth, stds)
        X_CC0 = self._solve(points, rays, weights, X_CC0).X_CA[0]
        errors = self._errors(points, rays, X_CC0)
        size = np.max(np.linalg.norm(errors, axis=2) * seen, axis=0)
        held = size < 3.0 * max(HUBER_PX, float(np.median(size)))
        cells = tracking.grid_cells(pixels[held], frame.pair.left.shape)
        if int(held.sum()) < MINIMUM_INLIERS:
            return "too_few_points"
        if float(cells.mean()) < MINIMUM_COVERAGE:
            return "poor_coverage"
        views = _Views(pixels[held], rays[:, held], seen[:, held], stds[:, held], by_depth[:, held])
        return self._estimate_from(keyframe.only(held), views, X_CC0)

    def _seen_right(
        self, frame: Frame, keyframe: Keyframe, guess: Array, X_CC0: Array
    ) -> tuple[Array, Flags, Array]:
        """Where the right eye sees the keyframe's points, px (n, 2), expected at ``guess``; which are
        believed, and to what (n,), px.
        """
        usable = tracking.inside(guess, frame.right_static)
        right, matched, stds = self._find_points(
            keyframe,
            frame.pair.right,
            np.where(usable[:, None], guess, 0.0),
            se3.inverse(X_CC0),
            self._camera.right,
        )
        on_row = np.abs(right[:, 1] - guess[:, 1]) < ROW_ERROR_PX
        return right, usable & matched & on_row, stds

    def _estimate_from(self, keyframe: Keyframe, found: "_Views", X_CC0: Array) -> PoseEstimate:
        """The pose from the points that held; they learn from it, unless pictures from there have taught."""
        ids, rays, seen = keyframe.ids, found.rays, found.seen
        trust = seen * self._noise_px / np.hypot(self._noise_px, found.match_stds)
        weights = seen * self._weights(ids, found.by_depth, found.match_stds)
        teaches = self._teaching.teaches(X_CC0, self._map.points[ids], self._map.next_number)
        solution = self._solve(self._map.points[ids], rays, weights, X_CC0, teaches)
        X_CC0 = solution.X_CA[0]
        if teaches:
            self._map.rescale(solution.sizes[0], solution.size_stds[0])
        errors = self._errors(self._map.points[ids], rays, X_CC0)
        residual = float(np.sqrt((errors**2 * seen[:, :, None]).sum() / (2.0 * seen.sum())))
        views = HeldViews(errors, weights, found.by_depth)
        spread = pose_spread(self._map, ids, X_CC0, views, self._noise_px)
        if teaches:
            trusted = views._replace(weights=trust**2)
            self._map.update(ids, trusted, self._noise_px, spread.views_by_offset)
        usual = float(np.sqrt(((errors * trust[:, :, None]) ** 2).sum() / (2.0 * seen.sum())))
        self._noise_px = max(usual, _LEAST_NOISE_PX)
        return PoseEstimate(
            se3.inverse(X_CC0),
            spread,
            ids,
            found.pixels,
            rays[1],
            seen[1] > 0.0,
            residual,
            found.match_stds,
        )

    def _weights(self, ids: Indices, by_depth: Array, match_stds: Array) -> Array:
        """Weights (2, n) 0…1 of the eyes' views: less where an uncertain depth moves the view, or the parts
        of a patch do not agree on it.
        """
        moved = np.linalg.norm(by_depth, axis=2) * self._map.stds(ids)
        return np.asarray(self._noise_px / np.hypot(self._noise_px, np.hypot(moved, match_stds)))

    def _solve(
        self, points: Array, rays: Array, weights: Array, X_CC0: Array, scales: bool = True
    ) -> BodyPoses:
        """The pose, and with ``scales`` how much larger than the map the points are."""
        return stereo_pose.solve(
            [BodyView(points, rays, weights)],
            [X_CC0],
            self._camera,
            Priors(self._noise_px, self._map.scale_std if scales else _NO_SCALE, _NO_OFFSET),
        )

    def _errors(self, points: Array, rays: Array, X_CC0: Array) -> Array:
        """Measured minus expected views in both eyes, px (2, n, 2)."""
        errors = []
        for eye, seen in zip((self._camera.left, self._camera.right), rays, strict=True):
            in_eye = se3.apply(se3.inverse(eye.X_CE) @ X_CC0, points)
            errors.append((seen - in_eye[:, :2] / in_eye[:, 2:]) * (eye.K[0, 0], eye.K[1, 1]))
        return np.stack(errors)

    def _find_points(
        self, keyframe: Keyframe, image: Image, guess: Array, X_C0C: Array, eye: CameraModel
    ) -> tuple[Array, Flags, Array]:
        return patches.found(keyframe, image, guess, X_C0C, self._camera.left, eye)
