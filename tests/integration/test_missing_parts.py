"""A missing plant, camera or controller is named, and nothing can be enabled without them."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest

from testbed.realtime.launch import CONTROLLER, PLANT, VISION
from tests.integration.services import running
from tests.support.paths import ROOT

pytestmark = pytest.mark.realtime


def wait_for(face: httpx.Client, path: str, status: int, within_s: float = 30.0) -> httpx.Response:
    deadline = time.monotonic() + within_s
    while True:
        answer = face.get(path)
        if answer.status_code == status:
            return answer
        assert time.monotonic() < deadline, answer.text
        time.sleep(0.1)


@pytest.mark.slow("services start")
def test_without_a_plant_nothing_can_be_enabled_and_camera_and_plant_are_named(tmp_path: Path) -> None:
    with running(tmp_path, only=(CONTROLLER, VISION)) as rig:
        state = wait_for(rig.face, "/state", 200).json()
        assert state["plant_link_ok"] is False
        health = rig.face.get("/health")
        assert health.status_code == 503
        assert "the controller does not hear the plant; not answering: camera" in health.json()["detail"]
        enable = rig.face.post("/enable")
        assert enable.status_code == 409
        assert enable.json()["cause"] == "refused.plant_link_down"
        look = rig.face.post("/operations/look", json={})
        assert look.status_code == 503
        assert look.json()["cause"] == "link.camera_missing"


@pytest.mark.slow("services start")
def test_a_plant_that_is_killed_stops_the_controller_with_a_latched_cause(tmp_path: Path) -> None:
    with running(tmp_path, by_wall=True) as rig:
        wait_for(rig.face, "/health", 200, 60.0)
        assert rig.face.post("/enable").status_code == 200
        rig.supervisor.children[PLANT].kill()
        deadline = time.monotonic() + 10.0
        while (state := rig.face.get("/state").json())["group_state"] != "error_stop":
            assert time.monotonic() < deadline, state
            time.sleep(0.05)
        assert state["fault"] in ("plant_link_lost", "plant_cycle_frozen")
        assert rig.face.post("/operations/move", json={"offset_base_m": [0, 0.1, 0]}).status_code == 409


@pytest.mark.slow("services start")
def test_a_plant_that_is_killed_is_named_by_who_follows_its_clock(tmp_path: Path) -> None:
    with running(tmp_path) as rig:
        wait_for(rig.face, "/health", 200, 60.0)
        rig.supervisor.children[PLANT].kill()
        deadline = time.monotonic() + 30.0
        while "clock.unanswered: plant_emulator" not in (said := rig.face.get("/health").text):
            assert time.monotonic() < deadline, said
            time.sleep(0.2)
        stands = [rig.face.get("/clock").json() for _ in range(2)]
        assert stands[0]["time_ns"] == stands[1]["time_ns"]


@pytest.mark.slow("services start")
def test_up_tells_where_things_run_and_ends_cleanly_on_sigterm(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "longreach", "up", "--free-ports", "--out", str(tmp_path)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as up:
        assert up.stdout is not None
        said = ""
        for line in up.stdout:
            said += line
            if "REST API" in line:
                break
        assert all(name in said for name in (PLANT, CONTROLLER, VISION))
        up.send_signal(signal.SIGTERM)
        assert up.wait(15.0) == 0
