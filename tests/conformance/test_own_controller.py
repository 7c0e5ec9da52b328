"""The suite against our own controller, in simulated time and as a process: every case passes."""

import sys
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import Any

import pytest

from conformance.parts import OptionalPart
from conformance.runner import reference_cases, run_reference
from foundation.secret_source import key_from_file
from tests.conformance.c_controller import ready
from tests.conformance.controllers import ControllerUnderTest, not_passed
from tests.support.paths import CONFIGS

# Cases about authentication; test_key_suite asks them.
WITH_A_KEY = set(range(701, 741)) - {722}


def service(module: str, *overrides: str) -> AbstractContextManager[dict[str, Any]]:
    """What a service says when it is ready; it is ended at the end."""
    return ready(sys.executable, "-m", module, "--config-dir", str(CONFIGS), "--set", *overrides)


@pytest.mark.slow("every case of the suite")
@pytest.mark.usefixtures("network")
def test_our_own_controller_passes_every_case_in_simulated_time() -> None:
    numbers = [case.number for case in reference_cases() if case.number not in WITH_A_KEY]
    with ControllerUnderTest() as controller:
        summary = run_reference("127.0.0.1", controller.port, numbers=numbers, motion=True)
    assert not_passed(summary) == {}
    assert len(summary.results) == len(numbers)
    assert summary.passed


@pytest.mark.experiment
@pytest.mark.timeout(400)
@pytest.mark.parametrize(
    ("module", "authenticated"),
    [("controller", False), ("controller", True), ("controller_st", False)],
    ids=["plain", "authenticated", "in structured text"],
)
def test_our_own_controller_passes_every_case(module: str, authenticated: bool, tmp_path: Path) -> None:
    key_file = tmp_path / "link.key"
    key_file.write_text("b7" * 32)
    key_file.chmod(0o600)
    with ExitStack() as stack:
        plant = stack.enter_context(
            service(
                "plant_emulator",
                "plant_service.modbus.port=0",
                "plant_service.camera_stream.port=0",
                "plant_service.fault_face.port=0",
            )
        )
        controller = stack.enter_context(
            service(
                module,
                f"controller.plant_link.port={plant['modbus']['port']}",
                "controller.reference_link.port=0",
                "controller.reference_link.link_timeout_ms=250",
                *([f"controller.reference_link.link_key.file={key_file}"] if authenticated else []),
            )
        )
        summary = run_reference(
            "127.0.0.1",
            controller["reference_link"]["port"],
            motion=True,
            key=key_from_file(key_file) if authenticated else None,
        )
    others = {number: why for number, why in not_passed(summary).items() if not why.startswith("flaky")}
    # Of authentication all cases, or the one about its absence, are not for this controller.
    part = OptionalPart.KEY_REFUSAL if authenticated else OptionalPart.AUTHENTICATION
    other = {case.number for case in reference_cases() if part in case.needs}
    assert set(others) == other
    assert all(why.startswith("unsupported") for why in others.values())
