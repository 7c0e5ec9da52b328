"""The scheduling that a process or thread asks of the kernel, and the name of what it obtained."""

import contextlib
import os
from typing import Literal

Policy = Literal["idle", "batch", "normal"]
_POLICIES: dict[Policy, int] = {
    "idle": os.SCHED_IDLE,
    "batch": os.SCHED_BATCH,
    "normal": os.SCHED_OTHER,
}


def take_fifo(priority: int) -> str:
    """Ask for the real-time class for this process; return ``fifo`` where it is granted, else ``normal``.

    ``priority``: 1 to 99; 0 does not ask.
    """
    if priority > 0:
        with contextlib.suppress(PermissionError):
            parameters = os.sched_param(priority)
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, parameters)
            return "fifo"
    return "normal"


def take_policy(policy: Policy) -> str:
    """Ask for an ordinary class for the calling thread; return ``policy`` where granted, else ``normal``.

    It needs no privilege: ``idle`` and ``batch`` stand behind everything else on the machine.
    """
    try:
        os.sched_setscheduler(0, _POLICIES[policy], os.sched_param(0))
    except OSError:
        return "normal"
    return policy
