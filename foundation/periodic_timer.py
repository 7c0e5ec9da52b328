"""Absolute periodic deadlines from the kernel: a timerfd that the event loop reads like any other file.

asyncio's own timers round up to whole milliseconds; a timerfd does not, and it says how many deadlines have
passed. Missed periods are skipped and counted, never caught up.
"""

import asyncio
import ctypes
import os
import struct
from collections.abc import Callable

_CLOCK_MONOTONIC = 1
_TFD_TIMER_ABSTIME = 1
_NS_PER_S = 1_000_000_000
_LIBC = ctypes.CDLL(None, use_errno=True)


class PeriodicTimer:
    """Deadlines at ``first_ns`` and every ``period_ns`` after it, on CLOCK_MONOTONIC.

    ``on_ready`` is called in the running loop while a deadline has passed that ``passed`` has not returned.
    ``deadline_ns``: the newest deadline that ``passed`` has returned.
    """

    def __init__(self, first_ns: int, period_ns: int, on_ready: Callable[[], None]) -> None:
        self.deadline_ns = first_ns - period_ns
        self._period_ns = period_ns
        self._fd = _checked(_LIBC.timerfd_create(_CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC))
        setting = (ctypes.c_long * 4)(*divmod(period_ns, _NS_PER_S), *divmod(first_ns, _NS_PER_S))
        _checked(_LIBC.timerfd_settime(self._fd, _TFD_TIMER_ABSTIME, setting, None))
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._fd, on_ready)

    def passed(self) -> int:
        """How many deadlines have passed since the last call; it does not wait for one."""
        try:
            (count,) = struct.unpack("=Q", os.read(self._fd, 8))
        except BlockingIOError:
            return 0
        self.deadline_ns += count * self._period_ns
        return int(count)

    def close(self) -> None:
        """Stop calling."""
        if self._fd >= 0:
            self._loop.remove_reader(self._fd)
            os.close(self._fd)
            self._fd = -1


def _checked(result: int) -> int:
    if result < 0:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))
    return result
