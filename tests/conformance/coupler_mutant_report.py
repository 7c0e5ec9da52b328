"""How many broken couplers the coupler's suite catches, and by which case.

``python -m tests.conformance.coupler_mutant_report`` asks the cases of every broken coupler over real
sockets, with a clock that is moved instead of waited for, and prints a line for each clause and for each
coupler that no case catches. ``--clause 5`` or ``--clause 5.3``: only these; ``--name TEXT``: only those
whose name has it; ``--every``: all cases that catch one, not the first alone. It ends with status 1 when one
is not caught for which no reason is written.
"""

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from conformance.case import CaseOutcome
from conformance.coupler import tester_clock
from conformance.runner import coupler_cases, run_coupler
from tests.conformance.coupler.page_server import PageServer
from tests.conformance.coupler.systematic import MUTANTS, BrokenCoupler
from tests.conformance.couplers import ShiftedClock
from tests.conformance.mutant_report import Verdict, report


@contextmanager
def shifted_clock() -> Iterator[ShiftedClock]:
    """The tester's clock is moved instead of waited for."""
    before, clock = tester_clock.time, ShiftedClock()
    tester_clock.time = clock  # type: ignore[assignment]
    try:
        yield clock
    finally:
        tester_clock.time = before


def verdict(broken: BrokenCoupler, clock: ShiftedClock, *, every: bool = False) -> Verdict:
    """Which cases fail with ``broken``, those of its clause asked first: the first, or with ``every`` all."""
    numbers = sorted(coupler_cases(), key=lambda case: (case.clause != broken.clause, case.number))
    caught = []
    for case in numbers:
        with PageServer(broken.rules, clock) as server:
            summary = run_coupler("127.0.0.1", server.port, numbers=[case.number], outputs=True)
        if summary.results[0].outcome is CaseOutcome.FAIL:
            caught.append(case.number)
            if not every:
                break
    return Verdict(broken, tuple(caught))  # type: ignore[arg-type]


def main() -> int:
    """Ask, print, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clause", default="", help="only this clause, or all of 5 with 5")
    parser.add_argument("--name", default="", help="only those whose name has this text")
    parser.add_argument("--every", action="store_true", help="all cases that catch it, not the first alone")
    options = parser.parse_args()
    verdicts = []
    with shifted_clock() as clock:
        for broken in MUTANTS:
            wanted = not options.clause or f"{broken.clause}.".startswith(f"{options.clause}.")
            if wanted and options.name in broken.name:
                verdicts.append(verdict(broken, clock, every=options.every))
                print(f"{broken.clause} {broken.name}: {verdicts[-1].caught_by}", file=sys.stderr, flush=True)
    lines, wrong = report(verdicts)
    print("\n".join(lines))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
