"""A stop in the middle of everything: every route, every attack, with and without a busy loop beside.

``pytest -s tests/integration/test_stop_way.py`` prints how long it takes: p50, p99 and most, in ms.
"""

import contextlib
import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest

from protocol.faults import GroupState
from tests.browser.stop_times import read_scans
from tests.integration.services import Running, running
from tests.support.crash_trials import until_healthy
from tests.support.hostile_http import KINDS
from tests.support.paths import ROOT
from tests.support.patience import PATIENT

pytestmark = [pytest.mark.realtime, pytest.mark.slow("three services start"), pytest.mark.timeout(900)]

QUIET_MS, BUSY_MS = 50.0, 250.0
STOPS = 40
SEED = 20261129
SLOW = (
    "controller.reference_link.link_timeout_ms=20000",
    "plant.watchdog_ms=1000",
    "scene.camera.rate_hz=2",
    "vision.camera.stale_ms=10000",
)
WHICH = [*KINDS, *("drawn",) * 3]


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with running(tmp_path_factory.mktemp("stops"), *PATIENT, *SLOW, by_wall=True) as started:
        until_healthy(started.face)
        until_quick(port_of(started))
        yield started


def until_quick(port: int) -> None:
    """Return once ten stops in a row came in time: services that have just started share the cores."""
    until_s, in_time = time.monotonic() + 60.0, 0
    while in_time < 10:
        in_time = in_time + 1 if stop_ms(port) < BUSY_MS else 0
        assert time.monotonic() < until_s, "no ten stops in a row within the limit, for a minute"
        time.sleep(0.05)


def port_of(rig: Running) -> int:
    return int(rig.launch.rest_url.rpartition(":")[2])


def stop_ms(port: int, kept: http.client.HTTPConnection | None = None) -> float:
    """How long one stop takes to be answered: on a connection of its own, or on one that is kept."""
    connection = kept or http.client.HTTPConnection("127.0.0.1", port, timeout=20.0)
    begun = time.perf_counter()
    connection.request("POST", "/stop")
    answer = connection.getresponse()
    document = json.loads(answer.read())
    took_ms = 1e3 * (time.perf_counter() - begun)
    assert (answer.status, document.get("accepted")) == (200, True), document
    if kept is None:
        connection.close()
    return took_ms


def measured(port: int, count: int = STOPS) -> np.ndarray:
    """Answers to stops at chance intervals, every fourth on a connection that is kept (ms)."""
    draw = np.random.default_rng(SEED)
    kept = http.client.HTTPConnection("127.0.0.1", port, timeout=20.0)
    taken = []
    for number in range(count):
        with contextlib.suppress(ConnectionError, http.client.HTTPException):
            taken.append(stop_ms(port, kept if number % 4 == 3 else None))
            time.sleep(draw.uniform(0.005, 0.05))
            continue
        kept.close()  # it had to make room: it is made anew
    kept.close()
    return np.array(taken)


def judged(what: str, taken_ms: np.ndarray, limit_ms: float) -> None:
    p50, p99 = np.percentile(taken_ms, [50, 99])
    print(f"{what:44} {p50:7.1f} {p99:7.1f} {taken_ms.max():7.1f} ms of {len(taken_ms)}")
    assert p99 <= limit_ms


@contextlib.contextmanager
def attacked(port: int, kind: str, seed: int) -> Iterator[None]:
    attacker = subprocess.Popen(
        [sys.executable, "-m", "tests.support.hostile_http", str(port), kind, str(seed), "20"], cwd=ROOT
    )
    try:
        time.sleep(0.8)  # it starts
        assert attacker.poll() is None
        yield
    finally:
        attacker.kill()
        attacker.wait()


@contextlib.contextmanager
def busy_loop() -> Iterator[None]:
    loop = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        loop.kill()
        loop.wait()


def test_in_peace(rig: Running) -> None:
    quiet = os.getloadavg()[0] < 1.5  # else others have the processor
    judged("in peace", measured(port_of(rig), 100), QUIET_MS if quiet else BUSY_MS)


