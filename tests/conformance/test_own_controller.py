"""The suite against our own controller and plant as processes on real sockets: every case passes."""

import json
import selectors
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from testbed.conformance.case import Outcome
from testbed.conformance.runner import run_reference

ROOT = Path(__file__).parents[2]
START_S = 90.0


@contextmanager
def service(module: str, *overrides: str) -> Iterator[dict[str, Any]]:
    """What a service says when it is ready; it is ended at the end."""
    command = [sys.executable, "-m", module, "--config-dir", str(ROOT / "configs"), "--set", *overrides]
    process = subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert process.stdout is not None
    try:
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            assert selector.select(START_S), f"{module} is not ready after {START_S:g} s"
        yield json.loads(process.stdout.readline())
    finally:
        process.terminate()
        assert process.wait(10.0) == 0
        process.stdout.close()


@pytest.mark.experiment
@pytest.mark.timeout(300)
def test_our_own_controller_passes_every_case() -> None:
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
                "controller",
                f"controller.plant_link.port={plant['modbus']['port']}",
                "controller.reference_link.port=0",
                "controller.reference_link.link_timeout_ms=250",
            )
        )
        summary = run_reference("127.0.0.1", controller["reference_link"]["port"], motion=True)
    assert [
        (r.case.number, r.outcome.value, r.detail) for r in summary.results if r.outcome is not Outcome.PASS
    ] == []
