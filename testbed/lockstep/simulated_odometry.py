"""Odometry without pictures: points of the true wall, seen with measured noise, posed by vision's solver."""

from typing import NamedTuple

import numpy as np
from pydantic import Field

from foundation.configuration import StrictModel
from plant_emulator.core.camera.exposures import Capture
from testbed.lockstep.true_view import TrueView
from vision_pc.config.vision import OdometrySettings, ToolMarkerSettings
from vision_pc.core import se3
from vision_pc.core.odometry.keyframes.keyframe import Indices
from vision_pc.core.odometry.keyframes.triangulation import triangulated
from vision_pc.core.odometry.limits import GRID_COLUMNS, GRID_ROWS, MINIMUM_INLIERS
from vision_pc.core.odometry.moving_regions import static_pixels
from vision_pc.core.odometry.tracking import Flags, inside
from vision_pc.core.perception import intrinsics, stereo_pose
from vision_pc.core.perception.stereo_pose import BodyView, Priors
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, OdometryPose, PointPairs, StereoOffset

_NO_OFFSET = StereoOffset(0.0, 0.0, 1e-9, 1e-9)
_NO_SCALE = 1e-9
_TOOL_MOVED = 2e-3  # m or rad


class SimulatedFrame(NamedTuple):
    """A ``CameraFrame`` without pixels, for a sensor that simulates: ``shown`` is what it would show."""

    shown: Capture
    capture_ns: int
    frame_id: int


class TrackingNoise(StrictModel):
    """What pictures do to tracked points of the wall.

    ``noise_px``: of one coordinate in one frame. ``map_px``: disparity error of a map point, which every
    frame that sees it shares. ``points``: that hold a frame. ``lost_share``: frames lost though in view.
    """

    noise_px: float = Field(ge=0.0, le=2.0)
    map_px: float = Field(ge=0.0, le=2.0)
    points: int = Field(ge=10, le=5000)
    lost_share: float = Field(ge=0.0, le=1.0)


class _Seen(NamedTuple):
    """Those of ``of`` map points that the left eye sees (n,), where both eyes do (n, 2), and whether the
    right one does.
    """

    ids: Indices
    left: Array
    right: Array
    in_right: Flags
    of: int


class _InView(NamedTuple):
    """Where the eyes see all of the map's points (n, 2), and whether they do (n,)."""

    left: Array
    right: Array
    in_left: Flags
    in_right: Flags

    def of_keyframe(self, ids: Indices) -> _Seen:
        """What is in view of a keyframe's points."""
        seen = ids[self.in_left[ids]]
        return _Seen(seen, self.left[seen], self.right[seen], self.in_right[seen], len(ids))


