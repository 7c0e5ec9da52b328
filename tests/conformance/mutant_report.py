"""How many broken controllers and couplers the suites catch, and by which case.

``python -m tests.conformance.mutant_report`` asks every case of every broken controller, in simulated time,
and prints a line for each clause and for each controller that no case catches; ``--coupler``: of every broken
coupler, over real sockets, with a clock that is moved instead of waited for. ``--clause 5`` or ``--clause
5.3``: only these; ``--name TEXT``: only those whose name has it; ``--every``: all cases that catch one, not
the first alone. ``--part 1/3`` and its like share a run. It ends with status 1 when one is not caught for
which no reason is written.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from itertools import groupby
from typing import Any, NamedTuple

from conformance.case import GOOD, CaseOutcome, ConformanceCase, Result
from conformance.coupler import frames
from conformance.runner import coupler_cases, reference_cases, run_coupler, run_reference
from protocol.authentication import LinkKey
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.coupler.page_server import PageServer
from tests.conformance.coupler.systematic import MUTANTS as SYSTEMATIC
from tests.conformance.coupler.systematic import BrokenCoupler
from tests.conformance.coupler.systematic_readings import MUTANTS as READINGS
from tests.conformance.couplers import ShiftedClock
from tests.conformance.mutator import BrokenController
from tests.conformance.simulated_network import simulated

COUPLERS = (*SYSTEMATIC, *READINGS)
FOR_A_KEY = set(range(701, 722)) | set(range(723, 741))
FOR_NO_KEY = {722}
# They take many datagrams, or much time.
SLOW = {327, 328}
# Each has MUTANTS, a tuple of BrokenController.
SOURCES: tuple[str, ...] = (
    "tests.conformance.named_edits",
    "tests.conformance.named_hooks",
    "tests.conformance.systematic_pairs",
    "tests.conformance.systematic_table",
    "tests.conformance.systematic_fields",
    "tests.conformance.systematic_checks",
    "tests.conformance.systematic_effects",
    "tests.conformance.systematic_limits",
    "tests.conformance.systematic_state",
    "tests.conformance.systematic_motions",
    "tests.conformance.systematic_streams",
)


class Verdict(NamedTuple):
    """The cases that a broken controller did not pass, in the order in which they were asked."""

    broken: BrokenController | BrokenCoupler
    caught_by: tuple[int, ...]


def broken_controllers(sources: Iterable[str] = SOURCES) -> tuple[BrokenController, ...]:
    """All of all sources."""
    return tuple(each for source in sources for each in import_module(source).MUTANTS)


def asked(key: LinkKey | None, clause: str, first: int = 0) -> list[ConformanceCase]:
    """The cases for a controller with or without a key: case ``first``, then those of ``clause``.

    Those that move come last. The slow ones are asked about their own clause only.
    """
    others = FOR_NO_KEY if key else FOR_A_KEY
    expected = [case for case in reference_cases() if case.number not in others]
    cases = [case for case in expected if case.number not in SLOW or clause == case.clause]
    return sorted(
        cases, key=lambda case: (case.number != first, case.clause != clause, case.motion, case.number)
    )


def verdict(broken: BrokenController, cases: Iterable[ConformanceCase], *, every: bool = False) -> Verdict:
    """Which of ``cases`` catch ``broken``: the first, or with ``every`` all of them.

    A controller meets all cases of one kind, one after the other, as in a run of the suite. One that ends by
    an exception, or leaves the link altogether, is caught by the case that was asked then.
    """
    caught: list[int] = []
    for _, turn in groupby(cases, key=lambda case: _turn(broken, case)):
        caught += _caught(broken, [case.number for case in turn], every)
        if caught and not every:
            break
    return Verdict(broken, tuple(caught))


def _turn(broken: BrokenController, case: ConformanceCase) -> tuple[bool, bool, bool]:
    return case.number == broken.case, case.clause == broken.clause, case.motion


class _Enough(Exception):
    """A case has caught it."""


class _FellOver(Exception):
    """The controller has ended by an exception."""


def _guarded(turn: Callable[[], None]) -> Callable[[], None]:
    def guarded() -> None:
        try:
            turn()
        except Exception as fault:
            raise _FellOver from fault

    return guarded


def _caught(broken: BrokenController, numbers: list[int], every: bool) -> list[int]:
    """Those of ``numbers`` that fail, up to the first unless ``every``."""
    caught: list[int] = []
    left = list(numbers)

    def note(result: Result) -> None:
        left.remove(result.case.number)
        if result.outcome not in GOOD:  # all claim every part: one that lacks it fails
            caught.append(result.case.number)
            if not every:
                raise _Enough

    try:
        with controllers_in_simulated_time(), broken.make() as controller:
            controller.turn = _guarded(controller.turn)  # type: ignore[method-assign]
            summary = run_reference(
                "127.0.0.1",
                controller.port,
                numbers=numbers,
                motion=True,
                key=broken.key,
                seed=1,
                on_result=note,
            )
        lost = summary.ended is not None and not caught
    except _Enough:
        lost = False
    except _FellOver:
        lost = True
    return caught + left[:1] if lost else caught


@contextmanager
def controllers_in_simulated_time() -> Iterator[None]:
    """Suite and controllers share one simulated clock; no sockets, no waiting."""
    before = ControllerUnderTest.network
    with simulated() as network:
        ControllerUnderTest.network = network
        try:
            yield
        finally:
            ControllerUnderTest.network = before


@contextmanager
def shifted_clock() -> Iterator[ShiftedClock]:
    """The tester's clock is moved instead of waited for."""
    before, clock = frames.time, ShiftedClock()
    frames.time = clock  # type: ignore[assignment]
    try:
        yield clock
    finally:
        frames.time = before


