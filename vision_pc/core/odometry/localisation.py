"""The pose of one pair against a keyframe: patches found, a pose that they agree on, both eyes' residuals,
and what of the picture contradicts it.
"""

from typing import NamedTuple

import cv2
import numpy as np

from vision_pc.core import se3
from vision_pc.core.odometry import contradiction, patches, tracking
from vision_pc.core.odometry.arm_prior import ArmPrior
from vision_pc.core.odometry.frame import Frame, PoseEstimate
from vision_pc.core.odometry.keyframes.keyframe import Indices, Keyframe, TeachingPictures
from vision_pc.core.odometry.keyframes.keyframe_map import HeldViews, KeyframeMap
from vision_pc.core.odometry.keyframes.templates import Templates
from vision_pc.core.odometry.limits import (
    HUBER_PX,
    MINIMUM_COVERAGE,
    MINIMUM_INLIERS,
    NOISE_PX,
    RANSAC_PX,
    ROW_ERROR_PX,
)
from vision_pc.core.odometry.pose_spread import pose_spread
from vision_pc.core.odometry.shared_offset import SharedOffset
from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.perception import intrinsics, stereo_pose
from vision_pc.core.perception.stereo_pose import BodyView, Priors
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, StereoOffset

_NO_OFFSET, _NO_SCALE = StereoOffset(0.0, 0.0, 1e-9, 1e-9), 1e-9
_IN_MEMORY = 3  # keyframes whose patches are kept: 4 MB each
_LEAST_NOISE_PX = 0.03  # what matching leaves even in clean pictures
_FIND_AGAIN = 0.8  # of the points: where flow leads fewer to their patches, the light changed
_CONSENSUS, _FEWEST = 5, 6  # fits at most, and of so many points at least
_SECOND_POINTS = 12  # at least, of a second motion
_AGAINST_ARM = 0.25  # [D] of the limit of contradiction, for a motion that is not the arm's
_GROSS = 4.0  # times what the arm's motion may differ by: no arm does that


class _Motion(NamedTuple):
    """A pose, the points (n,) that agree with it, and whether the arm's state excludes every other."""

    X_CC0: Array
    agree: Flags
    by_arm: bool = False


class _Views(NamedTuple):
    """Where the eyes see points: left ``pixels`` (n, 2), ``rays`` (2, n, 2), which are ``seen`` (2, n);
    ``by_depth`` (2, n, 2): how views move with inverse depths, px m.
    """

    pixels: Array
    rays: Array
    seen: Array
    by_depth: Array


