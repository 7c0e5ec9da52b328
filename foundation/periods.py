"""Periodic work: timer, scheduling class, how long each cycle took, and whether the machine keeps up."""

import asyncio
import contextlib
import ctypes
import os
import platform
import struct
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np

Policy = Literal["idle", "batch", "normal"]
_POLICIES: dict[Policy, int] = {
    "idle": os.SCHED_IDLE,
    "batch": os.SCHED_BATCH,
    "normal": os.SCHED_OTHER,
}


# struct sched_attr of sched_setattr(2): size, policy, flags, nice, priority, runtime, deadline, period.
_ATTRIBUTES = struct.Struct("=IIQiIQQQ")
_SET_AND_GET_ATTRIBUTES = {"x86_64": (314, 315), "aarch64": (274, 275)}  # numbers of the system calls
_SHORT_SLICE_NS = 100_000  # the shortest that the kernel takes


def take_fifo(priority: int) -> str:
    """Ask for the real-time class for this process; return what was obtained: ``fifo``, or what is next best.

    ``priority``: 1 to 99; 0 does not ask. The next best needs no privilege: ``short_slice`` where the kernel
    has it (Linux 6.12), else ``normal``.
    """
    if priority > 0:
        with contextlib.suppress(PermissionError):
            parameters = os.sched_param(priority)
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, parameters)
            return "fifo"
    return "short_slice" if _take_short_slice() else "normal"


def _take_short_slice() -> bool:
    """Ask for short turns: who is content with these is served sooner when it wakes (EEVDF's deadline).

    An older kernel takes the call and ignores it, so what is in force is read back.
    """
    numbers = _SET_AND_GET_ATTRIBUTES.get(platform.machine())
    system_call = getattr(ctypes.CDLL(None), "syscall", None)
    if numbers is None or system_call is None or os.sched_getscheduler(0) != os.SCHED_OTHER:
        return False
    set_attributes, get_attributes = numbers
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    asked = _ATTRIBUTES.pack(_ATTRIBUTES.size, os.SCHED_OTHER, 0, nice, 0, _SHORT_SLICE_NS, 0, 0)
    found = ctypes.create_string_buffer(_ATTRIBUTES.size)
    if system_call(set_attributes, 0, asked, 0) or system_call(get_attributes, 0, found, len(found), 0):
        return False
    return bool(_ATTRIBUTES.unpack(found.raw)[5] == _SHORT_SLICE_NS)


def take_policy(policy: Policy) -> str:
    """Ask for an ordinary class for the calling thread; return ``policy`` where granted, else ``normal``.

    It needs no privilege. ``batch`` interrupts nobody when it wakes; ``idle`` has what all others leave.
    """
    try:
        os.sched_setscheduler(0, _POLICIES[policy], os.sched_param(0))
    except OSError:
        return "normal"
    return policy


WINDOW_NS = 5_000_000_000
_FEWEST = 10  # of which a share says something


class Tally(NamedTuple):
    """What is done again and again, counted since the start: so many times done, so many missed or late."""

    done: int
    missed: int


class Limit(NamedTuple):
    """The share (percent) that may be missed, and the words for it: "of the controller's scans were late"."""

    percent: float
    words: str


class OverloadWatch:
    """Compares shares within the last five seconds with ``limits`` (by name).

    ``warning``: one sentence with the worst figure while the machine is overloaded, else empty.
    """

    def __init__(self, limits: Mapping[str, Limit]) -> None:
        self._limits = limits
        self._past: deque[tuple[int, Mapping[str, Tally]]] = deque()
        self.warning = ""

    def update(self, now_ns: int, counts: Mapping[str, Tally]) -> str:
        """``warning`` after ``counts`` of ``now_ns``. Names without a limit are left aside."""
        self._past.append((now_ns, counts))
        while len(self._past) > 2 and self._past[1][0] <= now_ns - WINDOW_NS:
            self._past.popleft()
        began_ns, before = self._past[0]
        worst, self.warning = 1.0, ""
        for name, limit in self._limits.items():
            if name not in counts or name not in before:
                continue
            missed = counts[name].missed - before[name].missed
            of = counts[name].done - before[name].done + missed
            if of < _FEWEST or missed < 0:  # too few, or counted anew by another process
                continue
            percent = 100.0 * missed / of
            if percent > limit.percent * worst:
                worst = percent / limit.percent
                seconds = (now_ns - began_ns) / 1e9
                share = f"{percent:.1f} % {limit.words} in the last {seconds:.0f} s"
                self.warning = f"the machine is overloaded: {share}"
        return self.warning


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
