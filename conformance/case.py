"""What a conformance case is, the register of all of them, and what came of each."""

from collections.abc import Callable
from enum import Enum
from functools import partial
from typing import Any, Generic, NamedTuple, TypeVar

from conformance.master import Master
from conformance.parts import OptionalPart, Profile
from conformance.peer import Peer
from conformance.wire import Line
from protocol.errors import LinkLost

P = TypeVar("P")


class CaseOutcome(Enum):
    """How a case ended.

    FLAKY: it failed while the tester was late and, asked once more, passed. UNSUPPORTED: the peer lacks an
    optional part, or may not be asked to use it.
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
        self, number: int, clause: str, title: str, *, motion: bool = False,
        needs: OptionalPart | None = None, opens: int | None = None,
    ) -> Callable[[Callable[[P], None]], Callable[[P], None]]:  # fmt: skip
        """Decorator that enters a function; raises ValueError when the number is taken.

        ``opens``: a session is opened before, with STATE every so many ms.
        """
        parts = frozenset({self._moves} if motion else ()) | frozenset({needs} if needs else ())

        def enter(run: Callable[[P], None]) -> Callable[[P], None]:
            if number in self._cases:
                raise ValueError(f"case {number} is there twice")

            def begun(peer: Any) -> None:
                if opens is not None:
                    peer.open(period_ms=opens)
                run(peer)

            self._cases[number] = ConformanceCase(number, clause, title, motion, parts, begun)
            return run

        return enter

    @property
    def cases(self) -> tuple[ConformanceCase, ...]:
        """All cases, by number."""
        return tuple(self._cases[number] for number in sorted(self._cases))


reference = CaseRegister[Peer](OptionalPart.MOTION)
case = reference.case
moving_case = partial(case, motion=True)
stream_case = partial(moving_case, needs=OptionalPart.STREAMING)
coupler = CaseRegister[Master](OptionalPart.OUTPUTS)


class Attempt(NamedTuple):
    """One asking of a case; ``detail`` says why it did not pass."""

    outcome: CaseOutcome
    detail: str
    seconds: float
    transcript: tuple[Line, ...]
    late_ms: float = 0.0


class Result(NamedTuple):
    """What came of one case, and every asking of it: two where the first one failed, none if not asked."""

    case: ConformanceCase
    outcome: CaseOutcome
    detail: str
    attempts: tuple[Attempt, ...] = ()

    @property
    def seconds(self) -> float:
        """How long it took, all its askings together."""
        return sum(attempt.seconds for attempt in self.attempts)

    @property
    def transcript(self) -> tuple[Line, ...]:
        """The bytes of the last asking."""
        return self.attempts[-1].transcript if self.attempts else ()

    @property
    def late_ms(self) -> float:
        """The greatest lateness of the tester meanwhile."""
        return max((attempt.late_ms for attempt in self.attempts), default=0.0)


class Summary(NamedTuple):
    """Results in the order in which they came; ``ended`` says why the run broke off, None if it did not.

    ``late_ms``: the greatest lateness of the tester.
    """

    suite: str
    host: str
    port: int
    results: tuple[Result, ...]
    seconds: float
    late_ms: float
    profile: Profile | None = None
    ended: LinkLost | None = None

    def count(self, outcome: CaseOutcome) -> int:
        """How many cases ended so."""
        return sum(result.outcome is outcome for result in self.results)

    @property
    def passed(self) -> bool:
        """Whether something passed, nothing failed and the run came to its end."""
        return self.verdict is CaseOutcome.PASS and self.ended is None

    @property
    def verdict(self) -> CaseOutcome:
        """FAIL, PASS or UNSUPPORTED, of all cases together; flaky ones count as passed."""
        verdict = verdict_of([result.outcome for result in self.results])
        return CaseOutcome.PASS if verdict is CaseOutcome.FLAKY else verdict

    @property
    def clauses(self) -> dict[str, tuple[Result, ...]]:
        """The results by clause, in the order of the page."""
        numbers = sorted({result.case.clause for result in self.results}, key=_order)
        return {n: tuple(r for r in self.results if r.case.clause == n) for n in numbers}


def verdict_of(outcomes: list[CaseOutcome]) -> CaseOutcome:
    """FAIL if one failed, else FLAKY if one was, else PASS if one passed, else UNSUPPORTED."""
    ranking = (CaseOutcome.FAIL, CaseOutcome.FLAKY, CaseOutcome.PASS)
    return next((outcome for outcome in ranking if outcome in outcomes), CaseOutcome.UNSUPPORTED)


def _order(clause: str) -> tuple[int, ...]:
    return tuple(int(part) for part in clause.split("."))
