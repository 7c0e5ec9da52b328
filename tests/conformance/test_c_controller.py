"""A controller written in C from the protocol page alone passes the suite; broken ones do not."""

from pathlib import Path

import pytest

from conformance.case import CaseOutcome, Summary
from conformance.runner import reference_cases, run_reference
from tests.conformance.c_controller import COMPILER, SOURCE, SimulatedCController, compiled, running
from tests.conformance.simulated_network import SimulatedNetwork

pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler: apt-get install gcc")
# What the page leaves to a controller is chosen so or otherwise.
SHIPPED, OTHERWISE = "SHIPPED", "OTHERWISE"
CYCLE_MS = {SHIPPED: 5, OTHERWISE: 8}
LIBRARY = ("-shared", "-fPIC")
WITH_A_KEY = set(range(701, 722)) | set(range(723, 741))
# Its arm is a portal: no joint ends at half a turn, nothing is singular; as shipped no first pose is too far.
NO_SUCH_LIMIT = {SHIPPED: {564, 566, 567}, OTHERWISE: {566, 567}}
UNSIGNED = [case.number for case in reference_cases() if case.number not in WITH_A_KEY]


def not_passed(summary: Summary) -> dict[int, str]:
    return {
        r.case.number: f"{r.outcome.value}: {r.detail}"
        for r in summary.results
        if r.outcome is not CaseOutcome.PASS
    }


@pytest.mark.slow("a compiled controller answers the whole suite")
@pytest.mark.parametrize(
    ("choice", "cycle_ms", "in_scan"),
    [
        *((SHIPPED, 5, False), (SHIPPED, 5, True), (SHIPPED, 10, True)),
        *((OTHERWISE, 8, False), (OTHERWISE, 8, True), (OTHERWISE, 5, True)),
    ],
)
def test_in_simulated_time_it_passes_every_case_whatever_it_chooses(
    tmp_path: Path, network: SimulatedNetwork, choice: str, cycle_ms: int, in_scan: bool
) -> None:
    source, cycle = SOURCE.read_text(), f"CYCLE_MS = {CYCLE_MS[choice]},"
    assert cycle in source
    source = source.replace(cycle, f"CYCLE_MS = {cycle_ms},")
    library = compiled(tmp_path, *LIBRARY, f"-D{choice}", source=source)
    with SimulatedCController(library, network, cycle_ms * 1_000_000, in_scan=in_scan) as controller:
        summary = run_reference("127.0.0.1", controller.port, numbers=UNSIGNED, motion=True)
    others = not_passed(summary)
    assert {number: why for number, why in others.items() if number not in NO_SUCH_LIMIT[choice]} == {}
    assert all(others[number].startswith("unsupported") for number in NO_SUCH_LIMIT[choice])
    assert len(summary.results) == len(UNSIGNED)


@pytest.mark.parametrize(
    ("right", "wrong", "case"),
    [
        ("& (PATHS | STREAMING_CAPABILITY)", "& ~0ull", 136),
        ("latch(REFERENCE_LINK_LOST, SEVERITY_STOP, ERROR_RAMP);", "mode = MOVING;", 535),
        ("open_session.heard_ns > LINK_TIMEOUT_MS", "open_session.heard_ns > 2 * LINK_TIMEOUT_MS", 224),
        ("id < s->newest_id", "false", 434),
    ],
)
def test_the_suite_catches_it_when_it_is_broken(
    tmp_path: Path, network: SimulatedNetwork, right: str, wrong: str, case: int
) -> None:
    source = SOURCE.read_text()
    assert right in source
    library = compiled(tmp_path, *LIBRARY, "-Wno-error", source=source.replace(right, wrong))
    with SimulatedCController(library, network) as controller:
        summary = run_reference("127.0.0.1", controller.port, numbers=[101, case], motion=True)
    assert set(not_passed(summary)) == {case}


@pytest.mark.slow("a compiled controller answers the whole suite")
@pytest.mark.realtime
def test_as_a_program_it_passes_a_case_of_each_subject(tmp_path: Path) -> None:
    with running(compiled(tmp_path)) as port:
        summary = run_reference(
            "127.0.0.1", port, numbers=[101, 136, 224, 301, 313, 401, 521, 551, 722], motion=True
        )
    assert not_passed(summary) == {}
