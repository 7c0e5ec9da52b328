"""Absolute periodic deadlines from the kernel: a timerfd that the event loop reads like any other file."""

import asyncio
import ctypes
import os
import struct
from collections.abc import Callable

_CLOCK_MONOTONIC = 1
_TFD_NONBLOCK = os.O_NONBLOCK
_TFD_CLOEXEC = os.O_CLOEXEC
_TFD_TIMER_ABSTIME = 1
_NS_PER_S = 1_000_000_000
_LIBC = ctypes.CDLL(None, use_errno=True)


class PeriodicTimer:
    """Calls ``on_tick(deadline_ns, missed)`` in the running loop, once for each wake-up.

    ``deadline_ns`` is the newest deadline that has passed, on CLOCK_MONOTONIC, ``missed`` how many went by
    unserved since the last call: they are told, never caught up. asyncio's own timers round up to whole
    milliseconds.
    """

    def __init__(self, first_ns: int, period_ns: int, on_tick: Callable[[int, int], None]) -> None:
        self._next_ns = first_ns
        self._period_ns = period_ns
        self._on_tick = on_tick
        self._fd = _checked(_LIBC.timerfd_create(_CLOCK_MONOTONIC, _TFD_NONBLOCK | _TFD_CLOEXEC))
        setting = (ctypes.c_long * 4)(*divmod(period_ns, _NS_PER_S), *divmod(first_ns, _NS_PER_S))
        _checked(_LIBC.timerfd_settime(self._fd, _TFD_TIMER_ABSTIME, setting, None))
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._fd, self._expired)

    def close(self) -> None:
        """Stop calling."""
        if self._fd >= 0:
            self._loop.remove_reader(self._fd)
            os.close(self._fd)
            self._fd = -1

    def _expired(self) -> None:
        try:
            (count,) = struct.unpack("=Q", os.read(self._fd, 8))
        except BlockingIOError:
            return
        self._next_ns += count * self._period_ns
        self._on_tick(self._next_ns - self._period_ns, count - 1)


def _checked(result: int) -> int:
    if result < 0:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))
    return result
