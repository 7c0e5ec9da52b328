"""The Python interface: refusals and their causes, REST without a network, cancelling, arm and plant."""

import asyncio
import functools
import json
import threading

import httpx
import numpy as np
import pytest

import longreach
from longreach.rigs import SimulatedRig
from protocol.errors import LinkLost, RequestRefused
from tests.support.paths import CONFIGS
from vision_pc.application.results import JudgedLook, look_json
from vision_pc.core.positioning.look_then_move import LookVerdict
from vision_pc.core.types import Look

SPREAD = 1e-6 * np.eye(6)
LOOK = JudgedLook(
    Look(5, np.eye(4), np.eye(4), np.eye(4), 5, 0, 0, SPREAD, SPREAD, SPREAD, SPREAD, None),
    LookVerdict(np.array([0.1, 0.0, 0.2]), 1e-6 * np.eye(3), 0.005, 0.1, inside=False, certain=True),
)


class Service:
    """What a vision PC answers; ``asked`` are the requests, ``polled`` that one asked how an operation is."""

    def __init__(self, ends: bool = True) -> None:
        self.asked: list[str] = []
        self.polled = threading.Event()
        self._ends = ends

    def __call__(self, request: httpx.Request) -> httpx.Response:
        self.asked.append(f"{request.method} {request.url.path}")
        if request.method == "GET":
            self.polled.set()
        if request.url.path == "/enable":
            return httpx.Response(409, json={"cause": "refused.error_latched", "detail": "reset first"})
        state = "succeeded" if self._ends and request.method == "GET" else "running"
        told = {
            "id": "1",
            "state": state,
            "progress": 0.5,
            "note": "",
            "result": look_json(LOOK),
            "problem": None,
        }
        return httpx.Response(200, text=json.dumps(told))


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Service:
    served = Service(getattr(request, "param", True))
    client = functools.partial(httpx.Client, transport=httpx.MockTransport(served))
    monkeypatch.setattr("testbed.realtime.rest_rig.httpx.Client", client)
    monkeypatch.setattr("testbed.realtime.rest_rig._POLL_S", 0.0)
    return served


def test_a_connected_rig_looks_and_has_no_truth(service: Service) -> None:
    with longreach.connect("http://vision") as rig:
        look = rig.look()
        assert not hasattr(rig, "truth")
    assert isinstance(look.look, Look)
    assert look.verdict.error_m == pytest.approx(LOOK.verdict.error_m)
    assert service.asked == ["POST /operations/look", "GET /operations/1"]


def test_a_refusal_has_the_causes_of_the_api(service: Service) -> None:
    with longreach.connect("http://vision") as rig, pytest.raises(RequestRefused) as refused:
        rig.enable()
    assert refused.value.cause == "refused.error_latched"


@pytest.mark.parametrize("service", [False], indirect=True)
async def test_a_cancelled_call_stops_the_arm(service: Service) -> None:
    with longreach.connect("http://vision") as rig:
        call = asyncio.create_task(asyncio.to_thread(rig.run, "look"))
        await asyncio.to_thread(service.polled.wait, 60.0)
        rig.cancel()
        with pytest.raises(RequestRefused) as refused:
            await call
        assert refused.value.cause == "refused.cancelled"
        assert service.asked[-1] == "POST /stop"


def test_nobody_there_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(request: httpx.Request) -> httpx.Response:
        raise httpx.ConnectError("refused", request=request)

    client = functools.partial(httpx.Client, transport=httpx.MockTransport(refuse))
    monkeypatch.setattr("testbed.realtime.rest_rig.httpx.Client", client)
    with longreach.connect("http://vision") as rig, pytest.raises(LinkLost) as lost:
        rig.look()
    assert lost.value.cause == "link.rest"


@pytest.fixture(scope="module")
def lockstep() -> SimulatedRig:
    return longreach.lockstep(config_dir=CONFIGS)


@pytest.mark.parametrize(
    ("program", "request_", "cause"),
    [
        ("lok", {}, "refused.unknown_program"),
        ("move", {"offset_base_m": [0.0, 0.0, 0.01]}, "refused.disabled"),
        ("move", {"offset_base_m": [0.0, 0.0, 11.0]}, "request.invalid"),
        ("look", {"fames": 3}, "request.invalid"),
    ],
)
def test_what_lockstep_refuses(
    lockstep: SimulatedRig, program: str, request_: dict[str, object], cause: str
) -> None:
    with pytest.raises(longreach.LongreachError) as refused:
        lockstep.run(program, **request_)
    assert refused.value.cause == cause


def test_kinematics_go_there_and_back_and_say_where_they_cannot() -> None:
    arm = longreach.arm(config_dir=CONFIGS)
    q = np.radians([10.0, 50.0, -80.0, 5.0, -40.0, 10.0])
    np.testing.assert_allclose(arm.ik(arm.fk(q), near=q + 0.05), q, atol=1e-12)
    step = np.array([0.0, 1e-6, 0.0, 0.0, 0.0, 0.0])
    speed = (arm.fk(q + step) - arm.fk(q - step))[:3, 3] / 2e-6
    np.testing.assert_allclose(arm.jacobian(q)[:3, 1], speed, atol=1e-8)
    far = arm.fk(q)
    far[0, 3] += 10.0
    for ask, cause in (
        (lambda: arm.ik(far, q), "refused.unreachable"),
        (lambda: arm.fk([0.0, np.nan, 0.0, 0.0, 0.0, 0.0]), "request.invalid"),
        (lambda: arm.jacobian([0.0]), "request.invalid"),
    ):
        with pytest.raises(RequestRefused) as refused:
            ask()
        assert refused.value.cause == cause


def test_a_stepped_plant_moves_and_is_the_same_again() -> None:
    runs = []
    for _ in range(2):
        plant = longreach.plant(seed=3, config_dir=CONFIGS)
        start = plant.truth.q
        for _ in range(40):
            sensors = plant.step([0.0, 0.4, 0.0, 0.0, 0.0, 0.0])
        runs.append(sensors)
        assert plant.truth.q[1] > start[1] + 1e-3
        assert plant.truth.time_ns == 200_000_000
    assert runs[0] == runs[1]
    with pytest.raises(RequestRefused):
        plant.step([0.0] * 5)
    with pytest.raises(RequestRefused):
        plant.step([0.0] * 6, dt_s=0.0)
