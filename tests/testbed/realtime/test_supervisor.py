"""The supervisor starts, watches and ends processes, and tells why one did not live."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from foundation.incidents import IncidentFile
from testbed.realtime.child import INCIDENT_FILE, Child, Service, ServiceFailed
from testbed.realtime.supervisor import Supervisor, supervised

pytestmark = pytest.mark.realtime


def service(how: str, name: str = "service") -> Service:
    return Service(name, "tests.testbed.realtime.child_service", (how,))


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_ready_services_are_ended_by_sigterm_in_reverse_order(tmp_path: Path) -> None:
    with supervised([service("good", "first"), service("good", "second")], tmp_path) as supervisor:
        pids = [child.pid for child in supervisor.children.values()]
        assert supervisor.children["first"].ready == {"event": "ready", "port": 1234}
        supervisor.watch(0.3)
        assert all(map(alive, pids))
        assert supervisor.stop() == {"second": 0, "first": 0}
    assert not any(map(alive, pids))


def test_a_service_that_refuses_to_start_is_quoted(tmp_path: Path) -> None:
    quoted = r"second ended before .* status 2: configuration\.unknown_key: plant\.yaml"
    services = [service("good", "first"), service("refuses", "second")]
    with pytest.raises(ServiceFailed, match=quoted) as caught, supervised(services, tmp_path):
        pytest.fail("the block must not be entered")
    assert caught.value.cause == "service.exited"
    assert "extra inputs" in (tmp_path / "second.log").read_text()


def test_a_service_that_dies_later_is_noticed_and_quoted(tmp_path: Path) -> None:
    quoted = r"ended by itself with status 3: oil\.lost: the pump ran dry"
    with supervised([service("dies")], tmp_path) as supervisor, pytest.raises(ServiceFailed, match=quoted):
        supervisor.watch(10.0, interval_s=0.02)


def test_a_service_that_says_nothing_is_not_waited_for_for_ever(tmp_path: Path) -> None:
    supervisor = Supervisor(tmp_path)
    try:
        with pytest.raises(ServiceFailed) as caught:
            supervisor.start(service("silent"), say=print, timeout_s=0.5)
        assert caught.value.cause == "service.not_ready"
    finally:  # on a busy machine it may not even have begun to listen to signals
        assert supervisor.stop()["service"] in (0, -signal.SIGTERM)


def test_a_stubborn_service_is_killed(tmp_path: Path) -> None:
    supervisor = Supervisor(tmp_path)
    supervisor.start(service("stubborn"), say=print)
    child = supervisor.children["service"]
    assert child.end(timeout_s=0.3) == -signal.SIGKILL
    assert not alive(child.pid)


@pytest.mark.slow("starts processes and waits for their end")
def test_services_do_not_outlive_a_killed_supervisor(tmp_path: Path) -> None:
    program = (
        "import time; from pathlib import Path; from testbed.realtime.child import *\n"
        "from testbed.realtime.supervisor import *\n"
        f"s = Supervisor(Path({str(tmp_path)!r}))\n"
        "s.start(Service('x', 'tests.testbed.realtime.child_service', ('good',)), say=str)\n"
        "print(s.children['x'].pid, flush=True); time.sleep(60)"
    )
    parent = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    assert alive(pid)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    deadline = time.monotonic() + 60.0
    while alive(pid) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not alive(pid)


def told_until(supervisor: Supervisor, wanted: str, within_s: float) -> list[str]:
    lines: list[str] = []
    until_s = time.monotonic() + within_s
    while time.monotonic() < until_s and not any(wanted in line for line in lines):
        supervisor.watch(0.1, interval_s=0.02, tell=lambda _at_s, said: lines.append(said))
    return lines


@pytest.mark.slow("services start and crash")
def test_a_service_that_crashes_is_started_anew_alone(tmp_path: Path) -> None:
    recorded = Service("second", "tests.testbed.realtime.child_service", ("good", "--record-dir", "out"))
    with supervised([service("good", "first"), recorded], tmp_path) as supervisor:
        first, second = (child.pid for child in supervisor.children.values())
        os.kill(second, signal.SIGSEGV)
        crashed, ready = told_until(supervisor, "ready again", 20.0)
        anew = supervisor.children["second"]
        assert crashed == "second crashed with signal SIGSEGV (a fault in compiled code)"
        assert ready == f"second is ready again: process {anew.pid}; the arm stays disabled"
        assert supervisor.children["first"].pid == first
        assert anew.pid != second
        assert anew.arguments == ("good", "--record-dir", "out.2")
        assert (tmp_path / "second.2.log").exists()
    (noted,) = IncidentFile(tmp_path / INCIDENT_FILE).newest()
    assert (noted.service, noted.cause) == ("second", "service.crashed")
    assert noted.detail == f"{crashed}; it is started anew"


def test_one_that_is_asked_to_end_has_not_crashed_and_one_that_is_never_ready_again_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never_ready(*_: object) -> None:
        raise ServiceFailed("service.not_ready", "second in 900 s: it said nothing")

    with supervised([service("good", "second")], tmp_path) as supervisor:
        monkeypatch.setattr(Child, "wait_ready", never_ready)
        os.kill(supervisor.children["second"].pid, signal.SIGTERM)
        with pytest.raises(ServiceFailed, match="said nothing"):
            told_until(supervisor, "never", 20.0)
    (noted,) = IncidentFile(tmp_path / INCIDENT_FILE).newest()
    assert noted.detail.startswith("second ended with status 0")


@pytest.mark.slow("a service starts three times")
def test_a_service_that_crashes_at_every_start_ends_all_too(tmp_path: Path) -> None:
    with supervised([service("dies")], tmp_path) as supervisor:
        quoted = r"^3 crashes within a minute.* service crashed with status 3: oil\.lost: the pump ran dry"
        with pytest.raises(ServiceFailed, match=quoted):
            told_until(supervisor, "never", 20.0)


def test_a_full_disk_loses_lines_and_not_the_service(tmp_path: Path) -> None:
    (tmp_path / "service.log").symlink_to("/dev/full")
    with supervised([service("complains")], tmp_path) as supervisor:
        told = told_until(supervisor, "oil", 10.0)
        supervisor.check()
    assert told[0].endswith("No space left on device; further lines are not kept")
    assert told[1:] == ["service: oil.low: the tank is half empty"]
