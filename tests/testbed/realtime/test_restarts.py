"""How a service ended is told in words."""

import signal

import pytest

from testbed.realtime.restarts import how_it_ended


@pytest.mark.parametrize(
    ("status", "said", "words"),
    [
        (-signal.SIGKILL, "", "signal SIGKILL (somebody else ended it, or the machine ran out of memory)"),
        (-signal.SIGTERM, "", "signal SIGTERM (somebody else ended it)"),
        (-signal.SIGABRT, "free()", "signal SIGABRT (a fault in compiled code); it said free()"),
        (3, "oil.lost: dry", "status 3: oil.lost: dry"),
        (1, "", "status 1: it had reported no error"),
    ],
)
def test_how_a_service_ended_is_told_in_words(status: int, said: str, words: str) -> None:
    assert how_it_ended(status, said) == words
