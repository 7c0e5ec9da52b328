"""The service's clock: the machine's monotonic time, and waiting on the event loop."""

import asyncio
import time
from collections.abc import Callable


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
