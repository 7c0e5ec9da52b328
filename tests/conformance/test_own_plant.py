"""The coupler's suite against our own plant as a process on real sockets: every case passes."""

import pytest

from conformance.outcome import GOOD
from conformance.runner import run_coupler
from tests.conformance.test_own_controller import service


@pytest.mark.experiment
@pytest.mark.timeout(300)
def test_our_own_plant_passes_every_case() -> None:
    with service(
        "plant_emulator",
        "plant_service.modbus.port=0",
        "plant_service.camera_stream.port=0",
        "plant_service.fault_face.port=0",
    ) as plant:
        summary = run_coupler("127.0.0.1", plant["modbus"]["port"], outputs=True)
    assert [
        (r.case.number, r.outcome.value, r.detail) for r in summary.results if r.outcome not in GOOD
    ] == []
