"""What becomes of a service that crashed: it is started anew, or all is ended. Pure: times and causes in."""

import signal
from collections.abc import Sequence
from typing import NamedTuple

from foundation.incidents import ServiceIncident

WINDOW_S = 60.0
MOST_CRASHES = 3  # within the window; the last of them ends all
PAUSE_S = 1.0  # before the second restart within the window


class Restart(NamedTuple):
    """Start the service anew, after a pause."""

    after_s: float


class GiveUp(NamedTuple):
    """End everything: ``first`` is the crash that the others followed."""

    first: ServiceIncident
    crashes: int


def decide(crashes: Sequence[ServiceIncident], most: int = MOST_CRASHES) -> Restart | GiveUp:
    """What to do after the last of ``crashes`` (of all services, the oldest first)."""
    recent = [crash for crash in crashes if crashes[-1].at_s - crash.at_s < WINDOW_S]
    if len(recent) >= most:
        return GiveUp(recent[0], len(recent))
    return Restart(PAUSE_S * (len(recent) - 1))


_FAULTS = frozenset({signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGABRT})


def how_it_ended(status: int, said: str, out_of_memory: bool) -> str:
    """Words on an exit ``status`` (negative: the signal's number).

    ``said``: the reason that the process gave, empty where it gave none. ``out_of_memory``: the kernel ended
    a process for want of memory while this one ran.
    """
    if status >= 0:
        return f"status {status}: {said or 'it had reported no error'}"
    number = signal.Signals(-status)
    if number in _FAULTS:
        why = "a fault in compiled code"
    elif number is signal.SIGKILL and out_of_memory:
        why = "the machine ran out of memory"
    else:
        why = "somebody else ended it"
    return f"signal {number.name} ({why})" + (f"; it said {said}" if said else "")


def oom_kills(vmstat: str) -> int:
    """How many processes the kernel has ended for want of memory; ``vmstat``: the text of /proc/vmstat."""
    counts = (line.split() for line in vmstat.splitlines())
    return next((int(words[1]) for words in counts if words[:1] == ["oom_kill"]), 0)
