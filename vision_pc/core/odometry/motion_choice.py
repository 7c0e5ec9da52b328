"""Which motion a picture shows: one that its points agree on, and of two the one that was foreseen.

The left eye alone decides. What else moves is left out of the pose by it, or the picture is lost by name.
"""

from typing import NamedTuple

import cv2
import numpy as np

from vision_pc.config.vision import OdometrySettings
from vision_pc.core import se3
from vision_pc.core.odometry import patches, tracking
from vision_pc.core.odometry.frame import Frame
from vision_pc.core.odometry.keyframes.keyframe import Indices, Keyframe
from vision_pc.core.odometry.keyframes.keyframe_map import KeyframeMap
from vision_pc.core.odometry.limits import RANSAC_PX
from vision_pc.core.odometry.motion_prior import Foreseen
from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration

_UNEXPLAINED = 0.16  # of the picture's parts: more that do not show what they should is a second motion
_FEW = 0.5  # of the points that should be seen: fewer may not bring about a motion that nobody foresaw
# Of the points: with 0.3 a rolling shutter was followed, 12 mm off; 0.15 stopped for slow things too.
_SECOND_SHARE = 0.2  # [M]
_STRICT_SHARE = 0.05  # of a second motion: what was outvoted may be the world
_STRICT = 0.35  # of ``RANSAC_PX``: one pose can hold the world and what is slow for many pictures
_DEPTHS = 3.0  # standard deviations of a point's depth
_BY_DEPTH = 0.9  # of a second motion's points: such depths put all of them off, a slow thing but some
_SECOND_POINTS = 12  # at least, of a second motion
_LATELY = 6  # [D] pairs: what nobody foresaw so soon after a second motion may be that one
_CONSENSUS, _FEWEST = 5, 6  # fits at most, and of so many points at least
_GROSS = 4.0  # times what the arm's motion may differ by: nobody asked for more than that


class SeenMotion(NamedTuple):
    """A pose, the points (n,) that agree with it, and those that agree on another."""

    X_CC0: Array
    inliers: Flags
    moving: Flags


class FoundPoints(NamedTuple):
    """Points of a ``whole`` keyframe, those of them that were ``found`` (n), and where, px (n, 2)."""

    whole: Keyframe
    found: Keyframe
    pixels: Array


