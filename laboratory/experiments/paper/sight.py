"""What a measured run is seen with: markers by OpenCV alone, and where each error arises."""

import io
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from functools import lru_cache, partial
from typing import Any, NamedTuple

import cv2
import numpy as np

from plant_emulator.core.camera.stereo_camera import LEFT, RIGHT
from testbed.lockstep.camera_side import Exposure
from testbed.lockstep.simulated_measurements import LockstepFrames, Sight
from testbed.lockstep.world import VISION_CLOCK_NS, World
from vision_pc.config.vision import MarkerSettings, VisionConfig
from vision_pc.core import se3
from vision_pc.core.calibration.line_equation import LineEquation
from vision_pc.core.calibration.local_calibration import LocalCalibration
from vision_pc.core.calibration.orientation import orientation_error
from vision_pc.core.odometry import StereoOdometry
from vision_pc.core.perception import intrinsics
from vision_pc.core.perception.markers import corner_points
from vision_pc.core.perception.object_of_interest import marker_in_object
from vision_pc.core.pixel_sensor import PixelSensor
from vision_pc.core.ports import Arm, ArmView, Eyes, ReferenceStream, Watch
from vision_pc.core.se3 import Array
from vision_pc.core.types import (
    CameraErrors,
    FrameObservation,
    Image,
    Look,
    OdometryPose,
    StereoPair,
    WatchSample,
)


class Traced(NamedTuple):
    """What the range adjustment of a measurement found."""

    line: LineEquation | None = None
    match: LocalCalibration | None = None


class Input(NamedTuple):
    """A reference that was given at ``time_ns``: its corners (n, 3) in B."""

    time_ns: int
    corners: Array


class Tracer:
    """Notes what arm and eyes are asked and what the camera saw meanwhile."""

    def __init__(self) -> None:
        self.samples: list[WatchSample] = []
        self.path: tuple[WatchSample, ...] = ()
        self.inputs: list[Input] = []
        self.looks: list[Look] = []
        self.result: Traced | None = None

    def over(self, arm: Arm, eyes: Eyes) -> tuple[Arm, Eyes]:
        """Arm and eyes that do the same and tell this tracer."""
        traced = _TracedEyes(eyes, self)
        return _TracedArm(arm, traced, self), traced

    def as_npz(self, world: World) -> bytes:
        """Everything as arrays: times in s of the simulation, places in m, angles in degrees, NaN unseen."""
        nothing = np.full(3, np.nan)

        def error(sample: WatchSample) -> Array:
            if sample.X_CM is None or sample.X_CO is None:
                return nothing
            return sample.X_CO[:3, 3] - sample.X_CM[:3, 3]

        def turn(sample: Any) -> Array:
            return nothing if sample.X_CM is None or sample.X_CO is None else orientation_error(sample)

        held = [s for s in self.path if s.X_C0C is not None]
        arrays: dict[str, Any] = {
            "time_s": [_seconds(s.time_ns) for s in self.samples],
            "p_BT": [s.X_BT[:3, 3] for s in self.samples],
            "error_m": [error(s) for s in self.samples],
            "turn_deg": [np.degrees(turn(s)) for s in self.samples],
            "look_s": [_seconds(look.time_ns) for look in self.looks],
            "look_error_m": [look.X_CO[:3, 3] - look.X_CM[:3, 3] for look in self.looks],
            "look_turn_deg": [np.degrees(turn(look)) for look in self.looks],
            "input_s": [_seconds(given.time_ns) for given in self.inputs],
            "path_p_BT": [s.X_BT[:3, 3] for s in held or self.path],
            "path_p_C0C": [s.X_C0C[:3, 3] for s in held if s.X_C0C is not None],
            "true_s": [1e-9 * truth.time_ns for truth in world.truths[::5]],
            "true_p_WT": [truth.X_WT[:3, 3] for truth in world.truths[::5]],
        }
        for number, given in enumerate(self.inputs):
            arrays[f"corners_{number}"] = given.corners
        if self.result is not None and self.result.match is not None:
            arrays["R_BC"] = self.result.match.R_BC
        file = io.BytesIO()
        saved: dict[str, Any] = {name: np.asarray(value, dtype=float) for name, value in arrays.items()}
        np.savez_compressed(file, **saved)
        return file.getvalue()


