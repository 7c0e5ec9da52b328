"""What becomes of a service that crashed, and what a terminal is told: decided by times and causes alone."""

import signal
import time

import pytest

from foundation.incidents import ServiceIncident
from testbed.realtime.complaints import Complaint, Repetitions, complaint_of
from testbed.realtime.restarts import GiveUp, Restart, decide, how_it_ended, oom_kills


def crashes(*at_s: float) -> list[ServiceIncident]:
    return [ServiceIncident(at, f"service {k}", "service.crashed", f"crash {k}") for k, at in enumerate(at_s)]


@pytest.mark.parametrize(
    ("at_s", "after_s"),
    [((5.0,), 0.0), ((5.0, 6.0), 1.0), ((5.0, 65.0), 0.0), ((5.0, 6.0, 65.5), 1.0), ((0.0, 30.0, 60.0), 1.0)],
)
def test_a_service_is_started_anew_and_the_second_time_after_a_pause(
    at_s: tuple[float, ...], after_s: float
) -> None:
    assert decide(crashes(*at_s)) == Restart(after_s)


def test_three_crashes_within_a_minute_end_all_by_the_first_of_them() -> None:
    many = crashes(1.0, 100.0, 120.0, 159.9)
    assert decide(many) == GiveUp(many[1], 3)
    assert decide(many, most=4) == Restart(2.0)


@pytest.mark.parametrize(
    ("status", "said", "out_of_memory", "words"),
    [
        (-signal.SIGKILL, "", False, "signal SIGKILL (somebody else ended it)"),
        (-signal.SIGKILL, "", True, "signal SIGKILL (the machine ran out of memory)"),
        (-signal.SIGSEGV, "", True, "signal SIGSEGV (a fault in compiled code)"),
        (-signal.SIGABRT, "free()", False, "signal SIGABRT (a fault in compiled code); it said free()"),
        (3, "oil.lost: dry", False, "status 3: oil.lost: dry"),
        (1, "", False, "status 1: it had reported no error"),
    ],
)  # fmt: skip
def test_how_a_service_ended_is_told_in_words(
    status: int, said: str, out_of_memory: bool, words: str
) -> None:
    assert how_it_ended(status, said, out_of_memory) == words


def test_the_kernels_count_of_processes_without_memory_is_read() -> None:
    assert oom_kills("pgfault 12\noom_kill 3\noom_kill_other 9\n") == 3
    assert oom_kills("pgfault 12\n") == 0


def test_a_complaint_has_the_time_at_which_it_was_made() -> None:
    then_ns = time.monotonic_ns() - 90_000_000_000
    said = {"event": "overloaded", "cause": "machine.overloaded", "time_ns": then_ns}
    complaint = complaint_of('{"event": "overloaded", "cause": "machine.overloaded"}', said)
    assert complaint.at_s == pytest.approx(time.time() - 90.0, abs=1.0)
    assert (complaint.cause, complaint.words) == ("machine.overloaded", "machine.overloaded")


def test_a_complaint_that_goes_on_is_news_once_and_again_after_two_quiet_minutes() -> None:
    repetitions = Repetitions()

    def news(at_s: float, service: str = "plant", cause: str = "machine.overloaded") -> bool:
        return repetitions.is_news(service, Complaint(at_s, cause, "73 % late"))

    assert news(0.0)
    assert not any(news(30.0 * k) for k in range(1, 100))
    assert news(1.0, service="vision")
    assert news(2.0, cause="disk.low")
    assert news(30.0 * 99 + 120.0)
