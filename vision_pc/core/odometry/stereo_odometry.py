"""The camera's path in a static world, from stereo pairs against a persistent map of keyframes."""

from typing import NamedTuple

import cv2
import numpy as np

from vision_pc.config import OdometrySettings, ToolMarkerSettings
from vision_pc.core import intrinsics, se3, stereo_pose
from vision_pc.core.odometry import patches, tracking
from vision_pc.core.odometry.keyframe_map import Indices, Keyframe, KeyframeMap, triangulated
from vision_pc.core.odometry.moving_regions import static_pixels
from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.se3 import Array
from vision_pc.core.stereo_pose import Beliefs, Solution, View
from vision_pc.core.types import CameraCalibration, EyeModel, Image, OdometryPose, StereoOffset, StereoPair

_COARSE = 4  # the coarse disparity is sought in pictures this much smaller
_COARSE_DISPARITIES = 64
_NO_OFFSET = StereoOffset(0.0, 0.0, 1e-9, 1e-9)
_TRIES = 3  # keyframes to try before a frame is lost
_TOOL_MOVED = 2e-3  # m or rad
_DARK = 8.0  # mean grey level below which the light is too poor


class _Frame(NamedTuple):
    """One pair in work, and where each eye may see the static world."""

    pair: StereoPair
    left_static: Flags
    right_static: Flags


class _Fix(NamedTuple):
    """A frame's pose against the map, with the map points (n,) that hold it and where the left eye sees
    them.
    """

    X_C0C: Array
    covariance: Array
    ids: Indices
    pixels: Array
    residual_px: float


