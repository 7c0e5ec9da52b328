"""What a conformance case is, and the register of all of them."""

from collections.abc import Callable
from enum import Enum
from typing import Any, Generic, NamedTuple, TypeVar

from conformance.master import Master
from conformance.parts import OptionalPart
from conformance.peer import Peer

P = TypeVar("P")


class CaseOutcome(Enum):
    """How a case ended.

    FLAKY: it failed and, asked once more, passed. UNSUPPORTED: the peer lacks an optional part, or may not be
    asked to use it.
    """

    PASS = "pass"
    FLAKY = "flaky"
    FAIL = "fail"
    UNSUPPORTED = "unsupported"


class ConformanceCase(NamedTuple):
    """One numbered question to the peer.

    ``motion``: it enables the group, moves or writes outputs. ``needs``: the optional parts it is about.
    """

    number: int
    clause: str
    title: str
    motion: bool
    needs: frozenset[OptionalPart]
    # Any: of the peer's class that the case's suite opens.
    run: Callable[[Any], None]


class CaseRegister(Generic[P]):
    """Cases by number, filled by decorators; ``moves``: the optional part that moving ones need."""

    def __init__(self, moves: OptionalPart) -> None:
        self._moves = moves
        self._cases: dict[int, ConformanceCase] = {}

    def case(
        self,
        number: int,
        clause: str,
        title: str,
        *,
        motion: bool = False,
        needs: OptionalPart | None = None,
    ) -> Callable[[Callable[[P], None]], Callable[[P], None]]:
        """Decorator that enters a function; raises ValueError when the number is taken."""
        parts = frozenset({self._moves} if motion else ()) | frozenset({needs} if needs else ())

        def enter(run: Callable[[P], None]) -> Callable[[P], None]:
            if number in self._cases:
                raise ValueError(f"case {number} is there twice")
            self._cases[number] = ConformanceCase(number, clause, title, motion, parts, run)
            return run

        return enter

    @property
    def cases(self) -> tuple[ConformanceCase, ...]:
        """All cases, by number."""
        return tuple(self._cases[number] for number in sorted(self._cases))


reference = CaseRegister[Peer](OptionalPart.MOTION)
coupler = CaseRegister[Master](OptionalPart.OUTPUTS)