def _seconds(vision_ns: int) -> float:
    return 1e-9 * (vision_ns - VISION_CLOCK_NS)


class _TracedEyes:
    """Implements ``Eyes``."""

    def __init__(self, eyes: Eyes, tracer: Tracer) -> None:
        self._eyes = eyes
        self._tracer = tracer

    async def look(self, frames: int | None = None) -> Look:
        look = await self._eyes.look(frames)
        self._tracer.looks.append(look)
        return look

    @asynccontextmanager
    async def watch(self, *, markers: bool, odometry: bool) -> AsyncIterator[Watch]:
        async with self._eyes.watch(markers=True, odometry=odometry) as watch:
            yield watch
        self._tracer.samples += watch.samples
        self._tracer.path = watch.samples


class _TracedArm:
    """Implements ``Arm``: a motion that no program watches is watched for the tracer."""

    def __init__(self, arm: Arm, eyes: _TracedEyes, tracer: Tracer) -> None:
        self._arm = arm
        self._eyes = eyes
        self._tracer = tracer

    async def view(self) -> ArmView:
        return await self._arm.view()

    async def move_to(self, X_BT_ref: Array, duration_s: float = 0.0) -> ArmView:
        view = await self._arm.view()
        self._tracer.inputs.append(Input(view.time_ns, np.array([view.X_BT[:3, 3], X_BT_ref[:3, 3]])))
        path = self._tracer.path
        async with self._eyes.watch(markers=True, odometry=False):
            arrived = await self._arm.move_to(X_BT_ref, duration_s)
        self._tracer.path = path
        return arrived

    async def follow(
        self, waypoints: Sequence[Array], segment_s: float = 0.0, dwell_s: float = 0.0
    ) -> ArmView:
        view = await self._arm.view()
        corners = np.array([view.X_BT[:3, 3], *(X[:3, 3] for X in waypoints)])
        self._tracer.inputs.append(Input(view.time_ns, corners))
        return await self._arm.follow(waypoints, segment_s, dwell_s)

    def streaming(self) -> AbstractAsyncContextManager[ReferenceStream]:
        return self._arm.streaming()

    async def stop(self) -> None:
        await self._arm.stop()


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
        return OpencvOdometry(self._pixels.own_odometry(previous))

    def errors(self, _samples: Sequence[WatchSample]) -> CameraErrors | None:
        """These markers tell nothing of the camera."""
        return None

    def _poses(self, frame: OpencvFrame, settings: MarkerSettings) -> dict[int, Array]:
        """X_CA of every known marker that OpenCV finds."""
        found = self._marker_corners(frame, settings)
        self._around = np.concatenate(list(found.values())) if len(found) == len(settings.sizes) else None
        poses = {}
        for number, corners in found.items():
            rays = intrinsics.normalised(self._pixels.camera.left, corners)
            _, turn, place = cv2.solvePnP(corner_points(settings.sizes[number]), rays, np.eye(3), np.zeros(5))
            poses[number] = se3.transform(se3.exp_so3(turn.ravel()), place.ravel())
        return poses

    def _marker_corners(self, frame: OpencvFrame, settings: MarkerSettings) -> dict[int, Array]:
        """Corners (4, 2) px of known markers: around where all were last, anywhere if not all are there."""
        if self._around is not None:
            low = np.maximum(self._around.min(axis=0).astype(int) - settings.region_margin_px, 0)
            high = self._around.max(axis=0).astype(int) + settings.region_margin_px
            corners = _detect_markers(frame.left[low[1] : high[1], low[0] : high[0]], settings)
            if len(corners) == len(settings.sizes):
                return {number: quad + low for number, quad in corners.items()}
        return _detect_markers(frame.left, settings)


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


def _detect_markers(image: Image, settings: MarkerSettings) -> dict[int, Array]:
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
