"""Broken controllers and couplers: each is caught by some case, or it is said why none can.

The couplers that an attack from outside found alive are asked at every run of the laboratory; all broken
ones as a long experiment (``python -m tests.conformance.mutant_report`` prints the same by clause).
"""

import re
from collections.abc import Iterable
from importlib import import_module

import pytest

from conformance.case import CaseOutcome
from conformance.coupler import UNASKED
from conformance.runner import coupler_cases, reference_cases, run_coupler
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.coupler.page_server import PageServer
from tests.conformance.coupler.rules import Rules
from tests.conformance.couplers import ShiftedClock
from tests.conformance.mutant_report import (
    COUPLERS,
    SOURCES,
    Verdict,
    asked,
    broken_controllers,
    coupler_verdict,
    report,
    shifted_clock,
    verdict,
)
from tests.conformance.mutator import BrokenController, edited
from tests.support.paths import DOCS

MEANT = {source: [each for each in import_module(source).MUTANTS if each.case] for source in SOURCES}
NAMED = [source for source in SOURCES if ".named_" in source]
COUPLER_BY_NAME = {f"{each.clause} {each.name}": each for each in COUPLERS}
CONTROL, COUPLER_CONTROL = 317, 601
NO_MAGIC = BrokenController("no magic", "3.5", edited(("datagram", "if magic != MAGIC:", "if False:")))
# Couplers, each with the case that must find it; once every case passed those of the second part.
COUPLERS_MEANT = {
    "2.1 refuses under 0x80": 612, "2.5 0x1234 switches on": 619, "2.1 serves 7": 610,
    "2.8 reads before it writes": 655, "2.4 16 with any byte count": 812, "3.5 3 reads gaps": 638,
    "2.9 23 writes although refused with 2": 657, "2.7 answer of 6 low byte apart": 651,
    "2.6 echoes zeros": 621, "3.6 6 writes 7 at 0x1000": 640, "4.2 strangers write with or to 6": 661,
    "4.3 not released by close": 664, "5.7 an owner's closing stops": 695, "5.3 its time is twice": 674,
    "5.3 its time is half": 676, "5.4 expiry ended by 8": 890, "5.4 serves after expiry 3": 683,
    "5.2 armed by 3": 672, "5.3 a stranger feeds by 3": 879, "5.1 set while active, answered 0": 681,
    "5.5 reset by first": 688, "5.5 reset by second": 689, "5.5 reset by any order": 690,
    "5.5 of_one_master is False": 692, "5.4 keeps at expiry the outputs that are analog": 886,
    "2.9 23 writes although refused with 3": 857, "2.9 15 writes although refused with 2": 857,
    "2.9 -32768 is refused in 0 words from 0x0802 on": 915, "2.2 watchdog before all": 891,
    "2.2 owner right after function": 865, "5.3 trigger 1: fed by refused 3": 878,
    "5.3 trigger 0: fed by 4": 877, "1.2 unit 1 in answers 0x83": 802, "2.6 sub-function 2 is frames": 889,
    "2.6 does not count frames": 823, "2.6 sub-function 14 is frames": 821,
    "3.1 read with 4: lacks 0x1000": 831, "3.1 written with 16: lacks 0x1120": 856,
    "5.5 begins_anew is False": 895, "5.3 its time is 1.4 times": 871, "4.3 not released by silence": 868,
    "3.1 23 delivers double words high word first": 924, "3.1 4 delivers the sign of each word lost": 924,
    "10.6 23 reads inputs of the request before": 925, "10.6 4 reads inputs of the request before": 925,
    "2.9 a torn image acts": 914, "2.9 -32768 is taken in a torn image": 915,
}  # fmt: skip


def missed(meant: Iterable[BrokenController]) -> list[str]:
    """The names of those that pass their own case."""
    cases = {case.number: case for case in reference_cases()}
    return [broken.name for broken in meant if not verdict(broken, [cases[broken.case]]).caught_by]


@pytest.mark.slow("the suite runs once for every broken controller")
@pytest.mark.parametrize("source", MEANT)
def test_the_first_of_each_case_is_caught_by_it(source: str) -> None:
    first = {broken.case: broken for broken in reversed(MEANT[source])}
    assert missed(MEANT[source] if source in NAMED else first.values()) == []


@pytest.mark.experiment
@pytest.mark.parametrize("source", MEANT)
def test_each_is_caught_by_the_case_meant_for_it_and_answers_all_the_same(source: str) -> None:
    assert missed(MEANT[source]) == []
    # What does not even answer would be caught by any case.
    control = next(case for case in reference_cases() if case.number == CONTROL)
    assert [broken.name for broken in MEANT[source] if verdict(broken, [control]).caught_by] == []