def coupler_verdict(broken: BrokenCoupler, clock: ShiftedClock, *, every: bool = False) -> Verdict:
    """Which cases fail with ``broken``, those of its clause asked first: the first, or with ``every`` all."""
    caught = []
    for case in sorted(coupler_cases(), key=lambda case: (case.clause != broken.clause, case.number)):
        with PageServer(broken.rules, clock) as server:
            summary = run_coupler("127.0.0.1", server.port, numbers=[case.number], outputs=True)
        if summary.results[0].outcome is CaseOutcome.FAIL:
            caught.append(case.number)
            if not every:
                break
    return Verdict(broken, tuple(caught))


def report(verdicts: Iterable[Verdict]) -> tuple[list[str], list[Verdict]]:
    """Lines to print, and those verdicts that are not as they should be."""
    by_clause: dict[str, list[Verdict]] = defaultdict(list)
    for each in verdicts:
        by_clause[each.broken.clause].append(each)
    lines = [f"{'clause':>7} {'broken':>7} {'caught':>7} {'unseen':>7}  by which cases"]
    wrong = []
    for clause in sorted(by_clause, key=_order):
        row = by_clause[clause]
        caught = [each for each in row if each.caught_by]
        cases = sorted({number for each in caught for number in each.caught_by})
        unseen = [each for each in row if not each.caught_by and each.broken.unseen]
        wrong += [each for each in row if bool(each.caught_by) == bool(each.broken.unseen)]
        lines.append(
            f"{clause:>7} {len(row):>7} {len(caught):>7} {len(unseen):>7}  {', '.join(map(str, cases))}"
        )
    every = [each for row in by_clause.values() for each in row]
    could = [each for each in every if not each.broken.unseen]
    total = sum(bool(each.caught_by) for each in could)
    lines.append(f"{total} of {len(could)} caught that can be told from outside, {len(every)} in all")
    for each in every:
        if not each.caught_by:
            why = each.broken.unseen or "NO CASE CATCHES IT"
            lines.append(f"not caught: {each.broken.clause} {each.broken.name}: {why}")
        elif each.broken.unseen:
            lines.append(f"caught all the same: {each.broken.clause} {each.broken.name}: {each.caught_by}")
    return lines, wrong


def _order(clause: str) -> tuple[int, ...]:
    return tuple(int(part) for part in clause.split("."))


def _judged(broken: Any, clock: ShiftedClock, every: bool) -> Verdict:
    if isinstance(broken, BrokenCoupler):
        judged = coupler_verdict(broken, clock, every=every)
    else:
        judged = verdict(broken, asked(broken.key, broken.clause, broken.case), every=every)
    print(f"{broken.clause} {broken.name}: {judged.caught_by}", file=sys.stderr, flush=True)
    return judged


def main() -> int:
    """Ask, print, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--coupler", action="store_true", help="of couplers instead of controllers")
    parser.add_argument("--clause", default="", help="only this clause, or all of 5 with 5")
    parser.add_argument("--name", default="", help="only those whose name has this text")
    parser.add_argument("--every", action="store_true", help="all cases that catch it, not the first alone")
    parser.add_argument("--source", action="append", help="only this module's; repeatable")
    parser.add_argument("--part", default="1/1", help="every third, from the first, with 1/3")
    options = parser.parse_args()
    part, parts = (int(number) for number in options.part.split("/"))
    expected = [
        broken
        for broken in (COUPLERS if options.coupler else broken_controllers(options.source or SOURCES))
        if not options.clause or f"{broken.clause}.".startswith(f"{options.clause}.")
        if options.name in broken.name
    ]
    with shifted_clock() as clock:
        lines, wrong = report(_judged(broken, clock, options.every) for broken in expected[part - 1 :: parts])
    print("\n".join(lines))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
