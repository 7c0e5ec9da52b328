"""The pose of one pair against a keyframe: patches found, a robust start, both eyes' residuals, and a bill
of health.
"""

from typing import NamedTuple

import cv2
import numpy as np

from vision_pc.config.vision import OdometrySettings
from vision_pc.core import se3
from vision_pc.core.odometry import patches, tracking
from vision_pc.core.odometry.keyframe_map import SHARED, Indices, Keyframe, KeyframeMap
from vision_pc.core.odometry.motion_prior import Foreseen
from vision_pc.core.odometry.rolling import PointViews, Readout
from vision_pc.core.odometry.templates import Templates
from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.perception import intrinsics, stereo_pose
from vision_pc.core.perception.stereo_pose import BodyPoses, BodyView, Priors
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, CameraModel, Image, StereoOffset, StereoPair

_NO_OFFSET = StereoOffset(0.0, 0.0, 1e-9, 1e-9)
_KEPT = 3  # keyframes whose patches are kept: 4 MB each
_NOWHERE = np.zeros((0, 2))
_NOTHING_FORESEEN = Foreseen()
_UNEXPLAINED = 0.16  # of the picture's parts: more that do not show what they should is a second motion
_FEW = 0.5  # of the points that should be seen: fewer may not bring about a motion that nobody foresaw
_STRICT_SHARE = 0.05  # of a second motion: what was outvoted may be the world
_STRICT = 0.35  # of ``ransac_px``: one pose can hold the world and what is slow for many pictures
_DEPTHS = 3.0  # standard deviations of a point's depth
_SECOND_POINTS = 12  # at least, of a second motion
_GROSS = 4.0  # times what the arm's motion may differ by: nobody asked for more than that
_TAILS = 1.5  # [E] of a pose's variance: single pictures are off by more than a normal error
_FEW_POINTS = 140.0  # [E] with so many a patch that is followed wrongly adds that variance again
_UNKNOWNS = 7  # of a pose and the map's size
_LEAST_NOISE_PX = 0.03  # what matching leaves even in clean pictures


class Frame(NamedTuple):
    """One pair in work, its left picture ``halved``, and where each eye may see the static world (height,
    width).
    """

    pair: StereoPair
    halved: Image
    left_static: Flags
    right_static: Flags


class PoseEstimate(NamedTuple):
    """A pair's pose against the map, with the map points (n,) that hold it, where the left eye sees them,
    and the right eye's rays (n, 2) to those that it sees (n,). ``moving`` (m, 2): where the left eye saw
    points that went another way. ``by_offset`` (6,): how the pose goes by a px of the disparities' offset.
    """

    X_C0C: Array
    covariance: Array
    ids: Indices
    pixels: Array
    right_rays: Array
    seen_right: Flags
    residual_px: float
    moving: Array = _NOWHERE
    by_offset: Array | None = None


class _Motion(NamedTuple):
    """A pose, the points (n,) that agree with it, and those that agree on another."""

    X_CC0: Array
    inliers: Flags
    moving: Flags


