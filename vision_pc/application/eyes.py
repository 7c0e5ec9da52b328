"""The eyes on a camera: looks and watches from fresh stereo pairs, computed in a thread of their own.

The event loop stays free for the link and the REST face while the thread detects and tracks.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from typing import Protocol, TypeVar

import numpy as np

from foundation.event_log import EventLog
from foundation.scheduling import take_policy
from protocol.errors import RequestRefused
from protocol.faults import GroupState
from protocol.reference_messages import State
from vision_pc.application.annotate import annotated, png
from vision_pc.application.ports import CameraStatus
from vision_pc.config.vision import VisionConfig
from vision_pc.core.perception.intrinsics import calibration
from vision_pc.core.perception.look import combine, observe
from vision_pc.core.perception.watch import Watcher
from vision_pc.core.ports import PairsAtRest
from vision_pc.core.se3 import Array
from vision_pc.core.types import FrameObservation, Look, StereoPair, WatchHealth, WatchSample
from vision_pc.shell.cameras import CameraSource

T = TypeVar("T")
_POLL_S = 0.005  # a new sample is noticed this late at most


class LiveWatch:
    """Implements ``vision_pc.core.ports.Watch`` over a watcher that a task fills."""

    def __init__(self, watcher: Watcher, gathering: "asyncio.Task[None]") -> None:
        self._watcher = watcher
        self._gathering = gathering

    @property
    def samples(self) -> tuple[WatchSample, ...]:
        """One sample for every pair so far."""
        return self._watcher.samples

    @property
    def health(self) -> WatchHealth:
        """What was missed so far."""
        return self._watcher.health

    async def after(self, count: int, timeout_s: float) -> WatchSample | None:
        """The newest sample once there are more than ``count``, None after ``timeout_s``.

        Raises what ended the gathering, such as LinkLost for a silent camera.
        """
        until_s = time.monotonic() + timeout_s
        while self._watcher.count <= count:
            if self._gathering.done():
                self._gathering.result()
                return None
            if time.monotonic() >= until_s:
                return None
            await asyncio.sleep(_POLL_S)
        return self._watcher.samples[-1]


class PoseLink(Protocol):
    """What the eyes want from the reference link; ``ReferenceLink`` implements it."""

    @property
    def state(self) -> State: ...
    async def pose_at(self, local_ns: int) -> Array: ...


class CameraEyes:
    """Implements ``vision_pc.core.ports.Eyes`` and the station's camera. ``close`` ends its thread."""

    def __init__(self, camera: CameraSource, link: PoseLink, config: VisionConfig, log: EventLog) -> None:
        self._camera = camera
        self._link = link
        self._config = config
        self._log = log
        self._model = calibration(config.camera)
        self._latest: tuple[StereoPair, FrameObservation] | None = None
        self._looks = 0
        # Detection never delays the arm's cycle; the event loop keeps its priority, and the link with it.
        self._worker = ThreadPoolExecutor(1, "vision")
        self.scheduling = self._worker.submit(take_policy, "idle").result()

    def close(self) -> None:
        """Ends the thread, once it has finished what it has begun and written the last picture."""
        self._worker.shutdown()

    def status(self) -> CameraStatus:
        """How the camera is doing."""
        return CameraStatus(**self._camera.status()._asdict())

    async def look(self, frames: int | None = None) -> Look:
        """A look over ``frames`` fresh pairs (None: as configured) with the arm at rest.

        Raises MeasurementFailed when tool or object is seen in too few of them, RequestRefused
        (``refused.moving``) while the arm moves, LinkLost when camera or controller is silent.
        """
        observations: list[FrameObservation] = []
        newest_ns = time.monotonic_ns()
        pair: StereoPair | None = None
        for _ in range(frames or self._config.look.frames):
            self._refuse_moving()
            pair = await self._camera.pair_after(newest_ns)
            newest_ns = pair.capture_ns
            observations.append(await self._observed(pair))
        self._refuse_moving()
        if pair is not None:
            self._keep_picture(pair, observations[-1])
        time_ns = int(np.mean([observation.capture_ns for observation in observations]))
        return combine(observations, await self._link.pose_at(time_ns), time_ns, self._config.look)

    async def pairs_at_rest(self, frames: int) -> PairsAtRest:
        """Fresh pairs with the arm at rest. Raises as ``look``, but measures nothing."""
        pairs: list[StereoPair] = []
        newest_ns = time.monotonic_ns()
        for _ in range(frames):
            self._refuse_moving()
            pairs.append(await self._camera.pair_after(newest_ns))
            newest_ns = pairs[-1].capture_ns
        self._refuse_moving()
        middle_ns = int(np.mean([pair.capture_ns for pair in pairs]))
        return PairsAtRest(tuple(pairs), await self._link.pose_at(middle_ns))

    async def aside(self, work: Callable[[], T]) -> T:
        """What ``work`` returns, computed in the eyes' own thread: the event loop stays free for the link."""
        return await self._in_thread(work)

    @asynccontextmanager
    async def watch(self, *, markers: bool, odometry: bool) -> AsyncIterator[LiveWatch]:
        """Samples of every pair that the thread can keep up with, until the exit.

        The first sample is taken before anything else happens: its camera frame is C0. The last one is of a
        pair taken after the exit was asked for. Raises as ``Eyes.watch``.
        """
        previous = None if self._latest is None else self._latest[1]
        watcher = Watcher(self._model, self._config, markers=markers, odometry=odometry, previous=previous)
        last_ns = await self._sampled(watcher, time.monotonic_ns())
        until_ns: list[int] = []
        gathering = asyncio.create_task(self._gather(watcher, last_ns, until_ns))
        try:
            yield LiveWatch(watcher, gathering)
            until_ns.append(time.monotonic_ns())
            await gathering
        finally:
            gathering.cancel()
            await asyncio.wait([gathering])
        watcher.require()
        self._log.write("watched", **watcher.health._asdict())

    async def latest_png(self) -> bytes:
        """The newest picture with detections, PNG. Raises LinkLost when the camera never gave one."""
        pair = self._camera.newest or await self._camera.pair_after(0)
        if self._latest is None or self._latest[0].capture_ns < pair.capture_ns:
            await self._observed(pair)
        assert self._latest is not None
        shown = self._latest
        return await self._in_thread(lambda: self._picture(*shown))

    async def _gather(self, watcher: Watcher, last_ns: int, until_ns: list[int]) -> None:
        while not until_ns or last_ns < until_ns[0]:
            last_ns = await self._sampled(watcher, last_ns)

    async def _sampled(self, watcher: Watcher, after_ns: int) -> int:
        """The capture time of the pair of which a sample was added to ``watcher``."""
        pair = await self._camera.pair_after(after_ns)
        X_BT = await self._link.pose_at(pair.capture_ns)
        await self._in_thread(lambda: watcher.add(pair, X_BT))
        if watcher.observation is not None and watcher.observation.frame_id == pair.frame_id:
            self._latest = (pair, watcher.observation)
        return pair.capture_ns

    async def _observed(self, pair: StereoPair) -> FrameObservation:
        previous = None if self._latest is None else self._latest[1]
        settings = self._config.markers
        observation = await self._in_thread(lambda: observe(pair, self._model, settings, previous))
        self._latest = (pair, observation)
        return observation

    async def _in_thread(self, work: Callable[[], T]) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._worker, work)

    def _refuse_moving(self) -> None:
        if self._link.state.group_state is GroupState.MOVING:
            raise RequestRefused("refused.moving", "look: the arm is moving")

    def _picture(self, pair: StereoPair, observation: FrameObservation) -> bytes:
        clearance_m = self._config.programs.positioning.clearance_m
        return png(annotated(pair, observation, self._model, clearance_m))

    def _keep_picture(self, pair: StereoPair, observation: FrameObservation) -> None:
        """Has the thread write the look's last picture into the record directory, if there is one."""
        directory = self._log.record_dir
        if directory is None:
            return
        self._looks += 1
        path = directory / f"look-{self._looks:04d}.png"

        def write() -> None:
            try:
                path.write_bytes(self._picture(pair, observation))
            except OSError as error:
                fields = {"cause": "recording.unwritable", "detail": f"{path}: {error.strerror}"}
                self._log.write("picture_failed", "error", **fields)

        self._worker.submit(write)
