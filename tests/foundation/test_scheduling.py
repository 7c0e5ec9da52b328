"""Scheduling: what the kernel granted is what is reported."""

import os
import platform
import re
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from foundation.periods import take_fifo, take_policy

SHORT_SLICES_SINCE = (6, 12)


def in_a_thread(ask: Callable[[], str]) -> tuple[str, int]:
    """What ``ask`` returns in a thread of its own, and that thread's class then."""
    with ThreadPoolExecutor(1) as threads:
        return threads.submit(lambda: (ask(), os.sched_getscheduler(0))).result()


def test_the_real_time_class_is_reported_as_obtained() -> None:
    obtained, policy = in_a_thread(lambda: take_fifo(10))
    assert (obtained == "fifo") == (policy & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO)


def test_without_the_real_time_class_it_asks_for_short_slices_where_the_kernel_has_them() -> None:
    obtained, policy = in_a_thread(lambda: take_fifo(0))
    assert policy == os.SCHED_OTHER
    known = sys.platform == "linux" and platform.machine() in ("x86_64", "aarch64")
    release = tuple(int(number) for number in re.findall(r"\d+", platform.release())[:2])
    assert obtained == ("short_slice" if known and release >= SHORT_SLICES_SINCE else "normal")


def test_a_thread_that_takes_idle_time_leaves_the_others_alone() -> None:
    before = os.sched_getscheduler(0)
    seen: list[tuple[str, int]] = []
    thread = threading.Thread(target=lambda: seen.append((take_policy("idle"), os.sched_getscheduler(0))))
    thread.start()
    thread.join()
    assert seen == [("idle", os.SCHED_IDLE)]
    assert os.sched_getscheduler(0) == before
