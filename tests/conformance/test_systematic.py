"""Controllers that are broken systematically: each is caught by the case that is meant for it."""

from importlib import import_module

import pytest

from conformance.runner import reference_cases
from tests.conformance.mutant_report import SOURCES, verdict

WITH_A_CASE = [source for source in SOURCES if source.rpartition(".")[2].startswith("systematic_")]


@pytest.mark.parametrize("source", WITH_A_CASE)
def test_each_is_caught_by_the_case_meant_for_it(source: str) -> None:
    cases = {case.number: case for case in reference_cases()}
    meant = [broken for broken in import_module(source).MUTANTS if broken.case]
    missed = [broken.name for broken in meant if not verdict(broken, [cases[broken.case]]).caught_by]
    assert missed == []