class ModelOdometry:
    """Implements ``vision_pc.core.perception.watch.Odometry`` from what each frame shows.

    ``camera``: as vision believes it to be. C0 is the camera of the first frame. A keyframe is added where
    the points in view become few, as in vision's own odometry: its points inherit the error of its pose,
    and that is the drift.
    """

    def __init__(
        self,
        camera: CameraCalibration,
        settings: OdometrySettings,
        tool: ToolMarkerSettings,
        noise: TrackingNoise,
        view: TrueView,
        generator: np.random.Generator,
    ) -> None:
        self._camera = camera
        self._settings = settings
        self._tool = tool
        self._noise = noise
        self._view = view
        self._rng = generator
        self._true = np.zeros((0, 3))
        self._map = np.zeros((0, 3))
        self._keyframes: list[Indices] = []  # which map points each of them shows
        self._X_C0C = se3.identity()
        self._masked_for: Array | None = None
        everything = np.ones((camera.height, camera.width), dtype=bool)
        self._static = (everything, everything)
        self._pairs: PointPairs | None = None
        self.last_loss: str | None = None

    def process(
        self, frame: SimulatedFrame, X_CM: Array | None = None, X_BT: Array | None = None
    ) -> OdometryPose | None:
        """The camera's pose in C0, or None when it is lost; then ``last_loss`` names the cause.

        Nothing moves before the camera, so ``X_BT`` is not used.
        """
        self._mask(X_CM)
        lost = self._rng.random() < self._noise.lost_share
        pose = None if lost else self._localise(frame)
        self.last_loss = "too_few_points" if pose is None else None
        return pose

    def _localise(self, frame: SimulatedFrame) -> OdometryPose | None:
        shown = frame.shown
        if not self._keyframes:
            points = self._new_keyframe(shown, np.zeros(0, dtype=np.int64))
            if points < MINIMUM_INLIERS:
                self._keyframes.clear()
                return None
            return self._pose(np.zeros((6, 6)), frame, points)
        view = self._in_view(shown)
        best = max((view.of_keyframe(ids) for ids in self._keyframes), key=lambda seen: len(seen.ids))
        if len(best.ids) < MINIMUM_INLIERS:
            return None
        covariance = self._solve(best)
        if len(best.ids) < self._settings.keyframe_overlap * best.of:
            self._new_keyframe(shown, best.ids)
        return self._pose(covariance, frame, len(best.ids))

    def _mask(self, X_CM: Array | None) -> None:
        moved = X_CM is not None and (
            self._masked_for is None or np.linalg.norm(se3.local(self._masked_for, X_CM)) > _TOOL_MOVED
        )
        if X_CM is not None and moved:
            self._static = static_pixels(X_CM, self._tool, self._camera)
            self._masked_for = X_CM

    def _in_view(self, shown: Capture) -> _InView:
        """Where both eyes see the map's points; keyframes share most of them."""
        left, right = self._view.project(shown, self._true)
        hidden = self._view.hidden(shown, self._true)
        in_left = inside(left, self._static[0]) & ~hidden[0]
        in_right = inside(right, self._static[1]) & ~hidden[1]
        return _InView(left, np.where(in_right[:, None], right, 0.0), in_left, in_right)

    def _solve(self, seen: _Seen) -> Array:
        """The pose's covariance; the pose itself is kept."""
        noise = self._rng.normal(0.0, self._noise.noise_px, (2, len(seen.ids), 2))
        left, right = seen.left + noise[0], seen.right + noise[1]
        self._pairs = PointPairs(left[seen.in_right], right[seen.in_right])
        rays = np.stack(
            [intrinsics.normalised(self._camera.left, left), intrinsics.normalised(self._camera.right, right)]
        )
        weights = np.stack([np.ones(len(seen.ids)), seen.in_right.astype(np.float64)])
        priors = Priors(max(self._noise.noise_px, 1e-3), _NO_SCALE, _NO_OFFSET)
        view = BodyView(self._map[seen.ids], rays, weights)
        solution = stereo_pose.solve([view], [se3.inverse(self._X_C0C)], self._camera, priors)
        self._X_C0C = se3.inverse(solution.X_CA[0])
        return se3.inverse_covariance(solution.X_CA[0], solution.covariances[0])

    def _new_keyframe(self, shown: Capture, held: Indices) -> int:
        """How many points it holds: those ``held``, and new ones, one at most in a cell of the grid."""
        wanted = self._noise.points - len(held)
        width, height = self._camera.width, self._camera.height
        rows, columns = GRID_ROWS, GRID_COLUMNS
        cells = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
        pixels = (cells + self._rng.random(cells.shape)) * (width / columns, height / rows)
        rays = intrinsics.normalised(self._camera.left, pixels)
        points = self._view.on_wall(shown, rays)
        left, right = self._view.project(shown, points)
        good = inside(left, self._static[0]) & inside(right, self._static[1])
        chosen = self._rng.permutation(np.flatnonzero(good))[: max(wanted, 0)]
        found = right[chosen] + self._rng.normal(0.0, self._noise.map_px, (len(chosen), 2))
        points_C, sensible = triangulated(
            intrinsics.normalised(self._camera.left, left[chosen]),
            intrinsics.normalised(self._camera.right, found),
            self._camera,
            self._settings.least_disparity_px,
        )
        first = len(self._map)
        self._true = np.vstack([self._true, points[chosen][sensible]])
        self._map = np.vstack([self._map, se3.apply(self._X_C0C, points_C[sensible])])
        self._keyframes.append(np.concatenate([held, np.arange(first, len(self._map))]))
        return len(self._keyframes[-1])

    def _pose(self, covariance: Array, frame: SimulatedFrame, points: int) -> OdometryPose:
        stamps, noise_px = (frame.capture_ns, frame.frame_id), self._noise.noise_px
        return OdometryPose(*stamps, self._X_C0C, covariance, points, 1.0, noise_px, self._pairs)
