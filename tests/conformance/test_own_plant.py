"""The coupler's suite against our own coupler, in a thread and as a process: every case passes."""

import pytest

from conformance.runner import coupler_cases, run_coupler
from tests.conformance.controllers import not_passed
from tests.conformance.couplers import ThreadedCoupler


@pytest.mark.slow("every case of the suite")
@pytest.mark.realtime
@pytest.mark.usefixtures("clock")
def test_our_own_coupler_passes_every_case() -> None:
    with ThreadedCoupler() as coupler:
        summary = run_coupler("127.0.0.1", coupler.port, outputs=True)
    assert not_passed(summary) == {}
    assert len(summary.results) == len(coupler_cases()) == 50
