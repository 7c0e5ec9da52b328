"""The scheduling that a process or thread asks of the kernel, and the name of what it obtained."""

import contextlib
import ctypes
import os
import platform
import struct
from typing import Literal

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

    It needs no privilege: ``idle`` and ``batch`` stand behind everything else on the machine.
    """
    try:
        os.sched_setscheduler(0, _POLICIES[policy], os.sched_param(0))
    except OSError:
        return "normal"
    return policy
