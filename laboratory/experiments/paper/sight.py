"""What a measured run is seen with: markers by OpenCV alone, and where each error arises."""

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from protocol.errors import MeasurementFailed
from testbed.lockstep.world import VISION_CLOCK_NS
from vision_pc.application.link_arm import LinkArm
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.config.vision import MarkerSettings, MotionSettings, VisionConfig
from vision_pc.core import se3
from vision_pc.core.calibration.local_calibration import LocalCalibration
from vision_pc.core.calibration.orientation import orientation_error
from vision_pc.core.odometry import StereoOdometry
from vision_pc.core.perception import intrinsics
from vision_pc.core.perception.markers import corner_points
from vision_pc.core.perception.object_of_interest import marker_in_object
from vision_pc.core.pixel_sensor import PixelSensor
from vision_pc.core.ports import ArmView, Eyes, Watch
from vision_pc.core.se3 import Array
from vision_pc.core.types import (
    CameraErrors,
    FrameObservation,
    Image,
    Look,
    StereoPair,
    WatchSample,
)

_LOOKS = 5
_UNSEEN = ("measurement.tool_not_seen", "measurement.object_not_seen")


class RememberingEyes:
    """Implements ``Eyes``; remembers ``looks`` and ``samples``, whatever program took them.

    A look that shows no tool or no object is taken again, up to ``_LOOKS`` times, and counted in
    ``unseen``: the paper's inputs were given by hand (5.2.2), and nobody gives one on a failed sample.
    ``path``: the samples of the last watch of a program. ``traces``: every watch looks at the markers too.
    """

    def __init__(self, eyes: Eyes, *, traces: bool = False) -> None:
        self._eyes, self._traces = eyes, traces
        self.looks: list[Look] = []
        self.samples: list[WatchSample] = []
        self.path: tuple[WatchSample, ...] = ()
        self.unseen = 0

    async def look(self, frames: int | None = None) -> Look:
        """A look of the eyes. Raises MeasurementFailed when none of them shows tool and object."""
        for left in reversed(range(_LOOKS)):
            try:
                self.looks.append(await self._eyes.look(frames))
                break
            except MeasurementFailed as failed:
                if failed.cause not in _UNSEEN or not left:
                    raise
                self.unseen += 1
        return self.looks[-1]

    @asynccontextmanager
    async def watch(self, *, markers: bool, odometry: bool) -> AsyncIterator[Watch]:
        """A watch of the eyes."""
        async with self._eyes.watch(markers=markers or self._traces, odometry=odometry) as watch:
            yield watch
        self.samples += watch.samples
        self.path = watch.samples


class TracedArm(LinkArm):
    """Notes its ``inputs`` (time ns, corners (n, 3) in B), and watches every motion."""

    def __init__(self, link: ReferenceLink, settings: MotionSettings, eyes: RememberingEyes) -> None:
        super().__init__(link, settings)
        self._eyes = eyes
        self.inputs: list[tuple[int, Array]] = []

    async def move_to(self, X_BT_ref: Array, duration_s: float = 0.0) -> ArmView:
        """A motion of the arm, watched."""
        await self._note([X_BT_ref])
        path = self._eyes.path
        async with self._eyes.watch(markers=True, odometry=False):
            arrived = await super().move_to(X_BT_ref, duration_s)
        self._eyes.path = path
        return arrived

    async def follow(
        self, waypoints: Sequence[Array], segment_s: float = 0.0, dwell_s: float = 0.0
    ) -> ArmView:
        """A path of the arm."""
        await self._note(waypoints)
        return await super().follow(waypoints, segment_s, dwell_s)

    async def _note(self, waypoints: Sequence[Array]) -> None:
        view = await self.view()
        self.inputs.append((view.time_ns, np.array([X[:3, 3] for X in (view.X_BT, *waypoints)])))


