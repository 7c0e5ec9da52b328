"""A service killed within a motion, three real processes: it alone is started anew, nothing moves by itself.

One of each here; ten of each, with a table, by ``make experiments ARGS="-k crashes"``.
"""

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import httpx
import numpy as np
import pytest

from testbed.realtime.launch import CONTROLLER, PLANT, VISION, prepare
from testbed.realtime.supervisor import Supervisor, supervised
from testbed.reporting.console import out, table
from testbed.scenarios.scenario import chosen_overrides
from tests.support.paths import CONFIGS

READY_S = 90.0  # of a service, and of all links, on a busy machine
HOLD_S = 1.5  # watched after everything is ready again
LEAK_M = 0.02  # a disabled arm sinks by less in that time
MORE_THAN_ALL = 100  # crashes: the trials come quicker than crashes of one cause
SERVICES = (PLANT, CONTROLLER, VISION)


class CrashTrial(NamedTuple):
    """One crash. ``ready_s``: from the signal until vision is healthy again. ``moved_mm``: of the tool in the
    time watched after that. ``valves``: the largest command then, of 1. ``pids_kept``: the other two live on.
    """

    service: str
    moving_mm_s: float
    ready_s: float
    moved_mm: float
    valves: float
    group_state: str
    pids_kept: bool
    told: str


class CrashRig:
    """Three services under a supervisor that watches in a thread, and vision's REST API."""

    def __init__(self, supervisor: Supervisor, face: httpx.Client) -> None:
        self._supervisor = supervisor
        self.face = face

    def serves(self, service: str) -> bool:
        return self._supervisor.children[service].ready is not None

    def pids(self) -> dict[str, int]:
        return {name: child.pid for name, child in self._supervisor.children.items()}

    def answer(self, path: str) -> httpx.Response | None:
        try:
            return self.face.get(path)
        except httpx.TransportError:
            return None

    def until_healthy(self) -> None:
        until_s = time.monotonic() + READY_S
        while (answer := self.answer("/health")) is None or answer.status_code != httpx.codes.OK:
            assert time.monotonic() < until_s, "nothing answers" if answer is None else answer.text
            time.sleep(0.05)

    def tool_m(self) -> np.ndarray:
        return np.array(self.face.get("/state").json()["X_BT"]["p_m"])

    def moving(self, up_m: float) -> float:
        """The arm within a motion; mm/s of the tool."""
        until_s = time.monotonic() + READY_S
        while (answer := self.face.post("/enable")).status_code != httpx.codes.OK:
            assert time.monotonic() < until_s, answer.text
            self.face.post("/reset")
            time.sleep(0.2)
        while True:
            body = {"offset_base_m": [0.0, 0.0, up_m], "duration_s": 4.0}
            answer = self.face.post("/operations/move", json=body)
            if answer.status_code == httpx.codes.ACCEPTED:
                break
            assert time.monotonic() < until_s, answer.text
            time.sleep(0.2)
        time.sleep(1.5)
        first = self.tool_m()
        time.sleep(0.3)
        return float(1e3 * np.linalg.norm(self.tool_m() - first) / 0.3)

    def trial(self, service: str, up_m: float) -> CrashTrial:
        self.until_healthy()
        speed = self.moving(up_m)
        before = self.pids()
        killed_s = time.monotonic()
        os.kill(before[service], signal.SIGKILL)
        while self.pids()[service] == before[service] or not self.serves(service):
            assert time.monotonic() - killed_s < READY_S, "it is not started anew"
            time.sleep(0.02)
        self.until_healthy()
        ready_s = time.monotonic() - killed_s
        at = self.tool_m()
        time.sleep(HOLD_S)
        state = self.face.get("/state").json()
        after = self.pids()
        return CrashTrial(
            service=service,
            moving_mm_s=speed,
            ready_s=ready_s,
            moved_mm=float(1e3 * np.linalg.norm(np.array(state["X_BT"]["p_m"]) - at)),
            valves=max(map(abs, state["valves"])),
            group_state=state["group_state"],
            pids_kept=all(after[name] == before[name] for name in SERVICES if name != service),
            told=next(n["detail"] for n in state["incidents"][::-1] if n["cause"] == "service.crashed"),
        )


@contextmanager
def watched(directory: Path) -> Iterator[CrashRig]:
    overrides = chosen_overrides(CONFIGS, "standard", 1, [])
    launch = prepare(CONFIGS, overrides, directory, any_ports=True)
    done = threading.Event()
    with (
        supervised(launch.services, directory, most_crashes=MORE_THAN_ALL) as supervisor,
        httpx.Client(base_url=launch.rest_url, timeout=10.0) as face,
    ):

        def watch() -> None:
            while not done.is_set():
                supervisor.watch(0.2, interval_s=0.05, tell=lambda _at_s, _said: None)

        watcher = threading.Thread(target=watch)
        watcher.start()
        try:
            yield CrashRig(supervisor, face)
        finally:
            done.set()
            watcher.join(READY_S)


def judge(trial: CrashTrial) -> None:
    assert trial.moving_mm_s > 5.0, "the arm must have been moving"
    assert trial.pids_kept
    assert trial.group_state in ("disabled", "error_stop")
    assert trial.valves == 0.0
    assert trial.moved_mm < 1e3 * LEAK_M
    assert f"{trial.service} crashed with signal SIGKILL" in trial.told


@pytest.mark.realtime
@pytest.mark.slow("three services start, and each of them once more")
@pytest.mark.timeout(400)
def test_each_killed_service_is_started_anew_alone_and_the_arm_stays_disabled(tmp_path: Path) -> None:
    with watched(tmp_path) as rig:
        for number, service in enumerate(SERVICES):
            judge(rig.trial(service, 0.15 if number % 2 else -0.15))


@pytest.mark.experiment
@pytest.mark.parametrize("service", SERVICES)
def test_crashes_ten_times_each(tmp_path: Path, service: str) -> None:
    with watched(tmp_path) as rig:
        trials = [rig.trial(service, 0.15 if number % 2 else -0.15) for number in range(10)]
    rows = [
        (f"{t.moving_mm_s:.0f}", f"{t.ready_s:.1f}", f"{t.moved_mm:.1f}", t.valves, t.group_state)
        for t in trials
    ]
    columns = ("mm/s before", "s until ready", f"mm in {HOLD_S} s after", "valves", "group state")
    out.print(table(f"SIGKILL of {service}", columns, rows))
    for trial in trials:
        judge(trial)
