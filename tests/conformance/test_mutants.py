"""Broken controllers and couplers: each is caught by the case that its row names."""

import re
from collections.abc import Callable

import pytest

from conformance.case import CaseOutcome
from conformance.runner import coupler_cases, reference_cases, run_coupler, run_reference
from tests.conformance import named_edits, named_hooks
from tests.conformance import systematic_motions as motions
from tests.conformance import systematic_state as state
from tests.conformance import systematic_streams as streams
from tests.conformance import systematic_table as table
from tests.conformance.classes import mutants as classes
from tests.conformance.coupler_mutants import MUTANTS as COUPLERS
from tests.conformance.coupler_mutants import CouplerMutant
from tests.conformance.couplers import ShiftedClock
from tests.conformance.mutator import BrokenController
from tests.conformance.simulated_network import simulated
from tests.support.paths import DOCS

SOURCES = {
    source.__name__: source.MUTANTS
    for source in (named_edits, named_hooks, classes, table, state, motions, streams)
}
NAMED = (named_edits.__name__, named_hooks.__name__, classes.__name__)
CONTROL = 317


class _FellOver(Exception):
    """The controller has ended by an exception."""


def _guarded(turn: Callable[[], None]) -> Callable[[], None]:
    def guarded() -> None:
        try:
            turn()
        except Exception as fault:
            raise _FellOver from fault

    return guarded


def caught(broken: BrokenController, number: int) -> bool:
    """Whether the case fails; a controller that ends by an exception or leaves the link is caught too."""
    try:
        with simulated(), broken.make() as controller:
            controller.turn = _guarded(controller.turn)  # type: ignore[method-assign]
            port, key = controller.port, broken.key
            summary = run_reference("127.0.0.1", port, numbers=[number], motion=True, key=key, seed=1)
    except _FellOver:
        return True
    return summary.ended is not None or summary.results[0].outcome.value not in ("pass", "flaky")


@pytest.mark.slow("the suite runs once for every broken controller")
@pytest.mark.parametrize("source", SOURCES)
def test_the_first_of_each_case_is_caught_by_it(source: str) -> None:
    mutants = SOURCES[source]
    first = {broken.case: broken for broken in reversed(mutants)}
    asked = mutants if source in NAMED else first.values()
    assert [broken.name for broken in asked if not caught(broken, broken.case)] == []


@pytest.mark.experiment
@pytest.mark.parametrize("source", SOURCES)
def test_each_is_caught_by_the_case_meant_for_it_and_answers_all_the_same(source: str) -> None:
    mutants = SOURCES[source]
    assert [broken.name for broken in mutants if not caught(broken, broken.case)] == []
    # What does not even answer would be caught by any case.
    assert [broken.name for broken in mutants if broken.case != CONTROL and caught(broken, CONTROL)] == []


def test_every_case_of_a_key_and_of_the_table_has_a_broken_controller() -> None:
    broken = {each.case for mutants in SOURCES.values() for each in mutants}
    of_a_key = {case.number for case in reference_cases() if 700 < case.number < 800}
    # 720 is refused by its length; 722 is for those without a key.
    assert of_a_key - {720, 722, *range(731, 741)} <= broken
    assert {
        case.number for case in reference_cases() if case.clause == "7.3" and case.number > 799
    } - broken == set()


@pytest.mark.slow("a hundred couplers over sockets, one case each")
@pytest.mark.parametrize("mutant", COUPLERS, ids=lambda mutant: f"{mutant.case} {mutant.name}")
def test_a_broken_coupler_is_caught_by_the_case_meant_for_it(
    mutant: CouplerMutant, clock: ShiftedClock
) -> None:
    with mutant.make(clock) as coupler:
        summary = run_coupler("127.0.0.1", coupler.port, numbers=[mutant.case], outputs=True)
    assert [result.outcome for result in summary.results] == [CaseOutcome.FAIL]


def test_every_case_of_a_coupler_has_a_mutant_and_every_clause_a_case_or_a_reason() -> None:
    assert {case.number for case in coupler_cases()} == {mutant.case for mutant in COUPLERS}
    page = (DOCS / "process_image.md").read_text() + (DOCS / "protocol.md").read_text().split("## 10 ")[1]
    clauses = set(re.findall(r"^\*\*((?:[1-5]|10)\.\d+)\*\*", page, re.MULTILINE))
    assert clauses - {case.clause for case in coupler_cases()} == {"10.1", "10.2", "10.8"}
