"""Samples along a motion: markers and odometry of every frame, beside where the arm said it was."""

from collections import deque
from collections.abc import Sequence
from typing import Generic, Protocol, TypeVar

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.core.perception import look
from vision_pc.core.se3 import Array, local
from vision_pc.core.types import (
    CameraErrors,
    CameraFrame,
    FrameObservation,
    OdometryPose,
    WatchHealth,
    WatchSample,
)

AT_REST = 7  # the last samples of a watch, after the motion has settled
_STANDS = 1e-3  # [E] m, rad: an arm that moved less since the last measured frame stands
_MASK_EVERY = 10  # frames between looks at the tool marker when markers are not wanted for themselves

F = TypeVar("F", bound=CameraFrame)
F_contra = TypeVar("F_contra", bound=CameraFrame, contravariant=True)


class Odometry(Protocol[F_contra]):
    """Where the camera is in its first frame, frame by frame; ``StereoOdometry`` finds it in pictures."""

    @property
    def last_loss(self) -> str | None: ...
    def process(
        self, frame: F_contra, X_CM: Array | None = None, X_BT: Array | None = None, /
    ) -> OdometryPose | None: ...


class Sensor(Protocol[F_contra]):
    """What can be measured in the frames of one source; ``PixelSensor`` measures in pictures."""

    def observe(self, frame: F_contra, previous: FrameObservation | None, /) -> FrameObservation:
        """Tool and object of interest in ``frame``, after ``previous``."""
        ...

    def odometry(self, previous: FrameObservation | None, /) -> Odometry[F_contra]:
        """Odometry whose first frame is C0, for a camera as off its calibration as ``previous`` has it."""
        ...

    def errors(self, samples: Sequence[WatchSample], /) -> CameraErrors | None:
        """What the samples of a watch of markers and odometry say of the camera; None where too little."""
        ...


class Watcher(Generic[F]):
    """Gathers a ``WatchSample`` from every frame given to it; while the arm stands, from the newest alone.

    Those are measured when it goes on and when the watch ends; at once when the watch is ``live``.

    ``previous``: the newest observation before the watch; what it knows of the right eye's offset and of
    where the markers are is carried on. Without one the first frame is searched. The first tracked camera
    frame is C0. ``newest``: the frame in which markers were searched last, and what was found, for whoever
    looks next. ``object_wanted``: where markers are, ``require`` asks for the object's as well.
    """

    def __init__(
        self, sensor: Sensor[F], *, markers: bool, odometry: bool, previous: FrameObservation | None = None
    ) -> None:
        self._sensor = sensor
        self._markers = markers
        self._wants_odometry = odometry
        self._observation = previous
        self.newest: tuple[F, FrameObservation] | None = None
        self._resting: deque[tuple[F, Array]] = deque(maxlen=AT_REST)
        self.live = False
        self._odometry: Odometry[F] | None = None
        self._samples: list[WatchSample] = []
        self._inliers: list[int] = []
        self._missing: dict[str, list[str | None]] = {"tool": [], "object": []}
        self._last_loss: str | None = None
        self.object_wanted = True

    def add(self, frame: F, X_BT: Array) -> None:
        """Take ``frame``; ``X_BT`` is the controller's at its capture."""
        stands = self._samples and np.abs(local(self._samples[-1].X_BT, X_BT)).max() < _STANDS
        self._resting.append((frame, X_BT))
        if self.live or not stands:
            self.measure()

    def measure(self) -> None:
        """Measure in the frames that were taken and not measured yet."""
        while self._resting:
            self._sample(*self._resting.popleft())

    def _sample(self, frame: F, X_BT: Array) -> None:
        observation = self._observed(frame)
        tracked = self._track(frame, observation, X_BT) if self._wants_odometry else None
        seen = observation if self._markers else None
        sample = WatchSample(
            frame.capture_ns,
            X_BT,
            None if tracked is None else tracked.X_C0C,
            None if seen is None else seen.X_CM,
            None if seen is None else seen.X_CO,
            seen,
            None if seen is None or tracked is None else tracked.pairs,
        )
        self._samples.append(sample)
        if seen is not None:
            for what, X, reason in (
                ("tool", seen.X_CM, seen.missing_tool),
                ("object", seen.X_CO, seen.missing_object),
            ):
                self._missing[what].append(None if X is not None else reason or "not_seen")

    def _observed(self, frame: F) -> FrameObservation | None:
        """Markers of this frame, where they are wanted or the odometry needs them."""
        due = self._wants_odometry and len(self._samples) % _MASK_EVERY == 0
        if not (self._markers or due):
            return None
        observation = self._sensor.observe(frame, self._observation)
        self._observation, self.newest = observation, (frame, observation)
        return observation

    def _track(self, frame: F, observation: FrameObservation | None, X_BT: Array) -> OdometryPose | None:
        if self._odometry is None:
            self._odometry = self._sensor.odometry(self._observation)
        tracked = self._odometry.process(frame, None if observation is None else observation.X_CM, X_BT)
        if tracked is None:
            self._last_loss = self._odometry.last_loss
        else:
            self._inliers.append(tracked.inliers)
        return tracked

    @property
    def count(self) -> int:
        """How many samples there are."""
        return len(self._samples)

    @property
    def samples(self) -> tuple[WatchSample, ...]:
        """One sample for every frame so far, in order."""
        return tuple(self._samples)

    def calibrate(self) -> None:
        """Find the camera's errors from all samples: the newest observation and sample then know them."""
        errors = self._sensor.errors(self._samples)
        if errors is not None and self.newest is not None:
            frame, observation = self.newest
            self._observation = observation._replace(errors=errors, offset=errors.offset)
            self.newest = frame, self._observation
            self._samples[-1] = self._samples[-1]._replace(observation=self._observation)

    @property
    def health(self) -> WatchHealth:
        """What was missed so far."""
        frames = len(self._samples)
        tracked = len(self._inliers)
        return WatchHealth(
            frames=frames,
            odometry_lost=frames - tracked if self._wants_odometry else 0,
            tool_missed=sum(s.X_CM is None for s in self._samples) if self._markers else 0,
            object_missed=sum(s.X_CO is None for s in self._samples) if self._markers else 0,
            median_inliers=int(np.median(self._inliers)) if self._inliers else 0,
            last_loss=self._last_loss,
            offset=None if self._observation is None else self._observation.offset,
        )

    def require(self) -> None:
        """Raise MeasurementFailed when no pair came, when something wanted was not measured at all, or when
        its markers were of the wrong size more often than not.

        Causes: ``measurement.no_frames``, ``measurement.odometry_lost``, ``measurement.tool_not_seen``,
        ``measurement.object_not_seen`` (``…_wrong_size``, ``…_ambiguous``).
        """
        health = self.health
        if health.frames == 0:
            raise MeasurementFailed("measurement.no_frames", "watch: 0 frames arrived, at least 1 is wanted")
        if self._wants_odometry and health.odometry_lost == health.frames:
            raise MeasurementFailed(
                "measurement.odometry_lost",
                f"watch: odometry lost in all {health.frames} frames, last cause {health.last_loss}",
            )
        for what, missing in self._missing.items():
            seen = missing.count(None)
            if what == "object" and not self.object_wanted:
                continue
            if self._markers and seen <= missing.count("wrong_size"):
                raise MeasurementFailed(
                    f"measurement.{what}_{look.usual_reason(missing)}",
                    f"watch: {what} seen in {seen} of {health.frames} frames",
                )
