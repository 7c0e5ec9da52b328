"""Eyes in lockstep: pictures are rendered at the camera's rate, and only while somebody looks."""

from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TypeVar

import numpy as np

from protocol.errors import LinkLost, RequestRefused
from protocol.faults import GroupState
from testbed.lockstep.clock import run
from testbed.lockstep.sight import Deliver, PixelSight, Sight
from testbed.lockstep.world import World
from vision_pc.application.annotate import annotated, png
from vision_pc.application.ports import CameraStatus
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.config.vision import CameraSettings, VisionConfig
from vision_pc.core.perception.freshness import Repeats
from vision_pc.core.perception.look import combine
from vision_pc.core.perception.watch import Watcher
from vision_pc.core.ports import PairsAtRest, Watch
from vision_pc.core.types import FrameObservation, Look, StereoPair, WatchHealth, WatchSample

T = TypeVar("T")


class _Arrivals:
    """What the camera's source is to the real eyes: it hands on what is new and alive, and tells why nothing
    came for too long.
    """

    def __init__(self, world: World, camera: CameraSettings, repeats: Repeats, deliver: Deliver) -> None:
        self._world = world
        self._stale_ns = round(1e6 * camera.stale_ms)
        self._repeats = repeats
        self._deliver = deliver
        self._newest_ns = world.vision_ns
        self._lost: LinkLost | None = None

    def take(self, pair: StereoPair) -> None:
        """Hand on the new ``pair`` unless it is old, frozen, or comes too late."""
        self._judge()
        self._repeats.add(pair.left)
        if self._lost is None and not self._repeats.frozen and pair.capture_ns > self._newest_ns:
            self._newest_ns = pair.capture_ns
            self._deliver(pair)

    @property
    def live(self) -> bool:
        """Whether the newest picture is a new one, and came when one was due."""
        age_ns = self._world.vision_ns - self._newest_ns
        return self._repeats.count == 0 and age_ns <= 2 * self._world.frame_period_ns

    def require(self) -> None:
        """Raise LinkLost (``link.camera_silent``, ``.camera_frozen``) when nothing came for too long."""
        self._judge()
        if self._lost is not None:
            raise self._lost

    def _judge(self) -> None:
        age_ns = self._world.vision_ns - self._newest_ns
        if self._lost is None and age_ns > self._stale_ns:
            cause = "link.camera_frozen" if self._repeats.frozen else "link.camera_silent"
            why = f"newest picture is {1e-6 * age_ns:.0f} ms old, limit {1e-6 * self._stale_ns:g} ms"
            self._lost = LinkLost(cause, f"camera (lockstep): {why}")


class _LiveWatch:
    """Implements ``vision_pc.core.ports.Watch``: one comes once the arm's pose at its capture is known."""

    def __init__(self, watcher: Watcher, world: World, link: ReferenceLink) -> None:
        self.waiting: deque[StereoPair] = deque()
        self._watcher = watcher
        self._world = world
        self._link = link

    @property
    def samples(self) -> tuple[WatchSample, ...]:
        """One sample for every pair so far."""
        return self._watcher.samples

    @property
    def health(self) -> WatchHealth:
        """What was missed so far."""
        return self._watcher.health

    async def after(self, count: int, timeout_s: float) -> WatchSample | None:
        """The newest sample once there are more than ``count``; None after ``timeout_s``, simulated."""
        until_ns = self._world.time_ns + round(1e9 * timeout_s)
        while self._world.time_ns < until_ns:
            self._world.clock.advance()
            self._sampled()
            if self._watcher.count > count:
                return self._watcher.samples[-1]
        return None

    def arrived(self, pair: StereoPair) -> None:
        """Take a pair that was just exposed."""
        self.waiting.append(pair)
        self._sampled()

    @property
    def _known_ns(self) -> int:
        return self._link.local_time_ns(self._link.state.time_ns)

    def _sampled(self) -> None:
        while self.waiting and self._known_ns >= self.waiting[0].capture_ns:
            self._watcher.add(self.waiting[0], run(self._link.pose_at(self.waiting[0].capture_ns)))
            self.waiting.popleft()


