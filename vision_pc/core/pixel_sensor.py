"""What can be measured in a stereo pair: markers, and where the camera went."""

from vision_pc.config.vision import VisionConfig
from vision_pc.core.odometry import StereoOdometry
from vision_pc.core.perception import intrinsics, look
from vision_pc.core.types import CameraCalibration, FrameObservation, StereoOffset, StereoPair


class PixelSensor:
    """Implements ``vision_pc.core.perception.watch.Sensor`` in pictures."""

    def __init__(self, config: VisionConfig) -> None:
        self.camera = intrinsics.calibration(config.camera)
        self._config = config

    def observe(self, frame: StereoPair, previous: FrameObservation | None) -> FrameObservation:
        """Tool and object of interest in this pair."""
        return look.observe(frame, self.camera, self._config.markers, previous)

    def odometry(self, offset: StereoOffset | None) -> StereoOdometry:
        """Odometry whose first camera frame is C0, for a right eye that is off by ``offset``."""
        return StereoOdometry(
            with_believed_offset(self.camera, offset), self._config.odometry, self._config.markers.tool
        )


def with_believed_offset(camera: CameraCalibration, offset: StereoOffset | None) -> CameraCalibration:
    """``camera`` with the offset of the right eye that the markers told, if they did."""
    return camera if offset is None else intrinsics.with_offset(camera, offset.x_px, offset.y_px)
