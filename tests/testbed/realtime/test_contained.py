"""A service in a container: requests to end are passed on, a crash is noted, its status passed on too."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from foundation import service_main
from foundation.incidents import INCIDENTS, IncidentFile
from testbed.realtime.contained import RECORDS, free_directory

pytestmark = [pytest.mark.realtime, pytest.mark.slow("processes start")]


@contextmanager
def contained(how: str, incidents: Path) -> Iterator[tuple[subprocess.Popen[str], psutil.Process]]:
    """The outer process, and the service in it, which is ready."""
    words = [sys.executable, "-m", "testbed.realtime.contained", "tests.testbed.realtime.child_service", how]
    environment = os.environ | {INCIDENTS: str(incidents)}
    with subprocess.Popen(
        words, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as outer:
        assert outer.stdout is not None
        while "ready" not in outer.stdout.readline():
            assert outer.poll() is None
        try:
            (service,) = psutil.Process(outer.pid).children() or [psutil.Process(outer.pid)]
            yield outer, service
        finally:
            outer.kill()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV])
def test_a_crash_is_noted_and_is_a_failure_to_the_engine(tmp_path: Path, number: signal.Signals) -> None:
    with contained("good", tmp_path / "incidents") as (outer, service):
        service.send_signal(number)
        assert outer.wait(20.0) == 128 + number
    (noted,) = IncidentFile(tmp_path / "incidents").newest()
    assert (noted.service, noted.cause) == ("tests.testbed.realtime.child_service", "service.crashed")
    assert f"crashed with signal {number.name}" in noted.detail


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_end_that_was_asked_for_is_no_crash(tmp_path: Path, number: signal.Signals) -> None:
    with contained("good", tmp_path / "incidents") as (outer, _):
        outer.send_signal(number)
        assert outer.wait(20.0) == (0 if number == signal.SIGTERM else 130)
    assert not (tmp_path / "incidents").exists()


def test_a_service_that_refuses_to_start_has_not_crashed(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "testbed.realtime.contained", "tests.testbed.realtime.child_service"]
    environment = os.environ | {INCIDENTS: str(tmp_path / "incidents")}
    done = subprocess.run([*words, "refuses"], env=environment, capture_output=True, text=True, timeout=20.0)
    assert (done.returncode, "extra inputs" in done.stderr) == (2, True)
    assert not (tmp_path / "incidents").exists()


def test_each_start_records_in_a_directory_of_its_own(tmp_path: Path) -> None:
    assert RECORDS == service_main.RECORDS
    directory = tmp_path / "plant_emulator"
    for name in ("plant_emulator", "plant_emulator.2", "plant_emulator.3"):
        assert free_directory(directory) == tmp_path / name
        (tmp_path / name).mkdir()


def test_a_service_that_fails_by_itself_is_noted_too(tmp_path: Path) -> None:
    with contained("dies", tmp_path / "incidents") as (outer, _):
        assert outer.wait(20.0) == 3
    (noted,) = IncidentFile(tmp_path / "incidents").newest()
    assert "crashed with status 3: its log says why" in noted.detail