class MotionChoice:
    """Chooses among the motions that the map's points allow. ``doubted``: something was seen to move before,
    and nothing told which of it the world is.
    """

    def __init__(
        self,
        camera: CameraCalibration,
        settings: OdometrySettings,
        keyframe_map: KeyframeMap,
        doubted: bool,
    ) -> None:
        self._camera = camera
        self._settings = settings
        self._map = keyframe_map
        self._doubted = doubted
        self._two_at = -_LATELY - 1  # the pair in which two motions were seen last
        self.mixed_since: int | None = None
        """The keyframe from which on both motions of the last picture were in the map; None: one was seen."""

    def chosen(
        self, frame: Frame, tracked: FoundPoints, expected: Array, foreseen: Foreseen
    ) -> SeenMotion | str:
        """The motion to believe of those that fit what was ``tracked`` into ``frame``, expected about at
        ``expected`` (X_C0C); or the loss's cause: ``two_motions``, with its detail, or ``sudden_motion``.

        A motion that nobody foresaw takes the larger part of the points that should be seen.
        """
        ids, pixels = tracked.found.ids, tracked.pixels
        points = self._map.points[ids]
        self.mixed_since = None
        strict = self._doubted or (foreseen.arm is not None and self._settings.disparity_std_px > 0.0)
        X_CC0, inliers = self._coarse_pose(points, pixels, expected, strict)
        # An arm tells which of two motions is the camera's: with one, none is to be missed.
        forgiving = foreseen.arm is None and not strict
        other = self._second(ids, pixels, (X_CC0, inliers), expected, strict, forgiving)
        if other is None:
            return self._single(frame, tracked, SeenMotion(X_CC0, inliers, np.zeros_like(inliers)), foreseen)
        X_theirs, theirs = other
        self._two_at = frame.pair.frame_id
        number = foreseen.chosen((X_CC0, X_theirs), points, self._camera)
        self.mixed_since = max(self._map.shown_since(ids[one]) for one in (inliers, theirs))
        if isinstance(number, str):
            return number
        return (SeenMotion(X_CC0, inliers, theirs), SeenMotion(X_theirs, theirs, inliers))[number]

    def _single(
        self, frame: Frame, tracked: FoundPoints, only: SeenMotion, foreseen: Foreseen
    ) -> SeenMotion | str:
        """The ``only`` motion that is seen, or ``sudden_motion`` where it goes against what is known."""
        X_CC0, ids = only.X_CC0, tracked.found.ids
        unforeseen = not foreseen.agrees(X_CC0, self._map.points[ids], self._camera)
        lately = frame.pair.frame_id - self._two_at <= _LATELY
        if unforeseen and (lately or self._misses(frame, tracked.whole, ids[only.inliers], X_CC0)):
            return "sudden_motion"
        if foreseen.arm is not None and not foreseen.arm.agrees(se3.inverse(X_CC0), _GROSS):
            return "sudden_motion"
        return only

    def _misses(self, frame: Frame, keyframe: Keyframe, held: Indices, X_CC0: Array) -> bool:
        """Whether a camera at ``X_CC0``, held by the points ``held`` of ``keyframe``, misses too much of the
        others: half of all, or all in parts of the picture, where something else may be the world.
        """
        eye = self._camera.left
        views = intrinsics.project(eye, se3.apply(X_CC0, self._map.points[keyframe.ids]))
        shown = tracking.inside(views, frame.left_static)
        seen = np.isin(keyframe.ids, held)
        if int(seen.sum()) < _FEW * int(shown.sum()):
            return True
        sought = shown & ~seen
        X_C0C, missing = se3.inverse(X_CC0), keyframe.only(sought)
        there, matched, _ = patches.found(missing, frame.pair.left, views[sought], X_C0C, eye, eye)
        near = np.linalg.norm(there - views[sought], axis=1) < RANSAC_PX
        seen[sought] = matched & near
        return tracking.unexplained(views[shown], seen[shown], frame.left_static.shape) > _UNEXPLAINED

    def _coarse_pose(
        self, points: Array, pixels: Array, expected: Array, strict: bool
    ) -> tuple[Array, Flags]:
        """X_CC0 from the left eye alone by RANSAC, and the points that agree with it; ``strict``: closely."""
        most_px = RANSAC_PX * (_STRICT if strict else 1.0)
        X_CC0 = se3.inverse(expected)
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
            reprojectionError=most_px / float(self._camera.left.K[0, 0]),
            confidence=0.999,
        )
        if not found or inliers is None:
            return X_CC0, np.zeros(len(points), dtype=bool)
        agree = np.zeros(len(points), dtype=bool)
        agree[inliers.ravel()] = True
        # Fitted again until who agrees stands still: nothing hangs on one sample (locally optimised RANSAC).
        for _ in range(_CONSENSUS):
            X_CC0 = se3.transform(se3.exp_so3(rotation.ravel()), position.ravel())
            there = se3.apply(X_CC0, points)
            off_px = np.linalg.norm(there[:, :2] / there[:, 2:] - rays, axis=1) * self._camera.left.K[0, 0]
            before, agree = agree, (off_px < most_px) & (there[:, 2] > 0.0)
            if int(agree.sum()) < _FEWEST or np.array_equal(before, agree):
                break
            rotation, position = cv2.solvePnPRefineLM(
                points[agree], rays[agree], np.eye(3), None, rotation, position
            )
        return X_CC0, agree

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
        which (n,): something large moves, or all but it. They must be ``_SECOND_SHARE`` of all at least;
        fewer will do where what moves may be the larger part (``strict``). Points that other depths
        would nearly all put right are none, if that is to be ``forgiving``.
        """
        X_CC0, inliers = first
        share = _STRICT_SHARE if strict else _SECOND_SHARE
        least = max(_SECOND_POINTS, int(share * len(ids)))
        rest = np.flatnonzero(~inliers)
        if len(rest) < least:
            return None
        found, agree = self._coarse_pose(self._map.points[ids[rest]], pixels[rest], expected, strict)
        theirs = np.zeros(len(ids), dtype=bool)
        theirs[rest[agree]] = True
        if int(agree.sum()) < least:
            return None
        if forgiving and self._by_depth(ids[theirs], pixels[theirs], X_CC0).mean() > _BY_DEPTH:
            return None
        return found, theirs

    def _by_depth(self, ids: Indices, pixels: Array, X_CC0: Array) -> Flags:
        """Which points ``ids`` (n,), seen at ``pixels``, miss a camera at ``X_CC0`` by no more than another
        depth would bring about, as well as depths are truly known: seen from far aside that is many pixels,
        and no other motion.
        """
        missed = pixels - intrinsics.project(self._camera.left, se3.apply(X_CC0, self._map.points[ids]))
        by_depth = self._map.sensitivity(ids, X_CC0)[0] * self._map.reported_stds(ids)[:, None]
        steps = (missed * by_depth).sum(axis=1) / np.maximum((by_depth**2).sum(axis=1), 1e-12)
        left = missed - np.clip(steps, -_DEPTHS, _DEPTHS)[:, None] * by_depth
        return np.asarray(np.linalg.norm(left, axis=1) < RANSAC_PX)
