"""What came of the cases: of each one, of each clause, and of the whole run."""

from typing import NamedTuple

from conformance.case import CaseOutcome, ConformanceCase
from conformance.lateness import LatenessFigures
from conformance.parts import Profile
from conformance.wire import Line
from protocol.errors import LinkLost

GOOD = (CaseOutcome.PASS, CaseOutcome.FLAKY)


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
    """Results in the order in which they came; ``ended`` says why the run broke off, None if it did not."""

    suite: str
    host: str
    port: int
    results: tuple[Result, ...]
    seconds: float
    lateness: LatenessFigures
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
