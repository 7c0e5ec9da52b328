"""A controller written in C from the protocol page alone passes the suite."""

from pathlib import Path

import pytest

from conformance.runner import reference_cases, run_reference
from tests.conformance.c_controller import COMPILER, SOURCE, SimulatedCController, compiled, ready
from tests.conformance.controllers import not_passed
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


@pytest.mark.slow("a compiled controller answers the whole suite")
@pytest.mark.realtime
def test_as_a_program_it_passes_a_case_of_each_subject(tmp_path: Path) -> None:
    with ready(compiled(tmp_path), "0") as line:
        summary = run_reference(
            "127.0.0.1", line["port"], numbers=[101, 136, 224, 301, 313, 401, 521, 551, 722], motion=True
        )
    assert not_passed(summary) == {}
