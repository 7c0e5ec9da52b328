"""Frames of the emulated camera as vision gets them: rendered while somebody waits for one."""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple, TypeVar

from plant_emulator.core.camera.camera_motion import Capture
from testbed.lockstep.camera_side import Exposure
from testbed.lockstep.world import VISION_CLOCK_NS, World
from vision_pc.application.camera_feed import CameraFeed
from vision_pc.application.ports import CameraStatus, FrameSource
from vision_pc.core.perception.frozen_pictures import FrozenPictures
from vision_pc.core.perception.watch import Sensor
from vision_pc.core.types import CameraFrame, StereoPair

F = TypeVar("F", bound=CameraFrame)


class Sight(NamedTuple):
    """What eyes look with: a source of frames, and a sensor that measures in them."""

    frames: FrameSource[Any]
    sensor: Sensor[Any]


class LockstepFrames(CameraFeed[F], ABC):
    """Vision's feed, filled from the world's exposures; in lockstep a frame arrives when it is sent."""

    def __init__(self, world: World) -> None:
        super().__init__(world.settings.vision.camera, world.clock)
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
    """Rendered stereo pairs."""

    def __init__(self, world: World) -> None:
        super().__init__(world)
        self._pictures = FrozenPictures(world.settings.vision.camera.frozen_frames)

    def exposed(self, exposure: Exposure) -> None:
        """Render and publish the pair of ``exposure``."""
        if exposure.shot.delivered:
            header, left, right = self._world.camera.photograph(exposure)
            pair = StereoPair(left, right, header.capture_ns + VISION_CLOCK_NS, header.frame_id)
            self.publish(pair, frozen=self._pictures.add(left))


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