@pytest.mark.parametrize(("number", "kind"), list(enumerate(WHICH)))
def test_under_attack(rig: Running, number: int, kind: str) -> None:
    """The attacker has a core of the two: it is the busy loop beside."""
    port = port_of(rig)
    with attacked(port, kind, SEED + number):
        judged(f"{kind} {number}", measured(port), BUSY_MS)
    assert rig.face.get("/state").json()["fault"] == "none"


def test_beside_a_busy_loop(rig: Running) -> None:
    with contextlib.ExitStack() as stack:
        for _ in range(os.cpu_count() or 1):
            stack.enter_context(busy_loop())
        judged("beside a busy loop for each core", measured(port_of(rig), 100), BUSY_MS)


def test_in_the_middle_of_every_route(rig: Running) -> None:
    port, taken = port_of(rig), []
    document = rig.face.get("/openapi.json").json()
    for path, methods in document["paths"].items():
        for method in methods.keys() - {"delete"}:
            asking = socket.create_connection(("127.0.0.1", port), timeout=20.0)
            asked = path.replace("{operation_id}", "none").replace("{target_id}", "none")
            request = f"{method.upper()} {asked} HTTP/1.1\r\nHost: localhost\r\nContent-Length: 2\r\n\r\n{{}}"
            asking.sendall(request.encode())
            time.sleep(0.005)
            taken.append(stop_ms(port))
            asking.close()
            assert path.startswith("/emergency") or not rig.face.get("/state").json()["emergency_latched"]
            if path == "/emergency-stop":
                assert rig.face.post("/emergency-release").is_success
                assert rig.face.post("/reset").is_success
    judged("in the middle of every route", np.array(taken), BUSY_MS)


def moving(face: httpx.Client, dy_m: float) -> None:
    """Return once a motion is under way."""
    until_s = time.monotonic() + 20.0
    while face.get("/state").json()["group_state"] != "standby":
        answer = face.post("/enable")  # refused while services that have just started still find each other
        assert time.monotonic() < until_s, answer.text
        time.sleep(0.2)
    operation = face.post("/operations/move", json={"offset_base_m": [0, dy_m, 0], "duration_s": 20.0})
    assert operation.is_success, operation.text
    while face.get("/state").json()["group_state"] != "moving":
        assert time.monotonic() < until_s, face.get(operation.headers["Location"]).text
        time.sleep(0.02)


def test_the_arm_stops_whatever_holds_the_vision_pc_up(tmp_path: Path) -> None:
    """By every scan of the controller: among tiny chunks, and while the vision PC stands still."""
    asked_ns: dict[str, int] = {}
    with running(tmp_path, *PATIENT, *SLOW, by_wall=True) as rig:
        port = port_of(rig)
        until_healthy(rig.face)
        moving(rig.face, 0.3)
        with attacked(port, "tiny_chunks", SEED):
            asked_ns["tiny chunks"] = time.monotonic_ns()
            assert stop_ms(port) < 1e3
        assert {each["state"] for each in rig.face.get("/operations").json()} <= {"cancelled", "failed"}
        moving(rig.face, -0.3)
        vision = rig.supervisor.children["vision_pc"].pid
        os.kill(vision, signal.SIGSTOP)
        try:
            asked_ns["the vision PC stands still"] = time.monotonic_ns()
            answering = threading.Thread(target=stop_ms, args=(port,))
            answering.start()
            time.sleep(0.7)
        finally:
            os.kill(vision, signal.SIGCONT)
        answering.join(20.0)
    scans = read_scans(next(tmp_path.rglob("controller.mcap")))
    for what, at_ns in asked_ns.items():
        seen = scans.times_ns[(scans.times_ns > at_ns) & (scans.states == GroupState.STOPPING)]
        took_ms = 1e-6 * (seen[0] - at_ns)
        print(f"{what}: the first scan that stops, {took_ms:.0f} ms after it was asked")
        assert took_ms < BUSY_MS
