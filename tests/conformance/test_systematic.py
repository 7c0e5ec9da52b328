"""Controllers that are broken systematically: each is caught by the case that is meant for it."""

from collections.abc import Iterable
from importlib import import_module

import pytest

from conformance.runner import reference_cases
from tests.conformance.mutant_report import SOURCES, BrokenController, verdict

pytestmark = pytest.mark.slow("the suite runs once for every broken controller")

MEANT = {
    source: [broken for broken in import_module(source).MUTANTS if broken.case]
    for source in SOURCES
    if source.rpartition(".")[2].startswith("systematic_")
}


def missed(meant: Iterable[BrokenController]) -> list[str]:
    """The names of those that pass their own case."""
    cases = {case.number: case for case in reference_cases()}
    return [broken.name for broken in meant if not verdict(broken, [cases[broken.case]]).caught_by]


@pytest.mark.parametrize("source", MEANT)
def test_the_first_of_each_case_is_caught_by_it(source: str) -> None:
    first = {broken.case: broken for broken in reversed(MEANT[source])}
    assert missed(first.values()) == []


@pytest.mark.experiment
@pytest.mark.parametrize("source", MEANT)
def test_each_is_caught_by_the_case_meant_for_it(source: str) -> None:
    assert missed(MEANT[source]) == []


@pytest.mark.experiment
@pytest.mark.parametrize("source", MEANT)
def test_each_answers_all_the_same(source: str) -> None:
    """What does not even answer would be caught by any case."""
    control = next(case for case in reference_cases() if case.number == 317)
    assert [broken.name for broken in MEANT[source] if verdict(broken, [control]).caught_by] == []
