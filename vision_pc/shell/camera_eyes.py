"""The service's eyes put together: a camera, a thread to compute in, and the record of what was seen."""

import asyncio
import time
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar

from foundation.event_log import EventLog
from foundation.periods import take_policy
from vision_pc.application.annotate import annotated, png
from vision_pc.application.camera_eyes import CameraEyes
from vision_pc.application.ports import Clock, FrameSource, Runtime, StateSource
from vision_pc.config.vision import VisionConfig
from vision_pc.core.perception.intrinsics import calibration
from vision_pc.core.types import FrameObservation, Look, StereoPair, WatchHealth
from vision_pc.shell.pose_feed import UdpPoseFeed


class MonotonicClock:
    """Implements ``vision_pc.application.ports.Clock`` for everything that shares one event loop."""

    def __init__(self) -> None:
        self._news = asyncio.Event()

    @property
    def now_ns(self) -> int:
        """The machine's monotonic time."""
        return time.monotonic_ns()

    def wake(self) -> None:
        """Have everybody who waits look again."""
        self._news.set()
        self._news = asyncio.Event()

    async def until(self, happened: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for ``happened()``. Return False when ``timeout_s`` have passed first."""
        try:
            # Not wait_for: it swallows a cancellation that comes together with the event (Python < 3.12).
            async with asyncio.timeout(timeout_s):
                while not happened():
                    await self._news.wait()
        except TimeoutError:
            return happened()
        return True


T = TypeVar("T")


class BatchWorker:
    """Implements ``vision_pc.application.ports.Worker`` in one thread of the batch class; ``close`` ends it.

    The event loop stays free for the link and the REST API while the thread detects and tracks.
    """

    def __init__(self) -> None:
        # Batch: it never interrupts the event loop, and the link with it. Not idle: on a busy machine an idle
        # thread is suspended for long with the interpreter's lock in its hand, and the loop waits for that.
        self._thread = ThreadPoolExecutor(1, "vision")
        self.scheduling = self._thread.submit(take_policy, "batch").result()

    async def run(self, work: Callable[[], T]) -> T:
        """What ``work`` returns."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    def submit(self, work: Callable[[], None]) -> None:
        """Have ``work`` done later, in its turn."""
        self._thread.submit(work)

    def close(self) -> None:
        """End the thread, once it has finished what was submitted."""
        self._thread.shutdown()


class TaskBackground:
    """Implements ``vision_pc.application.ports.Background`` with tasks."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def start(self, program: Coroutine[Any, Any, None]) -> "TaskWork":
        """Start ``program`` as a task."""
        task = asyncio.create_task(program)
        task.add_done_callback(lambda _: self._clock.wake())
        return TaskWork(task)


class TaskWork:
    """Implements ``vision_pc.application.ports.BackgroundWork`` over a task."""

    def __init__(self, task: "asyncio.Task[None]") -> None:
        self._task = task

    @property
    def ended(self) -> bool:
        """Return True if the task is done."""
        return self._task.done()

    async def join(self) -> None:
        """Wait for the end. Raises what the program raised."""
        await self._task

    async def cancel(self) -> None:
        """Cancel the task and wait for its end."""
        self._task.cancel()
        await asyncio.wait([self._task])


class LookRecord:
    """Implements ``EyesRecord``: pictures go into the record directory, if there is one."""

    def __init__(self, config: VisionConfig, log: EventLog, worker: BatchWorker) -> None:
        self._camera = calibration(config.camera)
        self._clearance_m = config.programs.positioning.clearance_m
        self._log = log
        self._worker = worker
        self._looks = 0

    def pictured(self, frame: StereoPair, observation: FrameObservation) -> None:
        """Have the worker write the look's last picture, with its detections."""
        directory = self._log.record_dir
        if directory is None:
            return
        self._looks += 1
        path = directory / f"look-{self._looks:04d}.png"

        def write() -> None:
            try:
                path.write_bytes(png(annotated(frame, observation, self._camera, self._clearance_m)))
            except OSError as error:
                fields = {"cause": "recording.unwritable", "detail": f"{path}: {error.strerror}"}
                self._log.write("picture_failed", "error", **fields)

        self._worker.submit(write)

    def looked(self, look: Look) -> None:
        """Do nothing: the station writes every look of its programs."""

    def watched(self, health: WatchHealth) -> None:
        """Write what the watch missed."""
        self._log.write("watched", **health._asdict())


class OpenedEyes(NamedTuple):
    """Eyes and the worker that they compute in; its ``close`` waits for the last picture to be written."""

    eyes: CameraEyes
    worker: BatchWorker
    feed: UdpPoseFeed | None = None

    def close(self) -> None:
        """End the worker and the feed of poses."""
        self.worker.close()
        if self.feed is not None:
            self.feed.close()


def open_eyes(
    camera: FrameSource[StereoPair], states: StateSource, config: VisionConfig, log: EventLog
) -> OpenedEyes:
    """Eyes on ``camera`` within the running event loop. Raises ConfigurationError for a feed's taken port."""
    feed = UdpPoseFeed(config.odometry_feed, log) if config.odometry_feed.source == "udp" else None
    clock, worker = MonotonicClock(), BatchWorker()
    runtime = Runtime(clock, worker, TaskBackground(clock))
    eyes = CameraEyes(camera, states, config, runtime, LookRecord(config, log, worker), feed)
    return OpenedEyes(eyes, worker, feed)
