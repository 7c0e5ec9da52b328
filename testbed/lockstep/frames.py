"""Frames of the emulated camera as vision gets them: rendered while somebody waits for one."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple, TypeVar

from plant_emulator.core.camera.exposures import Capture
from protocol.errors import ConfigurationError
from testbed.lockstep.camera_side import Exposure
from testbed.lockstep.world import VISION_CLOCK_NS, World
from vision_pc.application.camera_feed import CameraFeed
from vision_pc.application.ports import CameraStatus, FrameSource
from vision_pc.config.stereo_camera import StereoCalibration
from vision_pc.core.perception.frozen_pictures import FrozenPictures
from vision_pc.core.perception.rectification import Rectifier
from vision_pc.core.perception.watch import Sensor
from vision_pc.core.types import CameraFrame, StereoPair

F = TypeVar("F", bound=CameraFrame)


class Sight(NamedTuple):
    """What eyes look with: a source of frames, and a sensor that measures in them."""

    frames: FrameSource[Any]
    sensor: Sensor[Any]


class LockstepFrames(CameraFeed[F], ABC):
    """Vision's feed, filled from the world's exposures; in lockstep a frame arrives when it is sent."""

    rectifies: ClassVar[bool] = False

    def __init__(self, world: World) -> None:
        """Raise ConfigurationError where frames that nobody rectifies meet a raw camera's calibration."""
        camera = world.settings.vision.camera
        if isinstance(camera.calibration, StereoCalibration) and not self.rectifies:
            raise ConfigurationError(
                "configuration.raw_camera",
                f"vision.camera.calibration: {camera.calibration.source}: these eyes take no raw pairs, "
                "rendered pictures do (--eyes pixels)",
            )
        super().__init__(camera, world.clock)
        self._world = world
        self.connected()

    async def frame_after(self, capture_ns: int) -> F:
        """The port's, while which every exposure is taken."""
        viewers = self._world.camera.viewers
        viewers.append(self.exposed)
        try:
            return await super().frame_after(capture_ns)
        finally:
            viewers.remove(self.exposed)

    def status(self) -> CameraStatus:
        """The camera is always there, although it is only asked for frames while somebody looks."""
        return CameraStatus(True, 0.0, self._frames, self._world.settings.scene.camera.rate_hz)

    @abstractmethod
    def exposed(self, exposure: Exposure) -> None:
        """Publish the frame of ``exposure``, if it is delivered."""


class PixelFrames(LockstepFrames[StereoPair]):
    """Rendered stereo pairs, rectified where vision's calibration is a raw camera's."""

    rectifies = True

    def __init__(self, world: World) -> None:
        super().__init__(world)
        settings = world.settings.vision.camera
        told = settings.calibration
        self._rectified = Rectifier(told) if isinstance(told, StereoCalibration) else None
        self._pictures = FrozenPictures(settings.frozen_frames)

    def exposed(self, exposure: Exposure) -> None:
        """Render and publish the pair of ``exposure``."""
        if exposure.shot.delivered:
            header, left, right = self._world.camera.photograph(exposure)
            pair = StereoPair(left, right, header.capture_ns + VISION_CLOCK_NS, header.frame_id)
            frozen = self._pictures.add(left)
            self.publish(self._rectified(pair) if self._rectified else pair, frozen=frozen)


class SimulatedFrame(NamedTuple):
    """A ``CameraFrame`` without pixels, for a sensor that simulates: ``shown`` is what it would show."""

    shown: Capture
    capture_ns: int
    frame_id: int


class SimulatedFrames(LockstepFrames[SimulatedFrame]):
    """Frames that carry what they would show in place of pictures."""

    def exposed(self, exposure: Exposure) -> None:
        """Publish what ``exposure`` shows, under its stamps."""
        shot = exposure.shot
        if shot.delivered:
            self.publish(SimulatedFrame(shot.shown, shot.capture_ns + VISION_CLOCK_NS, shot.frame_id))
