"""The shipped eyes over the world's frames: the same classes as in the service, with a clock that steps."""

from collections.abc import Callable
from typing import Any

from testbed.lockstep.frames import PixelFrames, Sight
from testbed.lockstep.world import World
from vision_pc.application.camera_eyes import CameraEyes
from vision_pc.application.eyes import FrameEyes
from vision_pc.application.ports import Runtime
from vision_pc.core.types import CameraFrame, FrameObservation, Look, WatchHealth

SightMaker = Callable[[World], Sight]


class RunRecord:
    """Implements ``vision_pc.application.ports.EyesRecord``: looks and watches in the run's log."""

    def __init__(self, world: World) -> None:
        self._world = world

    def pictured(self, frame: CameraFrame, observation: FrameObservation) -> None:
        """Do nothing: pictures are kept by those who ask for them."""

    def looked(self, look: Look) -> None:
        """Write what was seen."""
        self._world.log.add(self._world.time_ns, "look", X_CM=look.X_CM, X_CO=look.X_CO, frames=look.frames)

    def watched(self, health: WatchHealth) -> None:
        """Write what the watch missed."""
        self._world.log.add(self._world.time_ns, "watch", health=health)


def camera_eyes(world: World) -> CameraEyes:
    """Eyes on rendered pictures."""
    runtime = Runtime(world.clock, world.clock, world.clock)
    return CameraEyes(PixelFrames(world), world.link, world.settings.vision, runtime, RunRecord(world))


def eyes_with(world: World, sight: Sight) -> FrameEyes[Any]:
    """Eyes that look with ``sight``."""
    runtime = Runtime(world.clock, world.clock, world.clock)
    look = world.settings.vision.look
    return FrameEyes(sight.frames, sight.sensor, world.link, look, runtime, RunRecord(world))
