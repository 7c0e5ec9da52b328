"""Scheduling: what the kernel granted is what is reported."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from foundation.periods import take_fifo, take_policy


def in_a_thread(ask: Callable[[], str]) -> tuple[str, int]:
    """What ``ask`` returns in a thread of its own, and that thread's class then."""
    with ThreadPoolExecutor(1) as threads:
        return threads.submit(lambda: (ask(), os.sched_getscheduler(0))).result()


def test_the_real_time_class_is_reported_as_obtained() -> None:
    obtained, policy = in_a_thread(lambda: take_fifo(10))
    assert (obtained == "fifo") == (policy & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO)


def test_without_priority_it_is_not_asked_for() -> None:
    assert in_a_thread(lambda: take_fifo(0)) == ("normal", os.SCHED_OTHER)


def test_a_thread_that_takes_the_batch_class_leaves_the_others_alone() -> None:
    before = os.sched_getscheduler(0)
    assert in_a_thread(lambda: take_policy("batch")) == ("batch", os.SCHED_BATCH)
    assert os.sched_getscheduler(0) == before