class StereoOdometry:
    """Follows the camera from pair to pair; C0 is the camera of the first pair that could be used.

    ``camera`` should have the right eye's offset put in (``intrinsics.with_offset``): a disparity error
    bends and scales the path. What moves with the camera is left out by ``tool`` and the tool marker's
    pose, once one was given.
    """

    def __init__(
        self, camera: CameraCalibration, settings: OdometrySettings, tool: ToolMarkerSettings | None = None
    ) -> None:
        self._camera = camera
        self._settings = settings
        self._tool = tool
        self._map = KeyframeMap(camera)
        self._noise_px = settings.huber_px / 3.0
        self._X_C0C = se3.identity()
        self._motion = se3.identity()
        everything = np.ones((camera.height, camera.width), dtype=bool)
        self._static = (everything, everything)
        self._masked_for: Array | None = None
        self.last_loss: str | None = None

    @property
    def keyframes(self) -> int:
        """How many keyframes the map holds."""
        return len(self._map.keyframes)

    def process(self, pair: StereoPair, X_CM: Array | None = None) -> OdometryPose | None:
        """The camera's pose at ``pair``, or None when it is lost; then ``last_loss`` names the cause.

        ``X_CM``: the tool marker as seen in this pair, to keep the tool out of the static world; the last
        one holds. Causes: ``too_dark``, ``no_texture``, ``too_few_points``, ``poor_coverage``.
        """
        frame = self._frame(pair, X_CM)
        if not self._map.keyframes:
            return self._begin(frame)
        fix = self._located(frame)
        if fix is None:
            self._motion = se3.identity()
            return None
        self._motion = se3.inverse(self._X_C0C) @ fix.X_C0C
        self._X_C0C = fix.X_C0C
        self.last_loss = None
        return self._pose(frame, fix)

    def _frame(self, pair: StereoPair, X_CM: Array | None) -> _Frame:
        if X_CM is not None and self._tool is not None and self._has_moved(X_CM):
            self._static = static_pixels(X_CM, self._tool, self._camera)
            self._masked_for = X_CM
        return _Frame(pair, *self._static)

    def _has_moved(self, X_CM: Array) -> bool:
        """Whether the tool is elsewhere in the picture than where it was last left out."""
        return self._masked_for is None or bool(
            np.linalg.norm(se3.local(self._masked_for, X_CM)) > _TOOL_MOVED
        )

    def _begin(self, frame: _Frame) -> OdometryPose | None:
        """The pose of the first usable pair: the identity, with a first keyframe."""
        if float(frame.pair.left[::8, ::8].mean()) < _DARK:
            self.last_loss = "too_dark"
            return None
        nothing = np.zeros((0, 2))
        ids, pixels = self._new_points(frame, self._X_C0C, nothing)
        if len(ids) < self._settings.minimum_inliers:
            self._map = KeyframeMap(self._camera)
            self.last_loss = "no_texture"
            return None
        self._add_keyframe(frame, self._X_C0C, ids, pixels)
        return self._pose(frame, _Fix(self._X_C0C, np.zeros((6, 6)), ids, pixels, 0.0))

    def _pose(self, frame: _Frame, fix: _Fix) -> OdometryPose:
        cells = tracking.grid_cells(fix.pixels, frame.pair.left.shape, self._settings)
        return OdometryPose(
            frame.pair.capture_ns,
            frame.pair.frame_id,
            fix.X_C0C,
            fix.covariance,
            len(fix.ids),
            float(cells.mean()),
            fix.residual_px,
        )

    def _located(self, frame: _Frame) -> _Fix | None:
        """The pose against the most similar keyframes, from the expected motion on or from none."""
        for expected in (self._X_C0C @ self._motion, self._X_C0C):
            for keyframe in self._map.nearest(expected)[:_TRIES]:
                fix = self._against(frame, keyframe, expected)
                if fix is not None:
                    if len(fix.ids) < self._settings.keyframe_overlap * len(keyframe.ids):
                        self._remember(frame, fix)
                    return fix
        return None

    def _against(self, frame: _Frame, keyframe: Keyframe, expected: Array) -> _Fix | None:
        """The pose of ``frame`` by the points of ``keyframe``, None (with ``last_loss``) if they do not
        hold.
        """
        guess = intrinsics.project(
            self._camera.left, se3.apply(se3.inverse(expected), self._map.points[keyframe.ids])
        )
        visible = self._inside(guess, frame.left_static)
        part = keyframe.only(visible)
        coarse = tracking.track(
            keyframe.left, frame.pair.left, part.pixels, guess[visible], self._settings, two_way=False
        )
        pixels, good = self._matched(part, frame.pair.left, coarse.points, expected, self._camera.left)
        good &= coarse.good & self._inside(pixels, frame.left_static)
        part, pixels = part.only(good), pixels[good]
        if len(pixels) >= self._settings.minimum_inliers:
            X_CC0, inliers = self._coarse_pose(self._map.points[part.ids], pixels, expected)
            if int(inliers.sum()) >= self._settings.minimum_inliers:
                return self._refined(frame, part.only(inliers), pixels[inliers], X_CC0)
        self.last_loss = "too_few_points"
        return None

    def _matched(
        self, keyframe: Keyframe, image: Image, guess: Array, X_C0C: Array, eye: EyeModel
    ) -> tuple[Array, Flags]:
        """The keyframe's patches found to sub-pixels in one eye's ``image`` of a camera about at
        ``X_C0C``.
        """
        X_EK = se3.inverse(X_C0C @ eye.X_CE) @ keyframe.X_C0C
        warps = patches.distortions(keyframe.rays, keyframe.surfaces, X_EK, self._camera.left, eye)
        half, likeness = self._settings.patch_px // 2, self._settings.likeness
        return patches.match(keyframe.left, image, keyframe.pixels, guess, warps, half, likeness)

    def _coarse_pose(self, points: Array, pixels: Array, expected: Array) -> tuple[Array, Flags]:
        """X_CC0 from the left eye alone by RANSAC, and the points that agree with it."""
        rays = intrinsics.normalised(self._camera.left, pixels)
        X_CC0 = se3.inverse(expected)
        found, rotation, position, inliers = cv2.solvePnPRansac(
            points,
            rays,
            np.eye(3),
            None,
            rvec=se3.log_so3(X_CC0[:3, :3]).reshape(3, 1),
            tvec=X_CC0[:3, 3].reshape(3, 1).copy(),
            useExtrinsicGuess=True,
            iterationsCount=100,
            reprojectionError=self._settings.ransac_px / float(self._camera.left.K[0, 0]),
            confidence=0.999,
        )
        flags = np.zeros(len(points), dtype=bool)
        if found and inliers is not None:
            flags[inliers.ravel()] = True
            X_CC0 = se3.transform(se3.exp_so3(rotation.ravel()), position.ravel())
        return X_CC0, flags

    def _refined(self, frame: _Frame, keyframe: Keyframe, pixels: Array, X_CC0: Array) -> _Fix | None:
        """The pose from both eyes' residuals, robustly, and its health."""
        points = self._map.points[keyframe.ids]
        guess = intrinsics.project(self._camera.right, se3.apply(X_CC0, points))
        usable = self._inside(guess, frame.right_static)
        right, matched = self._matched(
            keyframe,
            frame.pair.right,
            np.where(usable[:, None], guess, 0.0),
            se3.inverse(X_CC0),
            self._camera.right,
        )
        seen_right = usable & matched & (np.abs(right[:, 1] - guess[:, 1]) < self._settings.row_error_px)
        rays = np.stack(
            [
                intrinsics.normalised(self._camera.left, pixels),
                intrinsics.normalised(self._camera.right, right),
            ]
        )
        seen = np.stack([np.ones(len(points)), seen_right.astype(np.float64)])
        X_CC0 = self._solve(points, rays, seen * self._trust(keyframe.ids, X_CC0), X_CC0).X_CA[0]
        errors = self._errors(points, rays, X_CC0)
        size = np.max(np.linalg.norm(errors, axis=2) * seen, axis=0)
        held = size < 3.0 * max(self._settings.huber_px, float(np.median(size)))
        cells = tracking.grid_cells(pixels[held], frame.pair.left.shape, self._settings)
        if int(held.sum()) < self._settings.minimum_inliers:
            self.last_loss = "too_few_points"
            return None
        if float(cells.mean()) < self._settings.minimum_coverage:
            self.last_loss = "poor_coverage"
            return None
        return self._settled(keyframe.ids[held], pixels[held], rays[:, held], seen[:, held], X_CC0)

    def _settled(self, ids: Indices, pixels: Array, rays: Array, seen: Array, X_CC0: Array) -> _Fix:
        """The pose from the points that held, which in turn learn from it."""
        points = self._map.points[ids]
        solution = self._solve(points, rays, seen * self._trust(ids, X_CC0), X_CC0)
        X_CC0 = solution.X_CA[0]
        errors = self._errors(points, rays, X_CC0)
        residual = float(np.sqrt((errors**2 * seen[:, :, None]).sum() / (2.0 * seen.sum())))
        self._map.learn(ids, X_CC0, errors, seen, max(residual, self._noise_px))
        covariance = se3.inverse_covariance(X_CC0, solution.covariances[0])
        return _Fix(se3.inverse(X_CC0), covariance, ids, pixels, residual)

    def _trust(self, ids: Indices, X_CC0: Array) -> Array:
        """Weights (2, n) 0…1 of the eyes' views: less where an uncertain depth moves the view."""
        moved = np.linalg.norm(self._map.sensitivity(ids, X_CC0), axis=2) * self._map.stds(ids)
        return np.asarray(self._noise_px / np.hypot(self._noise_px, moved))

    def _solve(self, points: Array, rays: Array, weights: Array, X_CC0: Array) -> Solution:
        return stereo_pose.solve(
            [View(points, rays, weights)], [X_CC0], self._camera, Beliefs(self._noise_px, 1e-9, _NO_OFFSET)
        )

    def _errors(self, points: Array, rays: Array, X_CC0: Array) -> Array:
        """Measured minus expected views in both eyes, px (2, n, 2)."""
        errors = []
        for eye, seen in zip((self._camera.left, self._camera.right), rays, strict=True):
            in_eye = se3.apply(se3.inverse(eye.X_CE) @ X_CC0, points)
            errors.append((seen - in_eye[:, :2] / in_eye[:, 2:]) * (eye.K[0, 0], eye.K[1, 1]))
        return np.stack(errors)

    def _remember(self, frame: _Frame, fix: _Fix) -> None:
        """Make ``frame`` a keyframe: the points that hold it, and new ones where there are none."""
        if len(self._map.keyframes) < self._settings.keyframes:
            ids, pixels = self._new_points(frame, fix.X_C0C, fix.pixels)
            self._add_keyframe(
                frame, fix.X_C0C, np.concatenate([fix.ids, ids]), np.vstack([fix.pixels, pixels])
            )

    def _add_keyframe(self, frame: _Frame, X_C0C: Array, ids: Indices, pixels: Array) -> None:
        rays = intrinsics.normalised(self._camera.left, pixels)
        depths = se3.apply(se3.inverse(X_C0C), self._map.points[ids])[:, 2]
        surfaces = patches.planes(rays, depths)
        self._map.keyframes.append(Keyframe(X_C0C, frame.pair.left, ids, pixels, rays, surfaces))

    def _new_points(self, frame: _Frame, X_C0C: Array, taken: Array) -> tuple[Indices, Array]:
        """Numbers and left pixels of new map points, where the picture holds none of ``taken`` (n, 2)."""
        left, right = frame.pair.left, frame.pair.right
        pixels = tracking.features(left, frame.left_static, taken, self._settings)
        guess = pixels - np.column_stack([self._coarse_disparity(left, right, pixels), np.zeros(len(pixels))])
        coarse = tracking.track(left, right, pixels, guess, self._settings, two_way=True)
        points_C, good = self._triangulated(frame, pixels, coarse.points)
        good &= coarse.good
        pixels, points_C, found = pixels[good], points_C[good], coarse.points[good]
        rays = points_C[:, :2] / points_C[:, 2:]
        patch = Keyframe(
            se3.identity(), left, np.arange(len(rays)), pixels, rays, patches.planes(rays, points_C[:, 2])
        )
        found, matched = self._matched(patch, right, found, se3.identity(), self._camera.right)
        points_C, good = self._triangulated(frame, pixels, found)
        good &= matched
        return self._map.add_points(X_C0C, points_C[good], self._noise_px), pixels[good]

    def _triangulated(self, frame: _Frame, left: Array, right: Array) -> tuple[Array, Flags]:
        """Points (n, 3) in C of matched pixels (n, 2) of both eyes, and which of them make sense (n,)."""
        points_C, sensible = triangulated(
            intrinsics.normalised(self._camera.left, left),
            intrinsics.normalised(self._camera.right, right),
            self._camera,
        )
        row_error = np.nan_to_num(
            right[:, 1] - intrinsics.project(self._camera.right, points_C)[:, 1], nan=np.inf
        )
        on_row = np.abs(row_error) < self._settings.row_error_px
        return points_C, sensible & on_row & self._inside(right, frame.right_static)

    def _coarse_disparity(self, left: Image, right: Image, pixels: Array) -> Array:
        """Roughly the disparity (n,) at ``pixels`` of the left picture, from block matching in small
        pictures.
        """
        shape = (left.shape[1] // _COARSE, left.shape[0] // _COARSE)
        small = [cv2.resize(image, shape, interpolation=cv2.INTER_AREA) for image in (left, right)]
        blocks = (
            cv2.StereoBM.create(_COARSE_DISPARITIES, 15).compute(small[0], small[1]).astype(np.float64) / 16.0
        )
        known = blocks[blocks > 0.0]
        blocks[blocks <= 0.0] = float(np.median(known)) if known.size else 0.0
        column = np.clip(pixels[:, 0] / _COARSE, 0, shape[0] - 1).astype(int)
        row = np.clip(pixels[:, 1] / _COARSE, 0, shape[1] - 1).astype(int)
        return np.asarray(blocks[row, column] * _COARSE)

    def _inside(self, pixels: Array, static: Flags) -> Flags:
        """Which of ``pixels`` (n, 2) lie in the picture and show the static world."""
        finite = np.isfinite(pixels).all(axis=1)
        column = np.where(finite, pixels[:, 0], -1.0)
        row = np.where(finite, pixels[:, 1], -1.0)
        inside = (
            (column >= 0) & (column < self._camera.width - 1) & (row >= 0) & (row < self._camera.height - 1)
        )
        return np.asarray(
            inside & static[np.where(inside, row, 0).astype(int), np.where(inside, column, 0).astype(int)]
        )
