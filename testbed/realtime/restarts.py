"""How a service ended, in words. Pure: statuses and texts in."""

import signal

_FAULTS = frozenset({signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGABRT})


def how_it_ended(status: int, reason: str) -> str:
    """Words on an exit ``status`` (negative: the signal's number).

    ``reason``: the reason that the process gave, empty where it gave none.
    """
    if status >= 0:
        return f"status {status}: {reason or 'it had reported no error'}"
    number = signal.Signals(-status)
    why = "somebody else ended it"
    if number in _FAULTS:
        why = "a fault in compiled code"
    elif number is signal.SIGKILL:
        why += ", or the machine ran out of memory"
    return f"signal {number.name} ({why})" + (f"; it said {reason}" if reason else "")
