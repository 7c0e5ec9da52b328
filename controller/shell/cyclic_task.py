"""The cycle: absolute deadlines from a kernel timer, read through the event loop like any other file.

asyncio's own timers round up to whole milliseconds; a timerfd does not, and it tells how many deadlines
have passed. Missed periods are skipped and counted, never caught up.
"""

import asyncio
import ctypes
import os
import struct
import time
from collections.abc import Awaitable, Callable

from controller.shell.histogram import Histogram

_CLOCK_MONOTONIC = 1
_TFD_TIMER_ABSTIME = 1
_NS_PER_S = 1_000_000_000
_LIBC = ctypes.CDLL(None, use_errno=True)


class CyclicTask:
    """Awaits ``body(dt_ns)`` once a period; ``dt_ns`` is the whole number of periods since the call before.

    ``lateness``: how late after its deadline each call began, since the start; ``recent``: the same since
    whoever reads it cleared it last. ``overruns``: periods skipped.
    """

    def __init__(self, period_ns: int, body: Callable[[int], Awaitable[None]]) -> None:
        self.lateness = Histogram()
        self.recent = Histogram()
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
        first_ns = time.monotonic_ns() + self._period_ns
        fd = _armed_timer(first_ns, self._period_ns)
        next_ns = first_ns
        loop.add_reader(fd, self._woken)
        try:
            while not self._stopping:
                expired = _expirations(fd)
                if expired == 0:
                    self._wake = loop.create_future()
                    await self._wake
                    continue
                next_ns += expired * self._period_ns
                late_ns = time.monotonic_ns() - (next_ns - self._period_ns)
                self.lateness.add(late_ns)
                self.recent.add(late_ns)
                self.overruns += expired - 1
                await self._body(expired * self._period_ns)
        finally:
            loop.remove_reader(fd)
            os.close(fd)

    def _woken(self) -> None:
        if self._wake is not None and not self._wake.done():
            self._wake.set_result(None)


def _armed_timer(first_ns: int, period_ns: int) -> int:
    fd = _checked(_LIBC.timerfd_create(_CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC))
    setting = (ctypes.c_long * 4)(*divmod(period_ns, _NS_PER_S), *divmod(first_ns, _NS_PER_S))
    _checked(_LIBC.timerfd_settime(fd, _TFD_TIMER_ABSTIME, setting, None))
    return fd


def _expirations(fd: int) -> int:
    try:
        (count,) = struct.unpack("=Q", os.read(fd, 8))
    except BlockingIOError:
        return 0
    return int(count)


def _checked(result: int) -> int:
    if result < 0:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))
    return result


def real_time_scheduling(priority: int) -> str:
    """The scheduling obtained: ``fifo`` where wanted (priority above 0) and allowed, else ``normal``."""
    if priority > 0:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
        except PermissionError:
            return "normal"
        return "fifo"
    return "normal"
