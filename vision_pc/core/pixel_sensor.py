"""What can be measured in a stereo pair: markers, and where the camera went."""

from collections.abc import Sequence

from vision_pc.config.vision import VisionConfig
from vision_pc.core.odometry import StereoOdometry
from vision_pc.core.odometry.foreign_poses import ForeignOdometry, PoseFeed
from vision_pc.core.perception import intrinsics, look
from vision_pc.core.perception.camera_errors import fitted_errors
from vision_pc.core.perception.intrinsics import as_believed, as_found
from vision_pc.core.perception.watch import Odometry
from vision_pc.core.types import CameraErrors, FrameObservation, Image, StereoPair, WatchSample


class PixelSensor:
    """Implements ``vision_pc.core.perception.watch.Sensor`` in pictures; with a ``feed`` odometry is its."""

    def __init__(self, config: VisionConfig, feed: PoseFeed | None = None) -> None:
        self._feed = feed
        self.camera = intrinsics.calibration(config.camera)
        self._config = config

    def observe(self, frame: StereoPair, previous: FrameObservation | None) -> FrameObservation:
        """Tool and object of interest in this pair."""
        return look.observe(frame, as_found(self.camera, previous), self._config.markers, previous)

    def odometry(self, previous: FrameObservation | None) -> Odometry[StereoPair]:
        """Odometry whose first camera frame is C0, for a camera as ``previous`` has it."""
        if self._feed is not None:
            return ForeignOdometry(self._feed, self._config.odometry_feed)
        return self.own_odometry(previous)

    def own_odometry(self, previous: FrameObservation | None) -> StereoOdometry:
        """The same from the pictures themselves, whatever feed there is."""
        return StereoOdometry(
            as_believed(self.camera, previous), self._config.odometry, self._config.markers.tool
        )

    def errors(self, samples: Sequence[WatchSample]) -> CameraErrors | None:
        """What the samples of a watch say of the camera."""
        return fitted_errors(samples, self.camera, self._config.markers)


_STEP = 32  # px: a picture is compared by every such pixel of every such row


class FrozenPictures:
    """Counts how often a picture repeated the one before to the last grey level, which noise forbids in live
    ones. ``limit``: so many repetitions, and the camera counts as frozen; 0: never.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._fingerprint = b""
        self._count = 0

    def add(self, image: Image) -> bool:
        """Take the newest picture. Return True if the camera is frozen."""
        fingerprint = image[::_STEP, ::_STEP].tobytes()
        self._count = self._count + 1 if fingerprint == self._fingerprint else 0
        self._fingerprint = fingerprint
        return 0 < self._limit <= self._count