class LockstepEyes:
    """Implements ``vision_pc.core.ports.Eyes`` by stepping the world, and the station's camera.

    ``sight`` says what is measured in place of rendered pictures; the picture to be looked at is rendered.
    """

    def __init__(
        self, world: World, link: ReferenceLink, config: VisionConfig, sight: Sight | None = None
    ) -> None:
        self._world = world
        self._link = link
        self._config = config
        self._pixels = PixelSight(world, config)
        self._sight = self._pixels if sight is None else sight
        self._latest: tuple[StereoPair, FrameObservation] | None = None
        self._repeats = Repeats(config.camera.frozen_frames)

    async def look(self, frames: int | None = None) -> Look:
        """A look over ``frames`` fresh pairs with the arm at rest."""
        if self._link.state.group_state is GroupState.MOVING:
            raise RequestRefused("refused.moving", "look: the arm is moving")
        pairs = self._pairs(frames or self._config.look.frames, self._sight)
        observations = [self._observed(pair, self._sight) for pair in pairs]
        time_ns = int(np.mean([observation.capture_ns for observation in observations]))
        look = combine(observations, await self._link.pose_at(time_ns), time_ns, self._config.look)
        self._world.log.add(self._world.time_ns, "look", X_CM=look.X_CM, X_CO=look.X_CO, frames=look.frames)
        return look

    async def pairs_at_rest(self, frames: int) -> PairsAtRest:
        """Fresh rendered pairs with the arm at rest."""
        if self._link.state.group_state is GroupState.MOVING:
            raise RequestRefused("refused.moving", "pictures: the arm is moving")
        pairs = self._pairs(frames, self._pixels)
        time_ns = int(np.mean([pair.capture_ns for pair in pairs]))
        return PairsAtRest(tuple(pairs), await self._link.pose_at(time_ns))

    async def aside(self, work: Callable[[], T]) -> T:
        """What ``work`` returns; computing takes no simulated time."""
        return work()

    @asynccontextmanager
    async def watch(self, *, markers: bool, odometry: bool) -> AsyncIterator[Watch]:
        """A context that samples every pair until its exit.

        Raises on exit: LinkLost when the camera was silent or frozen, MeasurementFailed when in vain.
        """
        previous = self._latest[1] if self._latest else None
        watcher = self._sight.watcher(markers=markers, odometry=odometry, previous=previous)
        watch = _LiveWatch(watcher, self._world, self._link)
        arrivals = self._arrivals(watch.arrived)
        self._sight.begin(arrivals.take)
        try:
            yield watch
            while not arrivals.live:  # a picture of the arm at rest, or the cause why there is none
                arrivals.require()
                self._world.clock.advance()
            arrivals.require()
        finally:
            self._sight.end()
        for pair in watch.waiting:
            watcher.add(pair, await self._link.pose_at(pair.capture_ns))
        self._world.log.add(self._world.time_ns, "watch", health=watcher.health)
        watcher.require()

    def status(self) -> CameraStatus:
        """The camera is always there."""
        return CameraStatus(True, 0.0, 0, self._world.settings.scene.camera.rate_hz)

    async def latest_png(self) -> bytes:
        """The newest picture with detections, PNG; a fresh one is taken where there is none."""
        if self._latest is None or self._sight is not self._pixels:
            self._observed(self._pairs(1, self._pixels)[0], self._pixels)
        assert self._latest is not None
        clearance_m = self._config.programs.positioning.clearance_m
        return png(annotated(*self._latest, self._pixels.camera, clearance_m))

    def _pairs(self, count: int, sight: Sight) -> list[StereoPair]:
        taken: list[StereoPair] = []
        arrivals = self._arrivals(taken.append)
        sight.begin(arrivals.take)
        try:
            while len(taken) < count:
                arrivals.require()
                self._world.clock.advance()
        finally:
            sight.end()
        return taken

    def _arrivals(self, deliver: Deliver) -> _Arrivals:
        return _Arrivals(self._world, self._config.camera, self._repeats, deliver)

    def _observed(self, pair: StereoPair, sight: Sight) -> FrameObservation:
        previous = self._latest[1] if self._latest else None
        observation = sight.observe(pair, previous)
        self._latest = (pair, observation)
        return observation
