"""The cycle: a body awaited once a period, at absolute deadlines."""

import asyncio
import time
from collections.abc import Awaitable, Callable

from foundation.durations import DurationHistogram
from foundation.periodic_timer import PeriodicTimer


class CyclicTask:
    """Awaits ``body(dt_ns)`` once a period; ``dt_ns`` is the whole number of periods since the call before.

    ``lateness``: how late after its deadline each call began, since the start; ``recent``: the same since
    whoever reads it cleared it last. ``overruns``: periods skipped.
    """

    def __init__(self, period_ns: int, body: Callable[[int], Awaitable[None]]) -> None:
        self.lateness = DurationHistogram()
        self.recent = DurationHistogram()
        self.overruns = 0
        self._period_ns = period_ns
        self._body = body
        self._stopping = False
        self._wake: asyncio.Future[None] | None = None

    def stop(self) -> None:
        """Let ``run`` return after the present call."""
        self._stopping = True
        self._woken()

    async def run(self) -> None:
        """Call the body until ``stop``. An exception of the body ends the task and is passed on."""
        loop = asyncio.get_running_loop()
        timer = PeriodicTimer(time.monotonic_ns() + self._period_ns, self._period_ns, self._woken)
        try:
            while not self._stopping:
                passed = timer.passed()
                if passed == 0:
                    self._wake = loop.create_future()
                    await self._wake
                    continue
                late_ns = time.monotonic_ns() - timer.deadline_ns
                self.lateness.add(late_ns)
                self.recent.add(late_ns)
                self.overruns += passed - 1
                await self._body(passed * self._period_ns)
        finally:
            timer.close()

    def _woken(self) -> None:
        if self._wake is not None and not self._wake.done():
            self._wake.set_result(None)
