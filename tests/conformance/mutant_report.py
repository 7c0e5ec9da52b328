"""How many broken controllers the suite catches, and by which case.

``python -m tests.conformance.mutant_report`` asks every case of every broken controller, in simulated time,
and prints a line for each clause and for each controller that no case catches. ``--clause 5`` or ``--clause
5.3``: only these; ``--name TEXT``: only those whose name has it; ``--every``: all cases that catch one, not
the first alone. ``--rows FILE``: keep the verdicts there, and take those of the same code from there, so that
a run can be cut short, go on, and be shared by ``--part 1/3`` and its like. It ends with status 1 when one
is not caught for which no reason is written.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from conformance.case import ConformanceCase
from conformance.outcome import GOOD, Result
from conformance.runner import reference_cases, run_reference
from protocol.authentication import LinkKey
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.kept_verdicts import KeptVerdicts
from tests.conformance.simulated_network import simulated

FOR_A_KEY = set(range(701, 722)) | set(range(723, 741))
FOR_NO_KEY = {722}
# They take many datagrams, or much time.
SLOW = {327, 328}
# Each has MUTANTS, a tuple of BrokenController.
SOURCES: tuple[str, ...] = (
    "tests.conformance.mutants.named",
    "tests.conformance.systematic_table",
    "tests.conformance.systematic_fields",
    "tests.conformance.systematic_checks",
    "tests.conformance.systematic_drops",
    "tests.conformance.systematic_answers",
    "tests.conformance.systematic_limits",
    "tests.conformance.systematic_state",
    "tests.conformance.systematic_limits_of_motion",
    "tests.conformance.systematic_motions",
    "tests.conformance.systematic_streams",
)


class BrokenController(NamedTuple):
    """A controller that breaks one clause. ``unseen``: why nobody can tell from outside, if so.

    ``case``: the one meant for it, which is asked first.
    """

    name: str
    clause: str
    make: Callable[[], ControllerUnderTest]
    key: LinkKey | None = None
    unseen: str = ""
    case: int = 0


class Verdict(NamedTuple):
    """The cases that a broken controller did not pass, in the order in which they were asked."""

    broken: BrokenController
    caught_by: tuple[int, ...]


def broken_controllers(sources: Iterable[str] = SOURCES) -> tuple[BrokenController, ...]:
    """All of all sources."""
    return tuple(each for source in sources for each in import_module(source).MUTANTS)


def asked(key: LinkKey | None, clause: str, first: int = 0) -> list[ConformanceCase]:
    """The cases for a controller with or without a key: case ``first``, then those of ``clause``.

    Those that move come last. The slow ones are asked about their own clause only.
    """
    others = FOR_NO_KEY if key else FOR_A_KEY
    wanted = [case for case in reference_cases() if case.number not in others]
    cases = [case for case in wanted if case.number not in SLOW or clause == case.clause]
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


def _judged(broken: BrokenController, kept: KeptVerdicts | None, every: bool) -> Verdict:
    key = broken.clause, broken.name
    caught_by = kept.of(*key) if kept else None
    if caught_by is None:
        first = broken.case or (kept.hint(*key) if kept else 0)
        cases = asked(broken.key, broken.clause, first)
        caught_by = verdict(broken._replace(case=first), cases, every=every).caught_by
        if kept:
            kept.keep(*key, caught_by)
    print(f"{broken.clause} {broken.name}: {caught_by}", file=sys.stderr, flush=True)
    return Verdict(broken, caught_by)


def _wanted(options: argparse.Namespace) -> list[BrokenController]:
    part, parts = (int(number) for number in options.part.split("/"))
    wanted = [
        broken
        for broken in broken_controllers(options.source or SOURCES)
        if not options.clause or f"{broken.clause}.".startswith(f"{options.clause}.")
        if options.name in broken.name
    ]
    return wanted[part - 1 :: parts]


def main() -> int:
    """Ask, print, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clause", default="", help="only this clause, or all of 5 with 5")
    parser.add_argument("--name", default="", help="only those whose name has this text")
    parser.add_argument("--every", action="store_true", help="all cases that catch it, not the first alone")
    parser.add_argument("--source", action="append", help="only this module's; repeatable")
    parser.add_argument("--part", default="1/1", help="every third, from the first, with 1/3")
    parser.add_argument("--rows", type=Path, help="a file that keeps the verdicts")
    options = parser.parse_args()
    kept = KeptVerdicts(options.rows) if options.rows and not options.every else None
    lines, wrong = report(_judged(broken, kept, options.every) for broken in _wanted(options))
    print("\n".join(lines))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
