"""The controller in structured text and the suite, in simulated time, the emulated plant beneath it."""

import pytest

from conformance.case import CaseOutcome, Summary
from conformance.runner import reference_cases, run_reference
from tests.conformance.simulated_network import SimulatedNetwork
from tests.controller_st.suite import SimulatedTextController

WITH_A_KEY = set(range(701, 741)) - {722}
UNSIGNED = [case.number for case in reference_cases() if case.number not in WITH_A_KEY]


def not_passed(summary: Summary) -> dict[int, str]:
    return {
        r.case.number: f"{r.outcome.value}: {r.detail}"
        for r in summary.results
        if r.outcome is not CaseOutcome.PASS
    }


@pytest.mark.timeout(900)
@pytest.mark.slow("every case, with the plant's physics")
@pytest.mark.parametrize("in_scan", [False, True], ids=["on arrival", "in the scan"])
def test_it_passes_every_unsigned_case_with_the_plant_beneath(
    network: SimulatedNetwork, in_scan: bool
) -> None:
    with SimulatedTextController(network, in_scan=in_scan) as controller:
        summary = run_reference("127.0.0.1", controller.port, numbers=UNSIGNED, motion=True)
    assert not_passed(summary) == {}
    assert len(summary.results) == len(UNSIGNED)
    assert list(controller.controller.faults) == []


@pytest.mark.slow("a case of each subject, with the plant's physics")
def test_it_passes_a_case_of_each_subject(network: SimulatedNetwork) -> None:
    numbers = [101, 203, 224, 301, 313, 401, 415, 521, 533, 551, 566, 575, 722, 801]
    with SimulatedTextController(network) as controller:
        summary = run_reference("127.0.0.1", controller.port, numbers=numbers, motion=True)
    assert not_passed(summary) == {}