@pytest.mark.experiment
@pytest.mark.timeout(0)
def test_every_broken_controller_is_caught_or_it_is_said_why_not() -> None:
    verdicts = [verdict(each, asked(each.key, each.clause, each.case)) for each in broken_controllers()]
    lines, wrong = report(verdicts)
    print("\n".join(lines))
    assert wrong == []


def test_every_clause_that_is_asked_for_and_every_case_of_a_key_has_a_broken_controller() -> None:
    broken = broken_controllers()
    assert {case.clause for case in reference_cases()} <= {each.clause for each in broken if not each.unseen}
    of_a_key = {case.number for case in reference_cases() if 700 < case.number < 800}
    # 710 and 712 need two faults at once; 720 is refused by its length; 722 is for those without a key.
    others = {710, 712, 720, 722, *range(731, 741)}
    assert of_a_key - others <= {each.case for each in broken if each.key}


def test_no_two_broken_ones_have_one_name() -> None:
    names = [(each.clause, each.name) for each in broken_controllers()]
    assert len(set(names)) == len(names)
    assert len(COUPLER_BY_NAME) == len(COUPLERS) > 600


def test_a_case_that_the_controller_passes_does_not_catch_it() -> None:
    cases = [case for case in reference_cases() if case.number in (101, 102, 103)]
    assert verdict(NO_MAGIC, cases, every=True).caught_by == (102,)
    assert verdict(NO_MAGIC, cases[::2]).caught_by == ()


def test_a_controller_that_falls_over_is_caught() -> None:
    class FallsOver(ControllerUnderTest):
        def turn(self) -> None:
            raise ZeroDivisionError

    broken = BrokenController("falls over", "3.1", FallsOver)
    assert verdict(broken, asked(None, "3.1")).caught_by == (101,)


def test_the_report_counts_by_clause_and_names_what_is_not_as_it_should_be() -> None:
    def of(name: str, unseen: str, *caught_by: int) -> Verdict:
        return Verdict(BrokenController(name, "5.3", ControllerUnderTest, unseen=unseen), caught_by)

    lines, wrong = report([of("a", "", 313), of("b", "has no effect"), of("c", ""), of("d", "nobody", 314)])
    assert lines[1].split() == ["5.3", "4", "2", "1", "313,", "314"]
    assert [each.broken.name for each in wrong] == ["c", "d"]
    assert any("b: has no effect" in line for line in lines)
    assert any("c: NO CASE CATCHES IT" in line for line in lines)


@pytest.mark.slow("a whole suite over sockets")
def test_a_coupler_written_from_the_page_passes_every_case(clock: ShiftedClock) -> None:
    with PageServer(Rules(), clock) as server:
        summary = run_coupler("127.0.0.1", server.port, outputs=True)
    bad = [(r.case.number, r.outcome, r.detail) for r in summary.results if r.outcome is not CaseOutcome.PASS]
    assert bad == []
    assert len(summary.results) == len(coupler_cases()) > 160


@pytest.mark.parametrize("name", COUPLERS_MEANT)
def test_a_broken_coupler_is_caught_by_the_case_meant_for_it(name: str, clock: ShiftedClock) -> None:
    with PageServer(COUPLER_BY_NAME[name].rules, clock) as server:
        numbers = [COUPLER_CONTROL, COUPLERS_MEANT[name]]
        summary = run_coupler("127.0.0.1", server.port, numbers=numbers, outputs=True)
    assert [result.outcome for result in summary.results] == [CaseOutcome.PASS, CaseOutcome.FAIL]


def test_every_clause_of_the_coupler_has_a_case_and_a_broken_coupler_or_a_reason() -> None:
    page = (DOCS / "process_image.md").read_text() + (DOCS / "protocol.md").read_text().split("## 10 ")[1]
    clauses = set(re.findall(r"^\*\*((?:[1-5]|10)\.\d+)\*\*", page, re.MULTILINE))
    cases = {case.clause for case in coupler_cases()}
    broken = {each.clause for each in COUPLERS}
    assert cases | broken <= clauses
    assert len(clauses) == 39
    unasked = clauses - (cases & broken)
    assert unasked == {"10.1", "10.2", "10.8"} <= {each.clause for each in UNASKED} <= clauses


@pytest.mark.experiment
@pytest.mark.timeout(0)
def test_every_broken_coupler_is_caught_or_cannot_be_told_from_a_sound_one() -> None:
    with shifted_clock() as clock:
        lines, wrong = report(coupler_verdict(each, clock) for each in COUPLERS)
    print("\n".join(lines))
    assert wrong == []
