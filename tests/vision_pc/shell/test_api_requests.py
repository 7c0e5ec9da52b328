"""The REST face in process: waiting for the end, bodies, headers and keys, problems."""

import json
import re
import time
from typing import Any

import httpx
import pytest

from tests.vision_pc.shell.problems import refused
from tests.vision_pc.synthetic_station import Bench
from vision_pc.shell.rest import operation_routes, operations

pytestmark = pytest.mark.realtime


async def test_a_request_may_wait_for_the_end(station: Bench) -> None:
    done = await station.post("/operations/look", Prefer="respond-async, wait=60")
    assert done.status_code == 200
    assert done.headers["Preference-Applied"] == "wait=60"
    assert done.json()["state"] == "succeeded"
    assert done.json()["result"]["verdict"]
    assert done.headers["Location"] == f"/operations/{done.json()['id']}"
    failed = await station.post("/operations/local-track", Prefer="wait=60")
    refused(failed, 409, "refused.disabled")


async def test_waiting_ends_with_its_time_and_the_operation_goes_on(station: Bench) -> None:
    station.eyes.look_s = 0.5
    going = await station.post("/operations/look", Prefer="wait=0")
    assert going.status_code == 202
    assert going.headers["Preference-Applied"] == "wait=0"
    assert going.json()["state"] in ("queued", "running")
    assert (await station.ended(going.headers["Location"]))["state"] == "succeeded"
    plain = await station.post("/operations/look", Prefer="handling=lenient")
    assert plain.status_code == 202
    assert "Preference-Applied" not in plain.headers
    await station.ended(plain.headers["Location"])


@pytest.mark.parametrize(
    ("fields", "wait_s"),
    [
        (["wait=3"], 3),
        (["respond-async, wait=10"], 10),
        (["handling=lenient", 'Wait = "5" ; x=1'], 5),
        (["wait=2, wait=9"], 2),
        (["wait=99999999"], operation_routes.MAX_WAIT_S),
        (["wait=-1"], None),
        (["wait=1.5"], None),
        (["wait"], None),
        (["nowait=3"], None),
        ([], None),
    ],
)
def test_the_header_is_read_as_the_rfc_has_it(fields: list[str], wait_s: int | None) -> None:
    assert operation_routes.preferred_wait_s(fields) == wait_s


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        ("move", {}),
        ("move", {"offset_base_m": [0, 0, 0], "offset_tool_m": [0, 0, 0]}),
        ("move", {"offset_base_m": [0, 0, 100.0]}),
        ("move", {"X_BT": {"p_m": [3, 0, 1], "q_wxyz": [1, 1, 0, 0]}}),
        ("move", {"offset_base_m": [0, 0, 0], "speed": 3}),
        ("look", {"frames": 0}),
        ("trajectory-matching", {"segments_m": [0.1]}),
        ("look-then-move", {"tolerance_mm": -1.0}),
        ("look-then-move", {"inputs": 2}),  # of the other method
        ("look-then-move", {"method": "paper", "corrections": 1}),
        ("orientation-adjustment", {"form": 7}),
        ("looking-and-moving", {"gain": 2.0}),
    ],
)
async def test_bad_bodies_are_named(station: Bench, kind: str, body: Any) -> None:
    document = refused(await station.post(f"/operations/{kind}", body), 422, "request.invalid")
    assert document["faults"][0]["at"][0] == "body"


async def test_broken_json_too_much_and_unknown_paths(station: Bench) -> None:
    headers = {"content-type": "application/json"}
    answer = await station.client.post("/operations/move", content="{", headers=headers)
    refused(answer, 422, "request.invalid")
    named = refused(
        await station.client.post("/operations/look", content='{"frames": 2}'), 422, "request.invalid"
    )
    assert "Content-Type: application/json" in named["detail"]
    answer = await station.client.post("/operations/move", content=b"[" * 16_000, headers=headers)
    refused(answer, 400, "request.too_deep")
    refused(await station.client.get("/nowhere"), 404, "request.not_found")
    refused(await station.client.get("/operations/none"), 404, "refused.unknown_operation")
    refused(await station.client.delete("/operations"), 405, "request.method_not_allowed")
    unknown = refused(await station.client.post("/operations/lok"), 404, "refused.unknown_program")
    assert unknown["detail"] == "no program 'lok'; did you mean look?"