class Localiser:
    """Finds the camera against the keyframes of ``keyframe_map``; points and ``offset`` learn from that."""

    def __init__(
        self,
        camera: CameraCalibration,
        keyframe_map: KeyframeMap,
        offset: SharedOffset,
    ) -> None:
        self._camera = camera
        self._map = keyframe_map
        self._offset = offset
        self._noise_px = NOISE_PX
        self._in_memory: list[Templates] = []
        self._teaching = TeachingPictures()

    def localise(
        self, frame: Frame, keyframe: Keyframe, expected: Array, arm: ArmPrior | None
    ) -> PoseEstimate | str:
        """The pose of ``frame``, expected about at ``expected`` (X_C0C), or why the keyframe's points do not
        hold: ``too_few_points``, ``poor_coverage``, ``sudden_motion`` (not the ``arm``'s), ``two_motions``
        (too much of the picture contradicts the pose, and no arm says that it is right).
        """
        part, pixels = self._tracked(frame, keyframe, expected)
        if len(pixels) < MINIMUM_INLIERS:
            return "too_few_points"
        motion = self._motion(self._map.points[part.ids], pixels, expected, arm)
        if motion is None:
            return "sudden_motion"
        if int(motion.agree.sum()) < MINIMUM_INLIERS:
            return "too_few_points"
        found = self._refined(frame, part.only(motion.agree), pixels[motion.agree], motion.X_CC0)
        if isinstance(found, str) or keyframe.depths is None:
            return found
        if motion.by_arm:
            return found._replace(by_arm=True)
        X_CK = se3.inverse(found.X_C0C) @ keyframe.X_C0C
        share = contradiction.contradicting(keyframe.depths, frame.pair.left, X_CK, self._camera)
        against = arm is not None and not arm.agrees(found.X_C0C)
        if share >= contradiction.LIMIT * (_AGAINST_ARM if against else 1.0):
            return f"two_motions: {100.0 * share:.0f} % of the picture contradict the pose"
        wider = found.spread.covariance / (1.0 - share / contradiction.LIMIT)
        return found._replace(spread=found.spread._replace(covariance=wider))

    def _tracked(self, frame: Frame, keyframe: Keyframe, expected: Array) -> tuple[Keyframe, Array]:
        """The keyframe with those of its points that are found, and their pixels (n, 2) in the left eye."""
        points = self._map.points[keyframe.ids]
        guess = intrinsics.project(self._camera.left, se3.apply(se3.inverse(expected), points))
        visible = tracking.inside(guess, frame.left_static)
        part, guess = keyframe.only(visible), guess[visible]
        self._remember(keyframe.templates)
        before = tracking.alike(keyframe.halved, frame.halved)
        coarse = tracking.track_halved(before, frame.halved, part.pixels, guess)
        eyes = self._camera.left, self._camera.left
        pixels, good = patches.found(part, frame.pair.left, coarse.points, expected, *eyes)
        good &= coarse.good
        if good.sum() < _FIND_AGAIN * len(good):
            again = ~good
            missing = part.only(again)
            pixels[again], good[again] = patches.found(
                missing, frame.pair.left, guess[again], expected, *eyes
            )
        good &= tracking.inside(pixels, frame.left_static)
        return part.only(good), pixels[good]

    def _motion(self, points: Array, pixels: Array, expected: Array, arm: ArmPrior | None) -> _Motion | None:
        """The pose that most points agree on, or of two the ``arm``'s; None: it is not the arm's."""
        first = self._consensus(points, pixels, expected)
        if arm is None:
            return first
        rest = np.flatnonzero(~first.agree)
        if len(rest) >= _SECOND_POINTS:
            X_CC0, agree, _ = self._consensus(points[rest], pixels[rest], expected)
            second = _Motion(X_CC0, np.isin(np.arange(len(points)), rest[agree]))
            fits = [arm.agrees(se3.inverse(one.X_CC0)) for one in (first, second)]
            if agree.sum() >= _SECOND_POINTS and fits.count(True) == 1:
                return (first, second)[fits.index(True)]._replace(by_arm=True)
        return first if arm.agrees(se3.inverse(first.X_CC0), _GROSS) else None

    def _consensus(self, points: Array, pixels: Array, expected: Array) -> _Motion:
        """X_CC0 from the left eye alone by RANSAC, and the points that agree with it."""
        X_CC0, focal = se3.inverse(expected), float(self._camera.left.K[0, 0])
        rays = intrinsics.normalised(self._camera.left, pixels)
        found, rotation, position, inliers = cv2.solvePnPRansac(
            points,
            rays,
            np.eye(3),
            None,
            rvec=se3.log_so3(X_CC0[:3, :3]).reshape(3, 1),
            tvec=X_CC0[:3, 3].reshape(3, 1).copy(),
            useExtrinsicGuess=True,
            iterationsCount=100,
            reprojectionError=RANSAC_PX / focal,
            confidence=0.999,
        )
        agree = np.zeros(len(points), dtype=bool)
        if not found or inliers is None:
            return _Motion(X_CC0, agree)
        agree[inliers.ravel()] = True
        # Fitted again until who agrees stands still: nothing hangs on one sample (locally optimised RANSAC).
        for _ in range(_CONSENSUS):
            X_CC0 = se3.transform(se3.exp_so3(rotation.ravel()), position.ravel())
            there = se3.apply(X_CC0, points)
            off_px = np.linalg.norm(there[:, :2] / there[:, 2:] - rays, axis=1) * focal
            before, agree = agree, (off_px < RANSAC_PX) & (there[:, 2] > 0.0)
            if int(agree.sum()) < _FEWEST or np.array_equal(before, agree):
                break
            rotation, position = cv2.solvePnPRefineLM(
                points[agree], rays[agree], np.eye(3), None, rotation, position
            )
        return _Motion(X_CC0, agree)

    def _remember(self, templates: Templates) -> None:
        """Keep these and those of the few keyframes looked for last; the others are forgotten."""
        self._in_memory = [one for one in self._in_memory if one is not templates] + [templates]
        for old in self._in_memory[:-_IN_MEMORY]:
            old.forget()
        self._in_memory = self._in_memory[-_IN_MEMORY:]

    def _refined(self, frame: Frame, keyframe: Keyframe, pixels: Array, X_CC0: Array) -> PoseEstimate | str:
        """The pose from both eyes' residuals, robustly; the left eye sees the points at ``pixels`` (n, 2)."""
        points = self._map.points[keyframe.ids]
        right, seen_right = self._seen_right(frame, keyframe, points, X_CC0)
        eyes = (self._camera.left, pixels), (self._camera.right, right)
        rays = np.stack([intrinsics.normalised(eye, there) for eye, there in eyes])
        seen = np.stack([np.ones(len(points)), seen_right.astype(np.float64)])
        by_depth = self._map.sensitivity(keyframe.ids, X_CC0)
        X_CC0 = self._solve(points, rays, seen * self._weights(keyframe.ids, by_depth), X_CC0)
        size = np.max(np.linalg.norm(self._errors(points, rays, X_CC0), axis=2) * seen, axis=0)
        held = size < 3.0 * max(HUBER_PX, float(np.median(size)))
        if int(held.sum()) < MINIMUM_INLIERS:
            return "too_few_points"
        if float(tracking.grid_cells(pixels[held], frame.pair.left.shape).mean()) < MINIMUM_COVERAGE:
            return "poor_coverage"
        views = _Views(pixels[held], rays[:, held], seen[:, held], by_depth[:, held])
        return self._estimate_from(keyframe.ids[held], views, X_CC0)

    def _seen_right(
        self, frame: Frame, keyframe: Keyframe, points: Array, X_CC0: Array
    ) -> tuple[Array, Flags]:
        """Where the right eye sees the keyframe's ``points``, px (n, 2), and which are believed."""
        guess = intrinsics.project(self._camera.right, se3.apply(X_CC0, points))
        usable = tracking.inside(guess, frame.right_static)
        start, X_C0C = np.where(usable[:, None], guess, 0.0), se3.inverse(X_CC0)
        eyes = self._camera.left, self._camera.right
        right, matched = patches.found(keyframe, frame.pair.right, start, X_C0C, *eyes)
        return right, usable & matched & (np.abs(right[:, 1] - guess[:, 1]) < ROW_ERROR_PX)

    def _estimate_from(self, ids: Indices, found: _Views, X_CC0: Array) -> PoseEstimate:
        """The pose from the points that held; they learn from it, unless pictures from there have taught."""
        points, rays, seen = self._map.points[ids], found.rays, found.seen
        weights = seen * self._weights(ids, found.by_depth)
        teaches = self._teaching.teaches(X_CC0, points, self._map.next_number)
        X_CC0 = self._solve(points, rays, weights, X_CC0)
        errors = self._errors(points, rays, X_CC0)
        residual = float(np.sqrt((errors**2 * seen[:, :, None]).sum() / (2.0 * seen.sum())))
        views = HeldViews(errors, weights, found.by_depth)
        spread = pose_spread(self._map, ids, X_CC0, views, self._noise_px)
        if teaches:
            self._offset.learn(spread.views_by_offset, views, self._noise_px)
            self._map.update(ids, views._replace(weights=seen), self._noise_px, spread.views_by_offset)
        self._noise_px = max(residual, _LEAST_NOISE_PX)
        right = seen[1] > 0.0
        return PoseEstimate(se3.inverse(X_CC0), spread, ids, found.pixels, rays[1], right, residual)

    def _weights(self, ids: Indices, by_depth: Array) -> Array:
        """Weights (2, n) 0…1 of the eyes' views: less where an uncertain depth moves the view."""
        moved = np.linalg.norm(by_depth, axis=2) * self._map.stds(ids)
        return np.asarray(self._noise_px / np.hypot(self._noise_px, moved))

    def _solve(self, points: Array, rays: Array, weights: Array, X_CC0: Array) -> Array:
        priors = Priors(self._noise_px, _NO_SCALE, _NO_OFFSET)
        view = BodyView(points, rays, weights)
        return stereo_pose.solve([view], [X_CC0], self._camera, priors).X_CA[0]

    def _errors(self, points: Array, rays: Array, X_CC0: Array) -> Array:
        """Measured minus expected views in both eyes, px (2, n, 2)."""
        errors = []
        for eye, seen in zip((self._camera.left, self._camera.right), rays, strict=True):
            in_eye = se3.apply(se3.inverse(eye.X_CE) @ X_CC0, points)
            errors.append((seen - in_eye[:, :2] / in_eye[:, 2:]) * (eye.K[0, 0], eye.K[1, 1]))
        return np.stack(errors)
