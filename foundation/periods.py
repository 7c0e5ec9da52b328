"""Periodic work: timer, scheduling class, and how long each cycle took."""

import asyncio
import contextlib
import ctypes
import os
import struct
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np


def take_fifo(priority: int) -> str:
    """Ask for the real-time class for this process; return what was obtained: ``fifo`` or ``normal``.

    ``priority``: 1 to 99; 0 does not ask.
    """
    if priority > 0:
        with contextlib.suppress(PermissionError):
            parameters = os.sched_param(priority)
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, parameters)
            return "fifo"
    return "normal"


def take_policy(policy: Literal["batch"]) -> str:
    """Have the calling thread interrupt nobody when it wakes; return ``policy``, or ``normal`` if refused.

    It needs no privilege.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    except OSError:
        return "normal"
    return policy


_BINS = 50_000  # one a microsecond; what is longer is counted in the last and known by its maximum


class DurationHistogram:
    """Counts of durations. ``count``: how many; ``max_ns``: the longest; ``sum_ns``: of them all."""

    def __init__(self) -> None:
        self.count = 0
        self.max_ns = 0
        self.sum_ns = 0
        self._counts = np.zeros(_BINS + 1, dtype=np.int64)

    def add(self, duration_ns: int) -> None:
        """Count one duration; negative ones count as zero."""
        self.count += 1
        self.max_ns = max(self.max_ns, duration_ns)
        self.sum_ns += max(duration_ns, 0)
        self._counts[min(max(duration_ns, 0) // 1000, _BINS)] += 1

    def clear(self) -> None:
        """Forget everything."""
        self.count = self.max_ns = self.sum_ns = 0
        self._counts[:] = 0

    def percentiles_us(self, *shares: float) -> tuple[int, ...]:
        """For each of ``shares`` (0…1) the duration in µs that this share does not exceed; 0 when empty."""
        if self.count == 0:
            return (0,) * len(shares)
        sums = np.cumsum(self._counts)
        found = np.searchsorted(sums, np.array(shares) * self.count)
        return tuple(self.max_ns // 1000 if index >= _BINS else int(index) + 1 for index in found)

    def counts_below_us(self, bounds_us: Sequence[int]) -> tuple[int, ...]:
        """How many durations lie below each of the rising ``bounds_us``, 50 ms at most; the last: how many
        there are. Another thread may ask while durations are added.
        """
        parts = np.add.reduceat(self._counts, [0, *bounds_us])
        return tuple(np.cumsum(parts).tolist())

    def as_dict(self, prefix: str) -> dict[str, int]:
        """Percentiles and maximum by name, in µs."""
        p50, p99, p999 = self.percentiles_us(0.5, 0.99, 0.999)
        return {
            f"{prefix}_p50_us": p50,
            f"{prefix}_p99_us": p99,
            f"{prefix}_p999_us": p999,
            f"{prefix}_max_us": self.max_ns // 1000,
        }


def percent_missed(served: int, missed: int) -> float:
    """The share of ``missed`` among all periods, in percent; 0 before the first."""
    return 100.0 * missed / (served + missed) if served else 0.0


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
        self._fd = _check_result(_LIBC.timerfd_create(_CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC))
        setting = (ctypes.c_long * 4)(*divmod(period_ns, _NS_PER_S), *divmod(first_ns, _NS_PER_S))
        _check_result(_LIBC.timerfd_settime(self._fd, _TFD_TIMER_ABSTIME, setting, None))
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


def _check_result(result: int) -> int:
    if result < 0:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))
    return result
