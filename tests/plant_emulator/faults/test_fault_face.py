"""The HTTP face for faults: everything it offers, everything it refuses, always as a problem with a cause."""

import asyncio
import json
import math
import socket
from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest
from fastapi import FastAPI
from hypothesis import given, settings
from hypothesis import strategies as st

from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.fault_execution import carry_out
from plant_emulator.core.faults.kinds import FAULTS
from plant_emulator.core.faults.schedule import LookOrder, Order, OrderMessage, PlantAnswer
from plant_emulator.core.layout import JOINTS
from plant_emulator.core.plant import Plant
from plant_emulator.shell import fault_api
from plant_emulator.shell.fault_api import create_app
from protocol.errors import LinkLost, RequestRefused
from protocol.process_image import CONTROL_ENABLE, ValveImage
from tests.plant_emulator.camera.camera_world import scene_config
from tests.plant_emulator.faults.test_faults import EVERY
from tests.plant_emulator.plant_world import plant_config

pytestmark = pytest.mark.realtime

MS = 1_000_000
JSON = {"content-type": "application/json"}


class NearPlant:
    """A plant without a link in between; what would cross it is JSON all the same."""

    def __init__(self, plant: Plant) -> None:
        self.shows_truth = False
        self._plant = plant
        self._scene = Scene(scene_config())

    async def ask(self, order: Order) -> PlantAnswer:
        """What became of an order."""
        message = OrderMessage.model_validate_json(OrderMessage(number=1, order=order).model_dump_json())
        answer = carry_out(message, self._plant, self._scene.cover, shows_truth=self.shows_truth)
        if answer.cause:
            raise RequestRefused(answer.cause, answer.detail)
        return PlantAnswer.model_validate_json(answer.model_dump_json())


Client = Callable[..., httpx.Response]


def client(app: FastAPI) -> Client:
    """Asks an application by method and path, without a socket."""

    async def asked(method: str, path: str, **content: Any) -> httpx.Response:
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://plant") as http:
            return await http.request(method, path, **content)

    return lambda *request, **content: asyncio.run(asked(*request, **content))


@pytest.fixture
def plant() -> Plant:
    return Plant(plant_config(), seed=1)


@pytest.fixture
def face(plant: Plant) -> Client:
    return client(create_app(NearPlant(plant), True))


@pytest.fixture(scope="module")
def whole() -> tuple[Client, Plant]:
    """A face and its plant for tests that break nothing, nor mend."""
    plant = Plant(plant_config(), seed=1)
    return client(create_app(NearPlant(plant), True)), plant


def problem(response: httpx.Response, status: int, cause: str) -> str:
    """The detail of a problem document, whose every member is checked."""
    document = response.json()
    assert response.headers["content-type"] == "application/problem+json"
    assert set(document) == {"type", "title", "status", "detail", "cause", "instance"}
    assert (response.status_code, document["status"], document["cause"]) == (status, status, cause)
    assert document["type"] == f"urn:longreach:{cause}"
    assert document["instance"] == response.request.url.path
    return str(document["detail"])


def test_every_fault_can_be_injected_seen_and_mended(face: Client, plant: Plant) -> None:
    for data in EVERY:
        created = face("POST", "/faults", json={"fault": data})
        assert created.status_code == 201
        body = created.json()
        assert body["fault"].items() >= data.items()
        assert plant.truth().faults == (body["name"],)
        assert face("GET", created.headers["location"]).json() == body
        assert face("GET", "/faults").json() == {
            "allowed": True, "time_ns": plant.time_ns, "active": [body], "planned": []
        }  # fmt: skip
        assert face("DELETE", created.headers["location"]).json() == body
        assert plant.truth().faults == ()
        problem(face("GET", created.headers["location"]), 404, "refused.no_such_fault")
        problem(face("DELETE", created.headers["location"]), 404, "refused.no_such_fault")


