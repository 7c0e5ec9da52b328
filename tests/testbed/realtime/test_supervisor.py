"""The supervisor starts, watches and ends processes, and tells why one did not live."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from testbed.realtime.supervisor import Service, ServiceFailed, Supervisor, free_port, supervised

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
            supervisor.start(service("silent"), timeout_s=0.5)
        assert caught.value.cause == "service.not_ready"
    finally:
        assert supervisor.stop() == {"service": 0}


def test_a_stubborn_service_is_killed(tmp_path: Path) -> None:
    supervisor = Supervisor(tmp_path)
    supervisor.start(service("stubborn"))
    child = supervisor.children["service"]
    began = time.monotonic()
    assert child.end(timeout_s=0.3) == -signal.SIGKILL
    assert time.monotonic() - began < 2.0
    assert not alive(child.pid)


def test_services_do_not_outlive_a_killed_supervisor(tmp_path: Path) -> None:
    program = (
        "import time; from pathlib import Path; from testbed.realtime.supervisor import *\n"
        f"s = Supervisor(Path({str(tmp_path)!r}))\n"
        "s.start(Service('x', 'tests.testbed.realtime.child_service', ('good',)))\n"
        "print(s.children['x'].pid, flush=True); time.sleep(60)"
    )
    parent = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    assert alive(pid)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    deadline = time.monotonic() + 5.0
    while alive(pid) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not alive(pid)


def test_free_ports_are_free() -> None:
    import socket

    port = free_port()
    with socket.socket() as server:
        server.bind(("127.0.0.1", port))
        server.listen()
        assert free_port() != port
