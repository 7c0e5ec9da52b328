"""Broken couplers against the coupler's suite, and the page's clauses against its cases and these couplers.

The couplers that an attack from outside found alive are asked at every run; all of them, by rule, as a long
experiment (``python -m tests.conformance.coupler_mutant_report`` prints the same by clause).
"""

import re

import pytest

from conformance.case import CaseOutcome
from conformance.coupler.unasked import UNASKED
from conformance.runner import coupler_cases, run_coupler
from tests.conformance.coupler.page_server import PageServer
from tests.conformance.coupler.rules import Rules
from tests.conformance.coupler.systematic import MUTANTS
from tests.conformance.coupler_mutant_report import shifted_clock, verdict
from tests.conformance.couplers import ShiftedClock
from tests.conformance.mutant_report import report
from tests.support.paths import DOCS

BY_NAME = {f"{each.clause} {each.name}": each for each in MUTANTS}
CONTROL = 601
# Once every case passed each of these.
ONCE_ALIVE = {
    "5.4 keeps at expiry the outputs that are analog": 886,
    "2.9 23 writes although refused with 3": 857,
    "2.9 15 writes although refused with 2": 857,
    "2.9 -32768 is refused in 0 words from 0x0802 on": 915,
    "2.2 watchdog before all": 891,
    "2.2 owner right after function": 865,
    "5.3 trigger 1: fed by refused 3": 878,
    "5.3 trigger 0: fed by 4": 877,
    "1.2 unit 1 in answers 0x83": 802,
    "2.6 sub-function 2 is frames": 889,
    "2.6 does not count frames": 823,
    "2.6 sub-function 14 is frames": 821,
    "3.1 read with 4: lacks 0x1000": 831,
    "3.1 written with 16: lacks 0x1120": 856,
    "5.5 begins_anew is False": 895,
    "5.3 its time is 1.4 times": 871,
    "4.3 not released by silence": 868,
    "2.9 a torn image acts": 914,
    "2.9 -32768 is taken in a torn image": 915,
}


@pytest.mark.slow("a whole suite over sockets")
def test_a_coupler_written_from_the_page_passes_every_case(clock: ShiftedClock) -> None:
    with PageServer(Rules(), clock) as server:
        summary = run_coupler("127.0.0.1", server.port, outputs=True)
    bad = [(r.case.number, r.outcome, r.detail) for r in summary.results if r.outcome is not CaseOutcome.PASS]
    assert bad == []
    assert len(summary.results) == len(coupler_cases()) > 160


@pytest.mark.parametrize("name", ONCE_ALIVE)
def test_a_coupler_that_once_passed_is_caught(name: str, clock: ShiftedClock) -> None:
    with PageServer(BY_NAME[name].rules, clock) as server:
        numbers = [CONTROL, ONCE_ALIVE[name]]
        summary = run_coupler("127.0.0.1", server.port, numbers=numbers, outputs=True)
    assert [result.outcome for result in summary.results] == [CaseOutcome.PASS, CaseOutcome.FAIL]


def test_every_clause_has_a_case_and_a_broken_coupler_or_a_reason() -> None:
    page = (DOCS / "process_image.md").read_text() + (DOCS / "protocol.md").read_text().split("## 10 ")[1]
    clauses = set(re.findall(r"^\*\*((?:[1-5]|10)\.\d+)\*\*", page, re.MULTILINE))
    asked = {case.clause for case in coupler_cases()}
    broken = {each.clause for each in MUTANTS}
    assert asked | broken <= clauses
    assert len(clauses) == 39
    unasked = clauses - (asked & broken)
    assert unasked == {"10.1", "10.2", "10.8"} <= {each.clause for each in UNASKED} <= clauses


def test_broken_couplers_have_names_of_their_own() -> None:
    assert len(BY_NAME) == len(MUTANTS) > 600


@pytest.mark.experiment
@pytest.mark.timeout(0)
def test_every_broken_coupler_is_caught_or_cannot_be_told_from_a_sound_one() -> None:
    with shifted_clock() as clock:
        lines, wrong = report(verdict(each, clock) for each in MUTANTS)
    print("\n".join(lines))
    assert wrong == []
