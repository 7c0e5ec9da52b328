"""The paper's own eyes for markers: OpenCV's detector and monocular poses from the left lens alone.

Mäkinen et al. 2023, 4.1: "ArUco marker detection and pose estimation were realized using OpenCV functions,
which employ monocular methods"; one marker of three is enough for the object. OpenCV's defaults are taken (no
corner refinement, its iterative pose). Odometry stays ours, in place of ORB-SLAM2; the right picture is
rendered for it alone, and markers are searched where they were, both to save time.
"""

from functools import lru_cache

import cv2
import numpy as np

from plant_emulator.core.camera.camera_motion import CameraView
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import LEFT, StereoCamera
from plant_emulator.core.truth import PlantTruth
from testbed.lockstep.sight import Deliver, PixelSight
from testbed.lockstep.world import VISION_CLOCK_NS, World
from vision_pc.config.vision import MarkerSettings, VisionConfig
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.perception.markers import corner_points
from vision_pc.core.perception.object_of_interest import marker_in_object
from vision_pc.core.perception.watch import Watcher
from vision_pc.core.se3 import Array
from vision_pc.core.types import FrameObservation, Image, StereoPair

_COVARIANCE = np.diag([0.005**2] * 3 + [0.02**2] * 3)  # the same for every pose: frames are averaged evenly
_NO_BIAS = np.zeros((6, 6))
_NO_PICTURE = np.zeros((0, 0), dtype=np.uint8)


class OpencvSight(PixelSight):
    """Implements ``testbed.lockstep.sight.Sight`` over rendered pictures, as the paper measured them."""

    def __init__(self, world: World, config: VisionConfig) -> None:
        super().__init__(world, config)
        scene = world.settings.scene
        self._eye = StereoCamera(scene.camera, Scene(scene), scene.seed)
        self._both = False
        self._around: Array | None = None  # corners (n, 2) of the last picture that showed every marker

    def begin(self, deliver: Deliver) -> None:
        """Start to render pictures: the left eye's alone unless odometry waits."""
        if self._both:
            super().begin(deliver)
            return

        def exposed(number: int, truth: PlantTruth) -> None:
            left = self._eye.render_eye(LEFT, CameraView(truth.X_WC, truth.X_WM), number)
            deliver(StereoPair(left, _NO_PICTURE, truth.time_ns + VISION_CLOCK_NS, number))

        self._world.on_exposure = exposed

    def end(self) -> None:
        """Stop rendering pictures."""
        super().end()
        self._world.on_exposure = None
        self._both = False

    def observe(self, pair: StereoPair, previous: FrameObservation | None) -> FrameObservation:
        """Tool and object from the left picture: each marker by itself, the object's markers averaged."""
        settings = self._config.markers
        poses = self._poses(pair, settings)
        tool = poses.pop(settings.tool.id, None)
        targets = [X_CA @ np.linalg.inv(marker_in_object(number, settings)) for number, X_CA in poses.items()]
        target = _mean_pose(targets) if targets else None
        return FrameObservation(
            capture_ns=pair.capture_ns,
            frame_id=pair.frame_id,
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

    def watcher(self, *, markers: bool, odometry: bool, previous: FrameObservation | None) -> Watcher:
        """Vision's own watcher, with this sight's markers."""
        self._both = odometry
        return _OpencvWatcher(self, self._config, markers=markers, odometry=odometry)

    def _poses(self, pair: StereoPair, settings: MarkerSettings) -> dict[int, Array]:
        """X_CA of every known marker that OpenCV finds."""
        found = self._found(pair, settings)
        self._around = np.concatenate(list(found.values())) if len(found) == len(settings.sizes) else None
        poses = {}
        for number, corners in found.items():
            rays = intrinsics.normalised(self.camera.left, corners)
            _, turn, place = cv2.solvePnP(corner_points(settings.sizes[number]), rays, np.eye(3), np.zeros(5))
            poses[number] = se3.transform(se3.exp_so3(turn.ravel()), place.ravel())
        return poses

    def _found(self, pair: StereoPair, settings: MarkerSettings) -> dict[int, Array]:
        """Corners (4, 2) px of known markers: around where all were last, anywhere if not all are there."""
        if self._around is not None:
            low = np.maximum(self._around.min(axis=0).astype(int) - settings.region_margin_px, 0)
            high = self._around.max(axis=0).astype(int) + settings.region_margin_px
            corners = _detected(pair.left[low[1] : high[1], low[0] : high[0]], settings)
            if len(corners) == len(settings.sizes):
                return {number: quad + low for number, quad in corners.items()}
        return _detected(pair.left, settings)


class _OpencvWatcher(Watcher):
    def __init__(self, sight: OpencvSight, config: VisionConfig, *, markers: bool, odometry: bool) -> None:
        super().__init__(sight.camera, config, markers=markers, odometry=odometry)
        self._sight = sight

    def observe(self, pair: StereoPair, previous: FrameObservation | None) -> FrameObservation:
        return self._sight.observe(pair, previous)


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
