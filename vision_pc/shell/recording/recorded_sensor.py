"""A sensor that tells a recorder what it is asked and what it finds; the numbers are the sensor's own."""

from collections.abc import Sequence
from typing import Protocol

from vision_pc.core.perception.watch import Odometry, Sensor
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraErrors, FrameObservation, OdometryPose, StereoPair, WatchSample
from vision_pc.shell.recording.vision_messages import ToldWithFrame


class MeasurementRecord(Protocol):
    """Where measurements go; ``VisionRecorder`` writes them down."""

    def observed(
        self, pair: StereoPair, previous: FrameObservation | None, found: FrameObservation
    ) -> None: ...
    def odometry_begun(self, previous: FrameObservation | None) -> int: ...
    def tracked(
        self, odometry: int, pair: StereoPair, told: ToldWithFrame, found: OdometryPose | str
    ) -> None: ...
    def fitted(self, samples: Sequence[WatchSample], found: CameraErrors | None) -> None: ...


class RecordedSensor:
    """Implements ``vision_pc.core.perception.watch.Sensor`` over another one."""

    def __init__(self, sensor: Sensor[StereoPair], record: MeasurementRecord) -> None:
        self._sensor = sensor
        self._record = record

    def observe(self, frame: StereoPair, previous: FrameObservation | None, /) -> FrameObservation:
        """What the sensor sees."""
        found = self._sensor.observe(frame, previous)
        self._record.observed(frame, previous, found)
        return found

    def odometry(self, previous: FrameObservation | None, /) -> "RecordedOdometry":
        """The sensor's odometry, recorded too."""
        return RecordedOdometry(
            self._sensor.odometry(previous), self._record, self._record.odometry_begun(previous)
        )

    def errors(self, samples: Sequence[WatchSample], /) -> CameraErrors | None:
        """What the sensor makes of the samples."""
        found = self._sensor.errors(samples)
        self._record.fitted(samples, found)
        return found


class RecordedOdometry:
    """Implements ``vision_pc.core.perception.watch.Odometry`` over another one, the ``number``-th."""

    def __init__(self, odometry: Odometry[StereoPair], record: MeasurementRecord, number: int) -> None:
        self._odometry = odometry
        self._record = record
        self._number = number

    @property
    def last_loss(self) -> str | None:
        """Why the last frame was lost."""
        return self._odometry.last_loss

    def process(
        self, frame: StereoPair, X_CM: Array | None = None, X_BT: Array | None = None, /
    ) -> OdometryPose | None:
        """What the odometry makes of the frame."""
        found = self._odometry.process(frame, X_CM, X_BT)
        told = ToldWithFrame(X_CM is not None, X_BT)
        self._record.tracked(self._number, frame, told, found or self._odometry.last_loss or "lost")
        return found