class Localiser:
    """Finds the camera against the keyframes of ``keyframe_map``, whose points learn from every success."""

    def __init__(
        self,
        camera: CameraCalibration,
        settings: OdometrySettings,
        keyframe_map: KeyframeMap,
        readout: Readout,
        doubted: bool = False,
    ) -> None:
        self._camera = camera
        self._settings = settings
        self._map = keyframe_map
        self._noise_px = settings.noise_px
        self._kept: list[Templates] = []
        self._readout = readout
        self._first_twist: Array | None = None
        self.mixed_since: int | None = None
        """The keyframe from which on both motions of the last picture were in the map; None: one was seen."""
        self._doubted = doubted

    def localise(
        self,
        frame: Frame,
        keyframe: Keyframe,
        expected: Array,
        both_eyes: bool,
        foreseen: Foreseen = _NOTHING_FORESEEN,
    ) -> PoseEstimate | str:
        """The pose of ``frame``, expected about at ``expected`` (X_C0C), or why the keyframe's points do
        not hold. Of both eyes, or of the left one alone: quicker, and it teaches less about depths.
        Where two motions fit, what is ``foreseen`` decides, if it can.
        """
        guess = intrinsics.project(
            self._camera.left, se3.apply(se3.inverse(expected), self._map.points[keyframe.ids])
        )
        visible = tracking.inside(guess, frame.left_static)
        part = keyframe.only(visible)
        self._keep(keyframe.templates)
        before = tracking.alike(keyframe.halved, frame.halved) if self._watchful else keyframe.halved
        coarse = tracking.track_halved(before, frame.halved, part.pixels, guess[visible], self._settings)
        pixels, good = self._found(part, frame.pair.left, coarse.points, expected, self._camera.left)
        good &= coarse.good & tracking.inside(pixels, frame.left_static)
        part, pixels = part.only(good), pixels[good]
        if len(pixels) >= self._settings.minimum_inliers:
            chosen = self._chosen(frame, keyframe, part, pixels, expected, foreseen)
            if isinstance(chosen, str):
                return chosen
            inliers = chosen.inliers
            if int(inliers.sum()) >= self._settings.minimum_inliers:
                part, usual = part.only(inliers), foreseen.motion
                residual = None if usual is None else usual.residual_px
                found = self._refined(frame, part, pixels[inliers], chosen.X_CC0, both_eyes, residual)
                return found if isinstance(found, str) else found._replace(moving=pixels[chosen.moving])
        return "too_few_points"

    def _chosen(
        self,
        frame: Frame,
        keyframe: Keyframe,
        found: Keyframe,
        pixels: Array,
        expected: Array,
        foreseen: Foreseen,
    ) -> "_Motion | str":
        """The motion to believe of those that fit the ``pixels`` (n, 2) of the points ``found`` of
        ``keyframe``, or the loss's cause.

        A motion that nobody foresaw takes the larger part of the points that should be seen.
        """
        points = self._map.points[found.ids]
        self.mixed_since = None
        strict = self._doubted or (self._watchful and foreseen.arm is not None and self._readout.is_global)
        X_CC0, inliers = self._coarse_pose(points, pixels, expected, strict)
        # An arm tells which of two motions is the camera's: with one, none is to be missed.
        forgiving = foreseen.arm is None and not strict
        other = self._second(found.ids, pixels, (X_CC0, inliers), expected, strict, forgiving)
        if other is None:
            unforeseen = self._watchful and not foreseen.agrees(X_CC0, points, self._camera)
            if unforeseen and self._misses(frame, keyframe, found.ids[inliers], X_CC0):
                return "sudden_motion"
            most = 1.0 if self._watchful else _GROSS
            if foreseen.arm is not None and not foreseen.arm.agrees(se3.inverse(X_CC0), most):
                return "sudden_motion"
            return _Motion(X_CC0, inliers, np.zeros(len(points), dtype=bool))
        X_theirs, theirs = other
        number = foreseen.chosen((X_CC0, X_theirs), points, self._camera)
        self.mixed_since = max(self._map.shown_since(found.ids[one]) for one in (inliers, theirs))
        if isinstance(number, str):
            return number
        return (_Motion(X_CC0, inliers, theirs), _Motion(X_theirs, theirs, inliers))[number]

    def _by_depth(self, ids: Indices, pixels: Array, X_CC0: Array) -> Flags:
        """Which points ``ids`` (n,), seen at ``pixels``, miss a camera at ``X_CC0`` by no more than another
        depth of theirs would bring about: seen from far aside that is many pixels, and no other motion.
        """
        missed = pixels - intrinsics.project(self._camera.left, se3.apply(X_CC0, self._map.points[ids]))
        by_depth = self._map.sensitivity(ids, X_CC0)[0] * self._map.stds(ids)[:, None]
        steps = (missed * by_depth).sum(axis=1) / np.maximum((by_depth**2).sum(axis=1), 1e-12)
        left = missed - np.clip(steps, -_DEPTHS, _DEPTHS)[:, None] * by_depth
        return np.asarray(np.linalg.norm(left, axis=1) < self._settings.ransac_px)

    @property
    def _watchful(self) -> bool:
        """Whether nobody knows what the camera sees."""
        return self._settings.prior_floor_px > 0.0

    def _misses(self, frame: Frame, keyframe: Keyframe, held: Indices, X_CC0: Array) -> bool:
        """Whether a camera at ``X_CC0``, held by the points ``held`` of ``keyframe``, misses too much of the
        others: half of all, or all in parts of the picture, where something else may be the world.
        """
        views = intrinsics.project(self._camera.left, se3.apply(X_CC0, self._map.points[keyframe.ids]))
        shown = tracking.inside(views, frame.left_static)
        seen = np.isin(keyframe.ids, held)
        if int(seen.sum()) < _FEW * int(shown.sum()):
            return True
        sought = shown & ~seen
        there, matched = self._found(
            keyframe.only(sought), frame.pair.left, views[sought], se3.inverse(X_CC0), self._camera.left
        )
        near = np.linalg.norm(there - views[sought], axis=1) < self._settings.ransac_px
        seen[sought] = matched & near
        return tracking.unexplained(views[shown], seen[shown], frame.left_static.shape) > _UNEXPLAINED

    def _keep(self, templates: Templates) -> None:
        """Keep these and those of the few keyframes looked for last; the others are forgotten."""
        self._kept = [kept for kept in self._kept if kept is not templates] + [templates]
        for old in self._kept[:-_KEPT]:
            old.forget()
        self._kept = self._kept[-_KEPT:]

    def _coarse_pose(
        self, points: Array, pixels: Array, expected: Array, strict: bool
    ) -> tuple[Array, Flags]:
        """X_CC0 from the left eye alone by RANSAC, and the points that agree with it; ``strict``: closely."""
        most_px = self._settings.ransac_px * (_STRICT if strict else 1.0)
        X_CC0 = se3.inverse(expected)
        rays = intrinsics.normalised(self._camera.left, pixels)
        rays = self._readout.straight(self._camera.left, rays, se3.apply(X_CC0, points))
        found, rotation, position, inliers = cv2.solvePnPRansac(
            points,
            rays,
            np.eye(3),
            None,
            rvec=se3.log_so3(X_CC0[:3, :3]).reshape(3, 1),
            tvec=X_CC0[:3, 3].reshape(3, 1).copy(),
            useExtrinsicGuess=True,
            iterationsCount=100,
            reprojectionError=most_px / float(self._camera.left.K[0, 0]),
            confidence=0.999,
        )
        flags = np.zeros(len(points), dtype=bool)
        if found and inliers is not None:
            flags[inliers.ravel()] = True
            X_CC0 = se3.transform(se3.exp_so3(rotation.ravel()), position.ravel())
        return X_CC0, flags

    def _second(
        self,
        ids: Indices,
        pixels: Array,
        first: tuple[Array, Flags],
        expected: Array,
        strict: bool,
        forgiving: bool,
    ) -> tuple[Array, Flags] | None:
        """Another pose on which points ``ids`` (n,) at ``pixels`` agree that disagree with the ``first``, and
        which (n,): something large moves, or all but it. They must be ``second_motion_share`` of all at
        least, and where that is ``forgiving`` whatever their depths are; fewer will do where what moves may
        be the larger part (``strict``).
        """
        X_CC0, inliers = first
        share = _STRICT_SHARE if strict else self._settings.second_motion_share
        least = max(
            _SECOND_POINTS if self._watchful else self._settings.minimum_inliers, int(share * len(ids))
        )
        rest = np.flatnonzero(~inliers)
        if share == 0.0 or len(rest) < least:
            return None
        found, agree = self._coarse_pose(self._map.points[ids[rest]], pixels[rest], expected, strict)
        theirs = np.zeros(len(ids), dtype=bool)
        theirs[rest[agree]] = True
        if forgiving:
            agree = agree[agree] & ~self._by_depth(ids[theirs], pixels[theirs], X_CC0)
        return (found, theirs) if int(agree.sum()) >= least else None

    def _refined(
        self,
        frame: Frame,
        keyframe: Keyframe,
        pixels: Array,
        X_CC0: Array,
        both_eyes: bool,
        most_px: float | None,
    ) -> PoseEstimate | str:
        """The pose from the eyes' residuals, robustly, and its health. A residual above ``most_px`` is that
        of two motions in one.
        """
        points = self._map.points[keyframe.ids]
        self._readout.moved(se3.inverse(X_CC0))
        right = self._expected_right(se3.apply(X_CC0, points))
        seen_right = np.zeros(len(points), dtype=bool)
        if both_eyes:
            right, seen_right = self._seen_right(frame, keyframe, right, X_CC0)
        rays = self._rays(pixels, right, se3.apply(X_CC0, points))
        seen = np.stack([np.ones(len(points)), seen_right.astype(np.float64)])
        X_CC0 = self._solve(points, rays, seen * self._weights(keyframe.ids, X_CC0), X_CC0).X_CA[0]
        errors = self._errors(points, rays, X_CC0)
        size = np.max(np.linalg.norm(errors, axis=2) * seen, axis=0)
        held = size < 3.0 * max(self._settings.huber_px, float(np.median(size)))
        cells = tracking.grid_cells(pixels[held], frame.pair.left.shape, self._settings)
        if int(held.sum()) < self._settings.minimum_inliers:
            return "too_few_points"
        if float(cells.mean()) < self._settings.minimum_coverage:
            return "poor_coverage"
        left = float(np.sqrt(np.mean(errors[0][held] ** 2)))
        if most_px is not None and left > most_px:
            return "two_motions"
        return self._settled(keyframe.only(held), pixels[held], rays[:, held], seen[:, held], X_CC0)

    def _expected_right(self, points_C: Array) -> Array:
        """Where the right eye's rows show ``points_C`` (n, 3), px (n, 2)."""
        eye = self._camera.right
        if not self._readout.share:
            return intrinsics.project(eye, points_C)
        in_eye = se3.apply(se3.inverse(eye.X_CE), points_C)
        rays = self._readout.bent(eye, in_eye[:, :2] / in_eye[:, 2:], points_C)
        return np.where(in_eye[:, 2:] > 0.0, intrinsics.distorted(eye, rays), np.nan)

    def _rays(self, left: Array, right: Array, points_C: Array) -> Array:
        """The rays (2, n, 2) of pixels (n, 2) in both eyes, as if all rows were read at once."""
        return np.stack(
            [
                self._readout.straight(eye, intrinsics.normalised(eye, pixels), points_C)
                for eye, pixels in ((self._camera.left, left), (self._camera.right, right))
            ]
        )

    def _seen_right(
        self, frame: Frame, keyframe: Keyframe, guess: Array, X_CC0: Array
    ) -> tuple[Array, Flags]:
        """Where the right eye sees the keyframe's points, px (n, 2), expected at ``guess``; and which."""
        usable = tracking.inside(guess, frame.right_static)
        right, matched = self._found(
            keyframe,
            frame.pair.right,
            np.where(usable[:, None], guess, 0.0),
            se3.inverse(X_CC0),
            self._camera.right,
        )
        on_row = np.abs(right[:, 1] - guess[:, 1]) < self._settings.row_error_px
        return right, usable & matched & on_row

    def _settled(
        self, keyframe: Keyframe, pixels: Array, rays: Array, seen: Array, X_CC0: Array
    ) -> PoseEstimate:
        """The pose from the points that held, which in turn learn from it."""
        ids = keyframe.ids
        weights = seen * self._weights(ids, X_CC0)
        solution = self._solve(self._map.points[ids], rays, weights, X_CC0)
        X_CC0 = solution.X_CA[0]
        self._map.rescale(solution.sizes[0], solution.size_stds[0])
        errors = self._errors(self._map.points[ids], rays, X_CC0)
        residual = float(np.sqrt((errors**2 * seen[:, :, None]).sum() / (2.0 * seen.sum())))
        views = PointViews(
            se3.apply(X_CC0, self._map.points[ids]), rays, errors, seen, self._map.sensitivity(ids, X_CC0)
        )
        self._learn_readout(keyframe, views, max(residual, _LEAST_NOISE_PX))
        told = self._told(ids, X_CC0, errors, weights) if self._watchful else SHARED
        self._map.update(ids, X_CC0, errors, seen, self._noise_px)
        self._noise_px = max(residual, _LEAST_NOISE_PX)
        covariance = told * se3.inverse_covariance(X_CC0, solution.covariances[0])
        if self._readout.share:
            depth = float(np.median(views.points_C[:, 2]))
            covariance = covariance + np.diag(self._readout.std(depth) ** 2)
        by_offset = self._map.by_offset(ids, X_CC0, weights) if self._watchful else None
        found = PoseEstimate(se3.inverse(X_CC0), covariance, ids, pixels, rays[1], seen[1] > 0.0, residual)
        return found._replace(by_offset=by_offset)

    def _weights(self, ids: Indices, X_CC0: Array) -> Array:
        """Weights (2, n) 0…1 of the eyes' views: less where an uncertain depth moves the view."""
        moved = np.linalg.norm(self._map.sensitivity(ids, X_CC0), axis=2) * self._map.stds(ids)
        return np.asarray(self._noise_px / np.hypot(self._noise_px, moved))

    def _learn_readout(self, keyframe: Keyframe, views: PointViews, noise_px: float) -> None:
        """Of the first keyframe's points alone: later ones have been shown by several pictures."""
        if keyframe.number:
            return
        if self._first_twist is None:  # the first picture moved as it did until the second one
            self._first_twist = self._readout.twist
            return
        eyes = (self._camera.left, self._camera.right)
        self._readout.learn(eyes, views, self._first_twist, noise_px)

    def _told(self, ids: Indices, X_CC0: Array, errors: Array, weights: Array) -> float:
        """What the solution's covariance is multiplied by in pictures that nobody here knows."""
        missed = max(self._expected(ids, X_CC0, weights), self._missed(errors, weights))
        return SHARED * missed * (_TAILS + (_FEW_POINTS / len(ids)) ** 2)

    def _expected(self, ids: Indices, X_CC0: Array, weights: Array) -> float:
        """What views (2, n) miss by, squared, of what their ``weights`` expect of them, as well as depths are
        known truly: the floor that weighs them is above that.
        """
        moved = np.linalg.norm(self._map.sensitivity(ids, X_CC0), axis=2) * self._map.told_stds(ids)
        information = weights**2
        truly = information * (1.0 + (moved / self._noise_px) ** 2)
        return float((information * truly).sum() / information.sum())

    def _missed(self, errors: Array, weights: Array) -> float:
        """The same by what they do miss by, ``errors`` (2, n, 2) px."""
        missed = (errors * weights[:, :, None] / self._noise_px) ** 2
        return float(missed.sum() / max(2 * int((weights > 0.0).sum()) - _UNKNOWNS, 1))

    def _solve(self, points: Array, rays: Array, weights: Array, X_CC0: Array) -> BodyPoses:
        return stereo_pose.solve(
            [BodyView(points, rays, weights)],
            [X_CC0],
            self._camera,
            Priors(self._noise_px, self._map.scale_std, _NO_OFFSET),
        )

    def _errors(self, points: Array, rays: Array, X_CC0: Array) -> Array:
        """Measured minus expected views in both eyes, px (2, n, 2)."""
        errors = []
        for eye, seen in zip((self._camera.left, self._camera.right), rays, strict=True):
            in_eye = se3.apply(se3.inverse(eye.X_CE) @ X_CC0, points)
            errors.append((seen - in_eye[:, :2] / in_eye[:, 2:]) * (eye.K[0, 0], eye.K[1, 1]))
        return np.stack(errors)

    def _found(
        self, keyframe: Keyframe, image: Image, guess: Array, X_C0C: Array, eye: CameraModel
    ) -> tuple[Array, Flags]:
        return patches.found(keyframe, image, guess, X_C0C, self._camera.left, eye, self._settings)
