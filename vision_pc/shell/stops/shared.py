"""What vision PC and door share: settings at the start, and the link's numbers in a page of memory."""

import mmap
import os
import time
from typing import NamedTuple

from foundation.rest.guard import Access
from protocol.authentication import LinkKey

MOST_BYTES = 1 << 16  # of a message between the two
_SEQUENCE, _COMMAND_ID, _COUNT, _STATES, _GROUP, _FAULT, _FLAGS, _HELD, _TIME = range(9)
_ANSWERS, _KEPT = 9, 32  # pairs of command id and reason, in a ring


class SharedNumbers:
    """Written by the vision PC, read by the door. ``descriptor``: of the memory, from ``new_memory``."""

    def __init__(self, descriptor: int) -> None:
        self._numbers = memoryview(mmap.mmap(descriptor, mmap.PAGESIZE)).cast("Q")

    @property
    def next_numbers(self) -> tuple[int, int]:
        """The number of the link's next datagram, and the id of its next request."""
        return self._numbers[_SEQUENCE], self._numbers[_COMMAND_ID]

    @next_numbers.setter
    def next_numbers(self, numbers: tuple[int, int]) -> None:
        self._numbers[_SEQUENCE], self._numbers[_COMMAND_ID] = numbers

    def answer(self, command_id: int, reason: int) -> None:
        """Note that the controller has answered a request."""
        at = _ANSWERS + 2 * (self._numbers[_COUNT] % _KEPT)
        self._numbers[at + 1] = reason
        self._numbers[at] = command_id  # last: it says that the reason is there
        self._numbers[_COUNT] += 1

    def reason_of(self, command_id: int) -> int | None:
        """What it answered; None while it has not."""
        for at in range(_ANSWERS, _ANSWERS + 2 * _KEPT, 2):
            if self._numbers[at] == command_id:
                return self._numbers[at + 1]
        return None

    def tell_state(self, group_state: int, fault: int, flags: int) -> None:
        """Note what the newest STATE says."""
        self._numbers[_GROUP], self._numbers[_FAULT], self._numbers[_FLAGS] = group_state, fault, flags
        self._numbers[_STATES] += 1

    @property
    def state(self) -> tuple[int, int, int, int]:
        """How many states were told; group state, fault and flags of the newest."""
        count, group_state, fault, flags = self._numbers[_STATES : _FLAGS + 1]
        return count, group_state, fault, flags

    @property
    def time_ns(self) -> int:
        """The time with which the link stamps: the newest that was told, or the machine's where none was.

        By the plant's clock another stamp would make all that the vision PC sends after it seem old.
        """
        return self._numbers[_TIME] or time.monotonic_ns()

    @time_ns.setter
    def time_ns(self, now_ns: int) -> None:
        self._numbers[_TIME] = now_ns

    @property
    def clock_held(self) -> bool:
        """Whether a person holds the clock: what is sent is obeyed when it goes."""
        return bool(self._numbers[_HELD])

    @clock_held.setter
    def clock_held(self, held: bool) -> None:
        self._numbers[_HELD] = held


def new_memory() -> int:
    """The descriptor of a page that a child may inherit."""
    descriptor = os.memfd_create("longreach-stops")
    os.ftruncate(descriptor, mmap.PAGESIZE)
    return descriptor


class Given(NamedTuple):
    """``service``: the path of the socket behind the door; ``key``: of the reference link."""

    service: str
    access: Access
    key: LinkKey | None