@pytest.mark.parametrize(
    ("method", "path", "content", "more", "told"),
    [
        ("POST", "/operations/look", b'{"frames": ', {}, "body.11: from this character on it is no JSON"),
        ("POST", "/operations/look", b'{"frames": "\xff"}', {}, "no JSON: wanted are UTF-8"),
        ("POST", "/operations/look", b"\x1f\x8b", {"content-encoding": "gzip"}, "no Content-Encoding"),
        ("POST", "/operations/look", b'{"frames": ' + b"9" * 5000 + b"}", {}, "at most 4300 digits"),
        ("POST", "/operations/look", b'{"frame": 5}', {}, "body.frame = 5: no such key"),
        ("GET", "/targets?detct=true", b"", {}, "query.detct = 'true': no such key"),
        ("GET", "/targets?detect=maybe", b"", {}, "query.detect = 'maybe': true or false is wanted"),
        ("GET", "/targets?diameter_mm=1_0", b"", {}, "'1_0' is no finite number in decimal digits"),
        ("POST", "/reset", b"", {"longreach-shown": "1_700"}, "'1_700' is no finite number"),
        ("PATCH", "/clock", b"", {}, "PATCH /clock: wanted is GET or PUT"),
        ("GET", "/nowhere", b"", {}, "GET /nowhere: nothing is at this path"),
    ],
)  # fmt: skip
async def test_what_is_wrong_is_said_in_our_words(
    station: Bench, method: str, path: str, content: bytes, more: dict[str, str], told: str
) -> None:
    headers = {"content-type": "application/json"} | more
    answer = await station.client.request(method, path, content=content, headers=headers)
    assert answer.is_client_error
    assert told in answer.json()["detail"]
    assert not re.search(r"Input|Extra|Field|decode error|parsing", answer.text)


async def test_a_slash_behind_a_path_is_passed_over(station: Bench) -> None:
    started = await station.client.post("/operations/look/")
    assert started.status_code == 202
    assert (await station.client.get(f"{started.headers['Location']}/")).json()["kind"] == "look"
    await station.ended(started.headers["Location"])


async def test_the_key_of_a_forgotten_operation_is_spent(
    station: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(operations, "_REMEMBERED", 2)
    monkeypatch.setattr(operations, "_KEYS_REMEMBERED", 3)
    for number in range(3):
        started = await station.post("/operations/look", Idempotency_Key=f"k{number}")
        await station.ended(started.headers["Location"])
    refused(await station.post("/operations/look", Idempotency_Key="k0"), 410, "refused.key_spent")
    assert (await station.post("/operations/look", Idempotency_Key="k1")).json()["state"] == "succeeded"
    started = await station.post("/operations/look", Idempotency_Key="k3")
    await station.ended(started.headers["Location"])
    again = await station.post(
        "/operations/look", Idempotency_Key="k0"
    )  # beyond the keys that are remembered
    assert again.status_code == 202
    await station.ended(again.headers["Location"])


async def test_two_idempotency_keys_are_refused(station: Bench) -> None:
    keys = [("Idempotency-Key", "k1"), ("Idempotency-Key", "k2")]
    refused(await station.client.post("/operations/look", headers=keys), 400, "request.repeated_header")
    assert not station.operations.list()


@pytest.mark.parametrize(
    "body",
    ['{"inputs": 1, "inputs": 2}', '{"inputs": 1, "x": {"a": 1, "b": 2, "a": 1}}', '[{"a": 1, "a": 1}]'],
)
async def test_a_member_that_is_written_twice_is_refused(station: Bench, body: str) -> None:
    headers = {"Content-Type": "application/json"}
    answer = await station.client.post("/operations/look-then-move", content=body, headers=headers)
    assert "twice" in refused(answer, 400, "request.duplicate_member")["detail"]
    assert not station.operations.list()


async def test_an_error_that_nobody_expected_is_a_problem_too(station: Bench) -> None:
    async def broken(frames: int | None = None) -> None:
        raise ZeroDivisionError("secret")

    station.eyes.look = broken  # type: ignore[assignment]
    ended = await station.run("look")
    assert ended["problem"]["cause"] == "internal"
    assert "secret" not in json.dumps(ended)
    assert "ZeroDivisionError" in station.events("operation_broke")[0]["error"]
    assert station.operations.current is None


async def test_what_was_asked_long_ago_is_refused_and_stops_are_taken(station: Bench) -> None:
    """A request that a network held up moves nothing; who says nothing of the time is not judged."""
    await station.post("/enable")

    async def asked(path: str, shown: str, body: Any = None) -> httpx.Response:
        return await station.client.post(path, json=body, headers={"Longreach-Shown": shown})

    now_s = time.time()
    document = refused(await asked("/operations/look", f"{now_s - 6.0}"), 409, "refused.asked_too_late")
    assert re.search(r"6\.\d s ago, at most 5 s: nothing was done", document["detail"])
    assert document["advice"]
    for path, shown_s in (("/operations/move", now_s - 3600.0), ("/enable", now_s + 60.0)):
        refused(await asked(path, f"{shown_s}"), 409, "refused.asked_too_late")
    for nonsense in ("yesterday", "nan", "inf", ""):
        refused(await asked("/operations/look", nonsense), 400, "request.bad_header")
    assert not (await station.client.get("/operations")).json()
    look = await asked("/operations/look", f"{now_s - 1.0}")
    assert look.status_code == 202
    assert (await asked(f"/operations/{look.json()['id']}/cancel", f"{now_s - 60.0}")).status_code == 200
    assert (await asked("/stop", f"{now_s - 3600.0}")).status_code == 200
