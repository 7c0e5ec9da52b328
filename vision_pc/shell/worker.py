"""A thread for long computations, and tasks beside the running one, on the service's event loop."""

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from foundation.periods import take_policy
from vision_pc.application.ports import Clock

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
