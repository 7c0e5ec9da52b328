"""The service's eyes put together: a camera, a thread to compute in, and the record of what was seen."""

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar

from foundation import clock
from foundation.event_log import EventLog
from foundation.periods import take_policy
from vision_pc.application.camera_eyes import CameraEyes
from vision_pc.application.camera_feed import CameraFeed
from vision_pc.application.ports import Runtime
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.config.vision import VisionConfig
from vision_pc.core.types import StereoPair
from vision_pc.shell.pose_feed import UdpPoseFeed


class ProcessClock:
    """Implements ``vision_pc.application.ports.Clock`` for everything that shares one event loop."""

    def __init__(self) -> None:
        self._news = asyncio.Event()

    @property
    def now_ns(self) -> int:
        """The time of this process."""
        return clock.now_ns()

    def wake(self) -> None:
        """Have everybody who waits look again."""
        self._news.set()
        self._news = asyncio.Event()

    async def until(self, happened: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for ``happened()``. Return False when ``timeout_s`` have passed first."""
        until_ns = clock.now_ns() + round(1e9 * timeout_s)
        alarm = clock.current().call_at(until_ns, self.wake)
        try:
            while not happened():
                if clock.now_ns() >= until_ns:
                    return False
                await self._news.wait()
        finally:
            alarm.cancel()
        return True


T = TypeVar("T")
TAKES_NS = 40_000_000
"""What a measurement takes by the plant's clock, as on a machine that keeps up [M]; meanwhile time passes."""


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
        return await clock.current().computed(self._thread, work, TAKES_NS)

    def close(self) -> None:
        """End the thread."""
        self._thread.shutdown()


class TaskBackground:
    """Implements ``vision_pc.application.ports.Background`` with tasks."""

    def start(self, program: Coroutine[Any, Any, None]) -> Callable[[], Awaitable[None]]:
        """Start ``program`` as a task. Return what cancels it and waits for its end."""
        task = asyncio.create_task(program)

        async def cancel() -> None:
            task.cancel()
            await asyncio.wait([task])

        return cancel


class OpenedEyes(NamedTuple):
    """Eyes and the worker that they compute in."""

    eyes: CameraEyes
    worker: BatchWorker
    feed: UdpPoseFeed | None = None

    def close(self) -> None:
        """End the worker and the feed of poses."""
        self.worker.close()
        if self.feed is not None:
            self.feed.close()


def open_eyes(
    camera: CameraFeed[StereoPair], states: ReferenceLink, config: VisionConfig, log: EventLog
) -> OpenedEyes:
    """Eyes on ``camera`` within the running event loop. Raises ConfigurationError for a feed's taken port."""
    feed = UdpPoseFeed(config.odometry_feed, log) if config.odometry_feed.source == "udp" else None
    time, worker = ProcessClock(), BatchWorker()
    runtime = Runtime(time, worker, TaskBackground())
    eyes = CameraEyes(camera, states, config, runtime, log, feed)
    return OpenedEyes(eyes, worker, feed)
