"""Odometry of a whole recording: new maps after losses, joined when an old one is seen again."""

from typing import NamedTuple

import numpy as np

from vision_pc.config.vision import OdometrySettings
from vision_pc.core import se3
from vision_pc.core.odometry.keyframes.triangulation import triangulated
from vision_pc.core.odometry.shared_offset import FoundOffset, SharedOffset
from vision_pc.core.odometry.stereo_odometry import StereoOdometry
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, OdometryPose, PointPairs, StereoPair

_FEWEST = 25
_ROUNDS = 5
_HUBER_PX = 0.2


def straightened(camera: CameraCalibration, seen: PointPairs) -> CameraCalibration:
    """``camera`` with the right eye lowered and turned so that the rows of ``seen`` agree; as it is where
    fewer than 25 points tell.
    """
    rays = [
        intrinsics.normalised(eye, pixels)
        for eye, pixels in ((camera.left, seen.left), (camera.right, seen.right))
    ]
    points, good = triangulated(rays[0], rays[1], camera, 0.0)
    if int(good.sum()) < _FEWEST:
        return camera
    expected = intrinsics.project(camera.right, points[good])
    lower = seen.right[good, 1] - expected[:, 1]
    design = np.column_stack([np.ones(len(lower)), expected[:, 0] - camera.right.K[0, 2]])
    weights = np.ones(len(lower))
    for _ in range(_ROUNDS):
        root = np.sqrt(weights)[:, None]
        (rows_px, slope), *_ = np.linalg.lstsq(root * design, root[:, 0] * lower, rcond=None)
        missed = np.abs(lower - design @ (rows_px, slope))
        weights = np.minimum(1.0, _HUBER_PX / np.maximum(missed, 1e-9))
    turned = camera.right.X_CE @ se3.transform(se3.exp_so3([0.0, 0.0, -slope]), np.zeros(3))
    lowered = intrinsics.with_offset(camera, 0.0, float(rows_px))
    return lowered._replace(right=lowered.right._replace(X_CE=turned))


_RESTART_AFTER = 3  # [D] pairs lost in a row, then a new map
_REJOIN_EVERY = 2  # [D] pairs between two searches of the maps before


class PlacedPose(NamedTuple):
    """A pose in the C0 of map number ``segment``, with the covariance of the whole way from there."""

    segment: int
    pose: OdometryPose


class SegmentedOdometry:
    """``StereoOdometry`` that begins a new map when it was lost for some pairs in a row.

    ``joints[k]`` is the pose of map k's C0 in the first map's, None as long as nothing that both show was
    seen: between them is a gap of unknown length. ``offset`` learns that of the disparities.
    """

    def __init__(self, camera: CameraCalibration, settings: OdometrySettings) -> None:
        self._camera = camera
        self._settings = settings
        self.offset = SharedOffset(learns=settings.disparity_std_px > 0.0)
        self._begin_anew()
        self._current = 0
        self._straight = False
        self._lost = self._since_search = 0
        self.joints: list[Array | None] = [se3.identity()]

    def _begin_anew(self) -> None:
        """An empty first map, of the camera as it is believed now."""
        self._maps = [StereoOdometry(self._camera, self._settings, offset=self.offset)]

    def correct(self, offset: FoundOffset) -> None:
        """Before the first pair: take out the ``offset`` that an earlier pass over the pairs found."""
        self._camera = intrinsics.with_offset(self._camera, offset.px, 0.0)
        self._settings = self._settings.model_copy(update={"disparity_std_px": offset.std_px})
        self.offset = SharedOffset(learns=False)
        self._begin_anew()

    @property
    def offset_found(self) -> FoundOffset | None:
        """The disparities' offset and its standard deviation, px, where the recording shows it."""
        return self.offset.found(self._settings.disparity_std_px)

    @property
    def keyframes(self) -> int:
        """How many keyframes all maps hold."""
        return sum(one.keyframes for one in self._maps)

    @property
    def last_loss(self) -> str | None:
        """Why the last pair was lost, None if it was not."""
        return self._maps[self._current].last_loss

    @property
    def last_detail(self) -> str | None:
        """The loss's figure, where it has one."""
        return self._maps[self._current].last_detail

    def process(self, pair: StereoPair) -> PlacedPose | None:
        """The camera's pose at ``pair``, or None when it is lost; then ``last_loss`` names the cause."""
        pose = self._maps[self._current].process(pair)
        if pose is None:
            self._lost += 1
            if self._lost < _RESTART_AFTER or not self._maps[self._current].keyframes:
                return None
            return self._in_older(pair) or self._begin_map(pair)
        self._lost = 0
        if not self._straight and pose.pairs is not None:
            self._camera, self._straight = straightened(self._camera, pose.pairs), True
            self._begin_anew()
            pose = self._maps[0].process(pair)
            return None if pose is None else PlacedPose(0, pose)
        self._since_search += 1
        if self.joints[self._current] is None and self._since_search % _REJOIN_EVERY == 0:
            newer = self._current
            found = self._in_older(pair)
            if found is not None:
                there = self.joints[found.segment]
                joint = found.pose.X_C0C @ se3.inverse(pose.X_C0C)
                self.joints[newer] = None if there is None else there @ joint
                return found
        return PlacedPose(self._current, pose)

    def _in_older(self, pair: StereoPair) -> PlacedPose | None:
        """The pose in an older map that ``pair`` shows again, which then is the current one."""
        for k in range(self._current - 1, -1, -1):
            pose = self._maps[k].process(pair)
            if pose is not None:
                self._current, self._lost = k, 0
                return PlacedPose(k, pose)
        return None

    def _begin_map(self, pair: StereoPair) -> PlacedPose | None:
        """The first pose of a new map, if the pair suffices for one."""
        fresh = StereoOdometry(self._camera, self._settings, offset=self.offset)
        pose = fresh.process(pair)
        if pose is None:
            return None
        self._maps.append(fresh)
        self.joints.append(None)
        self._current, self._lost, self._since_search = len(self._maps) - 1, 0, 0
        return PlacedPose(self._current, pose)
