"""Scheduling: what the kernel granted is what is reported."""

import os
import threading

from foundation.scheduling import take_fifo, take_policy


def test_the_real_time_class_is_reported_as_obtained() -> None:
    before = os.sched_getscheduler(0)
    try:
        assert take_fifo(0) == "normal"
        assert os.sched_getscheduler(0) == before
        obtained = take_fifo(10)
        policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
        assert (obtained == "fifo") == (policy == os.SCHED_FIFO)
    finally:
        os.sched_setscheduler(0, before, os.sched_param(0))


def test_a_thread_that_takes_idle_time_leaves_the_others_alone() -> None:
    before = os.sched_getscheduler(0)
    seen: list[tuple[str, int]] = []
    thread = threading.Thread(target=lambda: seen.append((take_policy("idle"), os.sched_getscheduler(0))))
    thread.start()
    thread.join()
    assert seen == [("idle", os.SCHED_IDLE)]
    assert os.sched_getscheduler(0) == before
