"""Looks and watches from a camera's fresh frames: the service and lockstep run these same classes.

Time passes, frames arrive and computations run behind small ports; nothing here waits anywhere else.
Campaigns in lockstep therefore measure the eyes that ship. What differs there is the clock, the source of the
frames, and with simulated measurements the sensor.
"""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, nullcontext
from typing import Generic, TypeVar

import numpy as np

from protocol.errors import RequestRefused
from protocol.faults import GroupState
from vision_pc.application.camera_feed import CameraFeed
from vision_pc.application.ports import (
    Clock,
    Log,
    Runtime,
    SightRecorder,
)
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.application.targets.carrier import TargetCarrier, forgotten
from vision_pc.config.vision import LookSettings
from vision_pc.core.perception.look import combine
from vision_pc.core.perception.watch import Sensor, Watcher
from vision_pc.core.types import CameraFrame, FrameObservation, Look, WatchHealth, WatchSample

F = TypeVar("F", bound=CameraFrame)
_LONGEST_S = 3600.0  # a frame that does not come ends a watch long before


class LiveWatch(Generic[F]):
    """Implements ``vision_pc.core.ports.Watch`` over a watcher that is filled in the background, until that
    has ``ended``, by an ``error`` or without.
    """

    def __init__(self, watcher: Watcher[F], clock: Clock) -> None:
        self._watcher = watcher
        self._clock = clock
        self.ended = False
        self.error: Exception | None = None

    @property
    def samples(self) -> tuple[WatchSample, ...]:
        """One sample for every frame so far."""
        return self._watcher.samples

    @property
    def health(self) -> WatchHealth:
        """What was missed so far."""
        return self._watcher.health

    async def after(self, count: int, timeout_s: float) -> WatchSample | None:
        """The newest sample once there are more than ``count``, None after ``timeout_s``.

        Every frame is measured from now on, also while the arm stands.
        Raises what ended the gathering, such as LinkLost for a silent camera.
        """
        self._watcher.live = True
        await self._clock.until(lambda: self._watcher.count > count or self.ended, timeout_s)
        if self._watcher.count > count:
            return self._watcher.samples[-1]
        if self.error is not None:
            raise self.error
        return None

    async def join(self) -> None:
        """Wait for the end. Raises what ended the gathering."""
        await self._clock.until(lambda: self.ended, _LONGEST_S)
        if self.error is not None:
            raise self.error


class FrameEyes(Generic[F]):
    """Implements ``vision_pc.core.ports.Eyes`` over a source of frames and a sensor that measures in them."""

    def __init__(
        self,
        frames: CameraFeed[F],
        sensor: Sensor[F],
        states: ReferenceLink,
        settings: LookSettings,
        runtime: Runtime,
        log: Log,
        attendant: TargetCarrier | None = None,
    ) -> None:
        self._frames = frames
        self._sensor = sensor
        self._states = states
        self._settings = settings
        self._runtime = runtime
        self._log = log
        self._attendant = attendant
        self._latest: tuple[F, FrameObservation] | None = None
        self._recorder: SightRecorder[F] | None = None

    def recorded_by(self, recorder: SightRecorder[F]) -> None:
        """Have every measurement and look from now on recorded."""
        self._recorder = recorder
        self._sensor = recorder.tapped(self._sensor)

    async def look(self, frames: int | None = None) -> Look:
        """A look over ``frames`` fresh frames (None: as configured) with the arm at rest.

        Raises MeasurementFailed when tool or object is seen in too few of them, RequestRefused
        (``refused.moving``) while the arm moves, LinkLost when camera or controller is silent.
        """
        with self._attendant.looking() if self._attendant else nullcontext(forgotten) as looked:
            fresh = self._frames_at_rest(frames or self._settings.frames)
            observations = [await self._observed(frame) async for frame in fresh]
            time_ns = int(np.mean([observation.capture_ns for observation in observations]))
            look = combine(observations, await self._states.pose_at(time_ns), time_ns, self._settings)
            looked(look)
        if self._recorder is not None:
            self._recorder.looked(look, observations)
        return look

    @asynccontextmanager
    async def watch(self, *, markers: bool, odometry: bool) -> AsyncIterator[LiveWatch[F]]:
        """Samples of every frame that the worker can keep up with, until the exit.

        The first sample is taken before anything else happens: its camera frame is C0. The last one is of a
        frame taken after the exit was asked for. Raises as ``vision_pc.core.ports.Eyes.watch``.
        """
        clock = self._runtime.clock
        previous = None if self._latest is None else self._latest[1]
        watcher = Watcher(self._sensor, markers=markers, odometry=odometry, previous=previous)
        watcher.object_wanted = self._attendant is None or self._attendant.object_wanted
        with self._attendant.watching() if self._attendant else nullcontext(forgotten) as watched:
            last_ns = await self._sampled(watcher, clock.now_ns)
            until_ns: list[int] = []
            watch = LiveWatch(watcher, clock)
            end = self._runtime.background.start(self._gather(watcher, watch, last_ns, until_ns))
            try:
                yield watch
                until_ns.append(clock.now_ns)
                await watch.join()
                await self._runtime.worker.run(watcher.measure)
            finally:
                await end()
            self._latest = watcher.newest or self._latest
            self._log.write("watched", **watcher.health._asdict())
            watcher.require()
            watched(watcher.samples)
        if markers and odometry:
            # The camera's errors, where these are looked for: it sees with them from now on.
            await self._runtime.worker.run(watcher.calibrate)
            self._latest = watcher.newest or self._latest

    async def _gather(
        self, watcher: Watcher[F], watch: LiveWatch[F], last_ns: int, until_ns: list[int]
    ) -> None:
        try:
            while not until_ns or last_ns < until_ns[0]:
                last_ns = await self._sampled(watcher, last_ns)
        except Exception as error:
            watch.error = error
        watch.ended = True
        self._runtime.clock.wake()

    async def _sampled(self, watcher: Watcher[F], after_ns: int) -> int:
        """The capture time of the frame of which a sample was added to ``watcher``."""
        frame = await self._frames.frame_after(after_ns)
        X_BT = await self._states.pose_at(frame.capture_ns)
        await self._runtime.worker.run(lambda: watcher.add(frame, X_BT))
        self._latest = watcher.newest or self._latest
        self._runtime.clock.wake()
        return frame.capture_ns

    async def _frames_at_rest(self, count: int) -> AsyncIterator[F]:
        """``count`` fresh frames. Raises RequestRefused when the arm moves before, between or after them."""
        newest_ns = self._runtime.clock.now_ns
        for _ in range(count):
            self._refuse_moving()
            frame = await self._frames.frame_after(newest_ns)
            newest_ns = frame.capture_ns
            yield frame
        self._refuse_moving()

    async def _observed(self, frame: F) -> FrameObservation:
        previous = None if self._latest is None else self._latest[1]
        observation = await self._runtime.worker.run(lambda: self._sensor.observe(frame, previous))
        self._latest = (frame, observation)
        return observation

    def _refuse_moving(self) -> None:
        if self._states.state.group_state is GroupState.MOVING:
            raise RequestRefused("refused.moving", "look: the arm is moving")
