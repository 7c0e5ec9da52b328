"""The paper's own eyes for markers: OpenCV's detector and monocular poses from the left lens alone.

Mäkinen et al. 2023, 4.1: "ArUco marker detection and pose estimation were realized using OpenCV functions,
which employ monocular methods"; one marker of three is enough for the object. OpenCV's defaults are taken (no
corner refinement, its iterative pose). Odometry stays ours, in place of ORB-SLAM2; the right picture is
rendered for it alone, and markers are searched where they were, both to save time.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import cv2
import numpy as np

from plant_emulator.core.camera.stereo_camera import LEFT, RIGHT
from testbed.lockstep.camera_side import Exposure
from testbed.lockstep.frames import LockstepFrames, Sight
from testbed.lockstep.world import VISION_CLOCK_NS, World
from vision_pc.config.vision import MarkerSettings, VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry import StereoOdometry
from vision_pc.core.perception import intrinsics
from vision_pc.core.perception.markers import corner_points
from vision_pc.core.perception.object_of_interest import marker_in_object
from vision_pc.core.pixel_sensor import PixelSensor
from vision_pc.core.se3 import Array
from vision_pc.core.types import (
    CameraErrors,
    FrameObservation,
    Image,
    OdometryPose,
    StereoPair,
    WatchSample,
)

_COVARIANCE = np.diag([0.005**2] * 3 + [0.02**2] * 3)  # the same for every pose: frames are averaged evenly
_NO_BIAS = np.zeros((6, 6))


class OpencvFrame(NamedTuple):
    """A ``CameraFrame`` whose left picture is rendered at once, its right one when odometry asks for it."""

    left: Image
    right: Callable[[], Image]
    capture_ns: int
    frame_id: int


class OpencvFrames(LockstepFrames[OpencvFrame]):
    """The left eye's pictures."""

    def exposed(self, exposure: Exposure) -> None:
        """Render and publish the left picture of ``exposure``."""
        shot, renderer = exposure.shot, self._world.camera.renderer
        if shot.delivered:
            left = renderer.take_eye(LEFT, shot)
            right = partial(renderer.take_eye, RIGHT, shot)
            self.publish(OpencvFrame(left, right, shot.capture_ns + VISION_CLOCK_NS, shot.frame_id))


def opencv_sight(world: World) -> Sight:
    """The paper's eyes on ``world``."""
    return Sight(OpencvFrames(world), OpencvSensor(world.settings.vision))


class OpencvSensor:
    """Implements ``vision_pc.core.perception.watch.Sensor`` as the paper measured, but for odometry."""

    def __init__(self, config: VisionConfig) -> None:
        self._pixels = PixelSensor(config)
        self._config = config
        self._around: Array | None = None  # corners (n, 2) of the last picture that showed every marker

    def observe(self, frame: OpencvFrame, _previous: FrameObservation | None) -> FrameObservation:
        """Tool and object from the left picture: each marker by itself, the object's markers averaged."""
        settings = self._config.markers
        poses = self._poses(frame, settings)
        tool = poses.pop(settings.tool.id, None)
        targets = [X_CA @ np.linalg.inv(marker_in_object(number, settings)) for number, X_CA in poses.items()]
        target = _mean_pose(targets) if targets else None
        return FrameObservation(
            capture_ns=frame.capture_ns,
            frame_id=frame.frame_id,
            X_CM=tool,
            cov_CM=_COVARIANCE,
            bias_CM=_NO_BIAS,
            X_CO=target,
            cov_CO=_COVARIANCE,
            bias_CO=_NO_BIAS,
            markers=(),
            rejected={},
            offset=None,
        )

    def odometry(self, previous: FrameObservation | None) -> "OpencvOdometry":
        """Vision's own odometry; these markers tell of no offset."""
        return OpencvOdometry(self._pixels.odometry(previous))

    def errors(self, _samples: Sequence[WatchSample]) -> CameraErrors | None:
        """These markers tell nothing of the camera."""
        return None

    def _poses(self, frame: OpencvFrame, settings: MarkerSettings) -> dict[int, Array]:
        """X_CA of every known marker that OpenCV finds."""
        found = self._found(frame, settings)
        self._around = np.concatenate(list(found.values())) if len(found) == len(settings.sizes) else None
        poses = {}
        for number, corners in found.items():
            rays = intrinsics.normalised(self._pixels.camera.left, corners)
            _, turn, place = cv2.solvePnP(corner_points(settings.sizes[number]), rays, np.eye(3), np.zeros(5))
            poses[number] = se3.transform(se3.exp_so3(turn.ravel()), place.ravel())
        return poses

    def _found(self, frame: OpencvFrame, settings: MarkerSettings) -> dict[int, Array]:
        """Corners (4, 2) px of known markers: around where all were last, anywhere if not all are there."""
        if self._around is not None:
            low = np.maximum(self._around.min(axis=0).astype(int) - settings.region_margin_px, 0)
            high = self._around.max(axis=0).astype(int) + settings.region_margin_px
            corners = _detected(frame.left[low[1] : high[1], low[0] : high[0]], settings)
            if len(corners) == len(settings.sizes):
                return {number: quad + low for number, quad in corners.items()}
        return _detected(frame.left, settings)


class OpencvOdometry:
    """Vision's odometry over frames whose right picture is still to be rendered."""

    def __init__(self, odometry: StereoOdometry) -> None:
        self._odometry = odometry

    @property
    def last_loss(self) -> str | None:
        """Why the last frame was lost, None if it was not."""
        return self._odometry.last_loss

    def process(
        self, frame: OpencvFrame, X_CM: Array | None = None, X_BT: Array | None = None
    ) -> OdometryPose | None:
        """The camera's pose at ``frame``, None when it is lost."""
        pair = StereoPair(frame.left, frame.right(), frame.capture_ns, frame.frame_id)
        return self._odometry.process(pair, X_CM, X_BT)


def _detected(image: Image, settings: MarkerSettings) -> dict[int, Array]:
    found, ids, _ = _detector(settings.dictionary).detectMarkers(np.ascontiguousarray(image))
    if ids is None:
        return {}
    return {
        int(number): quad.reshape(4, 2).astype(np.float64)
        for number, quad in zip(ids.ravel(), found, strict=True)
        if int(number) in settings.sizes
    }


@lru_cache(maxsize=2)
def _detector(dictionary: str) -> cv2.aruco.ArucoDetector:
    return cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)))


def _mean_pose(poses: list[Array]) -> Array:
    """The mean of poses that lie close together."""
    first = poses[0]
    return se3.retract(first, np.mean([se3.local(first, X) for X in poses], axis=0))