def traced_arrays(arm: TracedArm, eyes: RememberingEyes, match: LocalCalibration | None) -> dict[str, Array]:
    """Everything as arrays: times in s of the simulation, places in m, angles in degrees, NaN unseen."""
    held = [s for s in eyes.path if s.X_C0C is not None]
    samples, looks = (
        np.array([_off(each) for each in seen]).reshape(-1, 2, 3) for seen in (eyes.samples, eyes.looks)
    )
    arrays: dict[str, Any] = {
        "time_s": [_seconds(s.time_ns) for s in eyes.samples],
        "p_BT": [s.X_BT[:3, 3] for s in eyes.samples],
        "error_m": samples[:, 0],
        "turn_deg": samples[:, 1],
        "look_s": [_seconds(look.time_ns) for look in eyes.looks],
        "look_error_m": looks[:, 0],
        "look_turn_deg": looks[:, 1],
        "input_s": [_seconds(time_ns) for time_ns, _ in arm.inputs],
        "path_p_BT": [s.X_BT[:3, 3] for s in held or eyes.path],
        "path_p_C0C": [s.X_C0C[:3, 3] for s in held if s.X_C0C is not None],
    }
    arrays |= {f"corners_{number}": corners for number, (_, corners) in enumerate(arm.inputs)}
    if match is not None:
        arrays["R_BC"] = match.R_BC
    return {name: np.asarray(value, dtype=np.float64) for name, value in arrays.items()}


def _off(seen: Any) -> Array:
    """From tool marker to object (2, 3), of a look or a sample: m in C axes, and Euler angles in degrees."""
    if seen.X_CM is None or seen.X_CO is None:
        return np.full((2, 3), np.nan)
    return np.array([seen.X_CO[:3, 3] - seen.X_CM[:3, 3], np.degrees(orientation_error(seen))])


def _seconds(vision_ns: int) -> float:
    return 1e-9 * (vision_ns - VISION_CLOCK_NS)


_COVARIANCE = np.diag([0.005**2] * 3 + [0.02**2] * 3)  # the same for every pose: frames are averaged evenly
_NO_BIAS = np.zeros((6, 6))


class OpencvSensor:
    """Implements ``vision_pc.core.perception.watch.Sensor`` as the paper measured, but for odometry."""

    def __init__(self, config: VisionConfig) -> None:
        self._pixels = PixelSensor(config)
        self._config = config
        self._around: Array | None = None  # corners (n, 2) of the last picture that showed every marker

    def observe(self, frame: StereoPair, _previous: FrameObservation | None) -> FrameObservation:
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

    def odometry(self, previous: FrameObservation | None) -> StereoOdometry:
        """Vision's own odometry; these markers tell of no offset."""
        return self._pixels.own_odometry(previous)

    def errors(self, _samples: Sequence[WatchSample]) -> CameraErrors | None:
        """These markers tell nothing of the camera."""
        return None

    def _poses(self, frame: StereoPair, settings: MarkerSettings) -> dict[int, Array]:
        """X_CA of every known marker that OpenCV finds."""
        found = self._marker_corners(frame, settings)
        self._around = np.concatenate(list(found.values())) if len(found) == len(settings.sizes) else None
        poses = {}
        for number, corners in found.items():
            rays = intrinsics.normalised(self._pixels.camera.left, corners)
            _, turn, place = cv2.solvePnP(corner_points(settings.sizes[number]), rays, np.eye(3), np.zeros(5))
            poses[number] = se3.transform(se3.exp_so3(turn.ravel()), place.ravel())
        return poses

    def _marker_corners(self, frame: StereoPair, settings: MarkerSettings) -> dict[int, Array]:
        """Corners (4, 2) px of known markers: around where all were last, anywhere if not all are there."""
        if self._around is not None:
            low = np.maximum(self._around.min(axis=0).astype(int) - settings.region_margin_px, 0)
            high = self._around.max(axis=0).astype(int) + settings.region_margin_px
            corners = _detect_markers(frame.left[low[1] : high[1], low[0] : high[0]], settings)
            if len(corners) == len(settings.sizes):
                return {number: quad + low for number, quad in corners.items()}
        return _detect_markers(frame.left, settings)


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