def test_kinds_come_with_their_schema(face: Client) -> None:
    kinds = {row["kind"]: row for row in face("GET", "/faults/kinds").json()}
    assert set(kinds) == set(FAULTS)
    slow = kinds["valve_slow"]["schema"]
    assert slow["properties"]["bandwidth_share"]["minimum"] == 0.01
    assert slow["properties"]["joint"]["enum"] == ["slew", "lift", "tilt", "wrist1", "wrist2", "wrist3"]
    assert slow["additionalProperties"] is False
    assert all(row["description"] for row in kinds.values())


def test_everything_is_mended_at_once(face: Client, plant: Plant) -> None:
    first = face("POST", "/faults", json={"fault": {"kind": "supply_lost"}}).json()
    later = face("POST", "/faults", json={"fault": {"kind": "coupler_silent"}, "start_after_s": 9}).json()
    assert face("DELETE", "/faults").json() == [first, later]
    assert face("GET", "/faults").json()["planned"] == []
    assert plant.truth().faults == ()


@pytest.mark.parametrize(
    ("body", "cause", "named"),
    [
        ({}, "request.invalid", "body.fault: a value is wanted"),
        ({"fault": {"kind": "gremlins"}}, "refused.unknown_fault", "'valve_stuck'"),
        ({"fault": {"kind": "supply_lost", "force": 1}}, "refused.fault_parameter", "force = 1: no such key"),
        ({"fault": {"kind": "marker_covered", "marker_id": 17}}, "refused.unknown_marker", "0, 1, 2, 3"),
        ({"fault": {"kind": "supply_lost"}, "start_after_s": -1}, "request.invalid", "start_after_s"),
        ({"fault": {"kind": "supply_lost"}, "duration_s": 0}, "request.invalid", "duration_s"),
        ({"fault": {"kind": "supply_lost"}, "when": "now"}, "request.invalid", "when"),
        *(({"fault": {"kind": kind} | more}, "refused.fault_parameter", named) for kind, more, named in (
            ("valve_stuck", {}, "joint"), ("valve_stuck", {"joint": "elbow"}, "elbow"),
            ("valve_slow", {"joint": "lift", "bandwidth_share": 0.0}, "bandwidth_share = 0"),
            ("encoder_jump", {"joint": "lift", "angle_mrad": math.nan}, "angle_mrad"),
            ("payload_change", {"mass_kg": math.inf}, "mass_kg"),
            ("camera_frozen", {"stamps": "melt"}, "melt"),
        )),
        *((data, "request.invalid", "") for data in (
            b"", b"{", b"[]", b"\xff\xfe", b'{"fault": NaN}', b"null")),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_and_nothing_breaks(
    whole: tuple[Client, Plant], body: dict[str, Any] | bytes, cause: str, named: str
) -> None:
    face, plant = whole
    content = body if isinstance(body, bytes) else json.dumps(body)
    assert named in problem(face("POST", "/faults", content=content, headers=JSON), 422, cause)
    assert not plant.faults.all()
    assert not plant.faults.changes


def test_without_permission_everything_can_be_read_and_nothing_broken_or_mended(plant: Plant) -> None:
    planned = plant.inject(FAULTS["supply_lost"]())  # type: ignore[arg-type]
    face = client(create_app(NearPlant(plant), False))
    assert face("GET", "/faults").json()["allowed"] is False
    assert face("GET", f"/faults/{planned.number}").status_code == 200
    assert len(face("GET", "/faults/kinds").json()) == len(FAULTS)
    changing = (
        ("POST", "/faults"),
        ("DELETE", "/faults"),
        ("DELETE", "/faults/1"),
        ("POST", "/world/restart"),
    )
    for method, path in changing:
        response = face(method, path, json={"fault": {"kind": "payload_drop"}})
        assert "--allow-faults" in problem(response, 403, "refused.faults_not_allowed")
    assert plant.truth().faults == ("supply_lost",)


def test_where_the_arm_is_is_told_only_where_it_is_shown(plant: Plant) -> None:
    near = NearPlant(plant)
    face = client(create_app(near, False))
    assert "--show-truth" in problem(face("GET", "/truth"), 404, "refused.truth_hidden")
    near.shows_truth = True
    told = face("GET", "/truth").json()
    points = np.array(told["arm_points_m"])
    assert told["time_ns"] == plant.time_ns
    assert points[0] == pytest.approx(np.zeros(3), abs=1e-5)
    assert points[-1] == pytest.approx(plant.truth().X_BT[:3, 3], abs=1e-5)
    assert len(points) == len(plant.chain.names) + 1
    reach = np.linalg.norm(np.diff(points, axis=0), axis=1)
    plant.write(ValveImage(1, CONTROL_ENABLE, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    plant.advance(400 * MS)
    moved = np.array(face("GET", "/truth").json()["arm_points_m"])
    assert np.linalg.norm(moved[-1] - points[-1]) > 0.01
    assert np.linalg.norm(np.diff(moved, axis=0), axis=1) == pytest.approx(
        reach, abs=0.01
    )  # it bends a little


def test_only_pages_that_are_allowed_may_read_the_answers(plant: Plant) -> None:
    ours, theirs = "http://127.0.0.1:8000", "http://evil.example"
    face = client(create_app(NearPlant(plant), True, [ours]))
    assert face("GET", "/faults", headers={"origin": ours}).headers["access-control-allow-origin"] == ours
    assert "access-control-allow-origin" not in face("GET", "/faults", headers={"origin": theirs}).headers
    shut = client(create_app(NearPlant(plant), True))
    assert "access-control-allow-origin" not in shut("GET", "/faults", headers={"origin": ours}).headers


def test_a_restart_is_asked_for_without_a_body(face: Client, plant: Plant) -> None:
    answer = face("POST", "/world/restart")
    assert (answer.status_code, answer.json()) == (202, {"restarts": True})
    assert not plant.faults.all()


_VALUES = (
    st.none() | st.booleans() | st.integers(-2000, 2000) | st.floats() | st.sampled_from(JOINTS) | st.text()
)
_PARAMETERS = sorted({name for model in FAULTS.values() for name in model.model_fields} - {"kind"})
_FAULTS = st.builds(
    lambda kind, more: {"kind": kind} | more,
    st.sampled_from(sorted(FAULTS)),
    st.dictionaries(st.sampled_from(_PARAMETERS), _VALUES, max_size=3),
)
_JSON = st.recursive(_VALUES, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=8)
_TIMES = st.dictionaries(st.sampled_from(["start_after_s", "duration_s", "when"]), _VALUES, max_size=2)


@settings(max_examples=50, deadline=None)
@given(body=st.builds(lambda fault, times: {"fault": fault} | times, _FAULTS | _JSON, _TIMES) | _JSON)
def test_whatever_is_sent_is_obeyed_or_refused_with_a_cause(whole: tuple[Client, Plant], body: Any) -> None:
    face, plant = whole
    before = plant.faults.all()
    response = face("POST", "/faults", content=json.dumps(body).encode())
    assert response.status_code in (201, 409, 422)
    if response.status_code == 201:
        face("DELETE", response.headers["location"])
    else:
        assert problem(response, response.status_code, response.json()["cause"])
    assert plant.faults.all() == before


async def test_a_plant_that_says_nothing_is_told_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fault_api, "_ANSWER_WITHIN_S", 0.05)
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        link = fault_api.DeskLink(theirs)
        with pytest.raises(LinkLost, match="has not answered"):
            await link.ask(LookOrder())
        asking = asyncio.create_task(link.ask(LookOrder()))
        await asyncio.sleep(0)
        for number in (1, 2):  # the first was given up, and answered late
            answer = PlantAnswer(number=number, time_ns=5 * number, active=[], planned=[])
            ours.send(answer.model_dump_json().encode())
        assert (await asking).time_ns == 10
