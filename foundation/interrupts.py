"""Ctrl-C at a time when it can be taken."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType


@contextlib.contextmanager
def interrupt_later() -> Iterator[None]:
    """Within the block Ctrl-C waits; it comes, as it would have, when the block ends.

    For native code that calls Python back and does not look whether that raised: the loading of compiled
    kernels loses such an exception, fails by something else, or crashes. Without effect in other threads than
    the main one, which get no signals, and where the signal is ignored.
    """
    usual = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(usual):
        yield
        return
    came: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda number, frame: came.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)
        if came:
            usual(*came[-1])
