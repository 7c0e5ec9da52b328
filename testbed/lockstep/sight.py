"""Where lockstep's eyes get their frames: rendered pictures, or what stands in for them."""

from collections.abc import Callable
from typing import Protocol

from testbed.lockstep.world import VISION_CLOCK_NS, Frame, World
from vision_pc.config.vision import VisionConfig
from vision_pc.core.perception.intrinsics import calibration
from vision_pc.core.perception.look import observe
from vision_pc.core.perception.watch import Watcher
from vision_pc.core.types import FrameObservation, StereoPair

Deliver = Callable[[StereoPair], None]


class Sight(Protocol):
    """Frames at the camera's rate while somebody wants them, and what can be measured in them."""

    def begin(self, deliver: Deliver) -> None:
        """Start to hand every pair to ``deliver`` when it is exposed."""
        ...

    def end(self) -> None:
        """Stop handing on pairs."""
        ...

    def observe(self, pair: StereoPair, previous: FrameObservation | None) -> FrameObservation:
        """What ``pair`` shows of tool and object."""
        ...

    def watcher(self, *, markers: bool, odometry: bool, previous: FrameObservation | None) -> Watcher:
        """A new watcher of these frames."""
        ...


class PixelSight:
    """Implements ``Sight`` with rendered pictures and vision's own programs."""

    def __init__(self, world: World, config: VisionConfig) -> None:
        self._world = world
        self._config = config
        self.camera = calibration(config.camera)

    def begin(self, deliver: Deliver) -> None:
        """Start to render pictures."""
        self._world.on_frame = lambda frame: deliver(pair_of(frame))

    def end(self) -> None:
        """Stop rendering pictures."""
        self._world.on_frame = None

    def observe(self, pair: StereoPair, previous: FrameObservation | None) -> FrameObservation:
        """What the pictures show."""
        return observe(pair, self.camera, self._config.markers, previous)

    def watcher(self, *, markers: bool, odometry: bool, previous: FrameObservation | None) -> Watcher:
        """Vision's own watcher."""
        return Watcher(self.camera, self._config, markers=markers, odometry=odometry, previous=previous)


def pair_of(frame: Frame) -> StereoPair:
    """A frame as vision's programs see it, on vision's clock; in lockstep it arrives when it is sent."""
    return StereoPair(
        frame.left, frame.right, frame.header.capture_ns + VISION_CLOCK_NS, frame.header.frame_id
    )
