"""Three real processes on real sockets: every refusal has its cause, and what is refused moves nothing."""

import time
from collections.abc import Iterator

import httpx
import numpy as np
import pytest

from testbed.realtime import probe
from testbed.realtime.launch import PLANT
from testbed.realtime.rest_rig import RestRig
from testbed.recordings.plant_truth import read_truth
from tests.integration.services import Running, running

# Its sleeps and HTTP go by the wall: once, on a stalled machine, a state was refused after a command.
pytestmark = [pytest.mark.processes, pytest.mark.realtime, pytest.mark.slow("three services start")]

HELD_M = 0.002  # what servo and leakage move the tool in the seconds of a test


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with running(tmp_path_factory.mktemp("processes")) as started:
        face = RestRig(started.launch.rest_url)
        face.wait_healthy(180.0)
        face.close()
        yield started


@pytest.fixture
def face(rig: Running) -> httpx.Client:
    rig.supervisor.check()
    return rig.face


def tool(face: httpx.Client) -> np.ndarray:
    answer = face.get("/state")
    assert answer.status_code == httpx.codes.OK, answer.text
    return np.array(answer.json()["X_BT"]["p_m"])


def ended(face: httpx.Client, operation: dict[str, object], within_s: float = 40.0) -> dict[str, object]:
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        current = face.get(f"/operations/{operation['id']}").json()
        if current["state"] not in ("queued", "running"):
            return dict(current)
        time.sleep(0.1)
    raise AssertionError(f"operation still runs after {within_s} s")


def enabled(face: httpx.Client) -> None:
    """Enable the arm, also after a fault that another test or the machine left behind."""
    deadline = time.monotonic() + 60.0
    while (answer := face.post("/enable")).status_code != httpx.codes.OK:
        assert time.monotonic() < deadline, answer.text
        face.post("/reset")
        time.sleep(0.2)


def test_health_and_probes_find_everybody(rig: Running, face: httpx.Client) -> None:
    assert face.get("/health").json()["status"] == "ok"
    service, controller = rig.launch.settings.plant_service, rig.launch.settings.controller
    assert "register 0" in probe.probe_fieldbus("127.0.0.1", service.modbus.port)
    assert "UNKNOWN_SESSION" in probe.probe_reference("127.0.0.1", controller.reference_link.port)
    assert probe.main(["rest", "127.0.0.1", str(rig.launch.settings.vision.api.port)]) == 0
    assert face.get("/health").status_code == 200, "the probes must not have disturbed the link"


def test_an_unreachable_reference_fails_with_the_controllers_reason(face: httpx.Client) -> None:
    enabled(face)
    before = tool(face)
    answer = face.post("/operations/move", json={"offset_base_m": [2.5, 0.0, 0.0]})
    assert answer.status_code == 202
    operation = ended(face, answer.json())
    assert operation["state"] == "failed"
    problem = operation["problem"]
    assert isinstance(problem, dict)
    assert problem["cause"] in ("refused.unreachable", "refused.joint_limit", "refused.outside_workspace")
    assert face.get("/state").json()["group_state"] == "standby"
    assert np.linalg.norm(tool(face) - before) < HELD_M


def test_a_look_sees_tool_and_object_and_its_picture_can_be_had(face: httpx.Client) -> None:
    deadline = time.monotonic() + 60.0
    while True:  # if the machine stalls between two states, the refusal names that cause: repeat the look
        operation = ended(face, face.post("/operations/look", json={"frames": 3}).json())
        problem = operation["problem"] or {"type": ""}
        if not problem["type"].endswith(":link.state_gap") or time.monotonic() > deadline:
            break
    assert operation["state"] == "succeeded", operation["problem"]
    assert face.get("/looks/latest").json()["frames"] == 3
    picture = face.get("/camera/latest.png")
    assert picture.content.startswith(b"\x89PNG")


def test_a_move_moves_the_true_tool_as_far_as_asked(rig: Running, face: httpx.Client) -> None:
    enabled(face)
    began_ns = face.get("/clock").json()["time_ns"]
    operation = ended(face, face.post("/operations/move", json={"offset_base_m": [0, -0.06, 0.02]}).json())
    assert operation["state"] == "succeeded", operation["problem"]
    ended_ns = face.get("/clock").json()["time_ns"]
    time.sleep(0.3)
    recording = read_truth(rig.launch.records(PLANT) / "truth.mcap")
    tool_W = recording.stacked("X_WT")[:, :3, 3]
    times = recording.log_ns()
    first, last = np.searchsorted(times, [began_ns, ended_ns])
    went = tool_W[min(int(last), len(tool_W) - 1)] - tool_W[int(first) - 1]
    assert went == pytest.approx([0.0, -0.06, 0.02], abs=0.006)
