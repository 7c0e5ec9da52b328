"""What a conformance case is, and the register of all of them."""

from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

from testbed.conformance.peer import Peer


class Outcome(Enum):
    """How a case ended. UNSUPPORTED: the peer lacks an optional part, or may not be asked to use it."""

    PASS = "pass"
    FAIL = "fail"
    UNSUPPORTED = "unsupported"


class Case(NamedTuple):
    """One numbered question to the peer. ``motion``: it enables the group or moves the arm."""

    number: int
    clause: str
    title: str
    motion: bool
    run: Callable[[Peer], None]


class Register:
    """Cases in the order of their numbers, filled by decorators."""

    def __init__(self) -> None:
        self._cases: dict[int, Case] = {}

    def case(
        self, number: int, clause: str, title: str, *, motion: bool = False
    ) -> Callable[[Callable[[Peer], None]], Callable[[Peer], None]]:
        """Decorator that enters a function; raises ValueError when the number is taken."""

        def enter(run: Callable[[Peer], None]) -> Callable[[Peer], None]:
            if number in self._cases:
                raise ValueError(f"case {number} is there twice")
            self._cases[number] = Case(number, clause, title, motion, run)
            return run

        return enter

    @property
    def cases(self) -> tuple[Case, ...]:
        """All cases, by number."""
        return tuple(self._cases[number] for number in sorted(self._cases))


reference = Register()
