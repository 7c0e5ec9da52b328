"""The REST face in process: whole procedure, operations, refusals, problems, over a simulated arm."""

import asyncio
import json
import re
import time
from collections.abc import AsyncIterator
from typing import Any

import httpx
import numpy as np
import pytest

from protocol.faults import CommandCode, FaultCode, GroupState
from tests.vision_pc.shell.loopback_controller import until
from tests.vision_pc.synthetic_station import Bench, bench
from vision_pc.shell.rest import operations, waiting

pytestmark = pytest.mark.realtime


@pytest.fixture
async def station() -> AsyncIterator[Bench]:
    async with bench() as made:
        yield made


def refused(answer: httpx.Response, status: int, cause: str) -> dict[str, Any]:
    """The problem document, checked to be one."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    document: dict[str, Any] = answer.json()
    assert document["cause"] == cause
    assert document["status"] == status
    assert document["type"] == f"urn:longreach:{cause}"
    assert "\n" not in document["detail"]
    assert document["title"]
    return document


async def test_the_whole_procedure_brings_the_tool_inside_5_mm(station: Bench) -> None:
    assert (await station.post("/enable")).json()["group_state"] == "standby"
    before = np.abs(station.rig.true_error(0.1)[:2]).max()
    await station.succeeded("orientation-adjustment")
    assert station.rig.true_orientation_error() < np.radians(0.3)
    matched = await station.succeeded("trajectory-matching")
    assert matched["result"]["rotation_std_deg"] < 2.0
    for _ in range(2):
        moved = await station.succeeded("look-then-move", {"inputs": 1, "tolerance_mm": 5.0, "aim_mm": 0.0})
    error = 1e3 * station.rig.true_error(0.1)
    assert np.abs(error[:2]).max() < 5.0 < 1e3 * before
    result = moved["result"]
    assert result["verdict"] == "inside"
    assert result["tolerance_mm"] == 5.0
    assert abs(result["error_mm"]["x"] - error[0]) < 1.0
    assert abs(result["error_mm"]["y"] - error[1]) < 1.0
    assert result["std_mm"]["x"] > 0.0
    latest = (await station.client.get("/looks/latest")).json()
    assert latest["error_mm"] == result["error_mm"]
    assert len(station.events("look")) == 6
    state = (await station.client.get("/state")).json()
    assert state["calibration"]["method"] == "points/time"


async def test_best_mode_needs_one_look(station: Bench) -> None:
    await station.post("/enable")
    await station.run("orientation-adjustment")
    await station.succeeded("local-track")
    moved = await station.succeeded("look-then-move", {"method": "corrected"})
    assert len(moved["result"]["looks"]) == 2  # one before, one for the verdict
    assert np.abs(station.rig.true_error(0.1)[:2]).max() < 0.005
    assert abs(moved["result"]["measured_miss_mm"]["x"]) < 5.0


async def test_line_equation_moves_once_and_looks_at_the_result(station: Bench) -> None:
    await station.post("/enable")
    await station.run("orientation-adjustment")
    before = np.linalg.norm(station.rig.true_error(0.1)[:2])
    line = await station.succeeded("line-equation", {"minimum": "fit", "radius_m": 0.15})
    assert np.linalg.norm(station.rig.true_error(0.1)[:2]) < 0.3 * before
    assert line["result"]["look"]["verdict"] in ("inside", "outside")


async def test_nothing_moves_before_enable(station: Bench) -> None:
    for kind, body in (
        ("move", {"offset_base_m": [0.0, 0.1, 0.0]}),
        ("orientation-adjustment", None),
        ("trajectory-matching", None),
        ("line-equation", None),
        ("local-track", None),
    ):
        refused(await station.post(f"/operations/{kind}", body), 409, "refused.disabled")
    assert station.controller.requests == []
    assert (await station.client.get("/operations")).json() == []


async def test_a_refusal_says_what_to_do(station: Bench) -> None:
    asked = await station.post("/operations/move", {"offset_base_m": [0.0, 0.1, 0.0]})
    assert refused(asked, 409, "refused.disabled")["advice"] == "Hold ENABLE first."
    assert refused(await station.client.get("/looks/latest"), 404, "refused.no_look_yet")["advice"]


async def test_a_look_needs_no_enable(station: Bench) -> None:
    refused(await station.client.get("/looks/latest"), 404, "refused.no_look_yet")
    look = await station.succeeded("look", {"frames": 5})
    assert look["result"]["frames"] == 5
    assert look["result"]["X_CO"]["q_wxyz"]


async def test_look_while_moving_is_refused_and_so_is_everything_else(station: Bench) -> None:
    await station.post("/enable")
    move = await station.post("/operations/move", {"offset_base_m": [-0.5, 0.3, 0.3]})
    await until(lambda: station.station.controller.state.group_state is GroupState.MOVING)
    refused(await station.post("/operations/look"), 409, "refused.moving")
    refused(await station.post("/operations/move", {"offset_base_m": [0.0, 0.0, 0.1]}), 409, "refused.moving")
    assert (await station.ended(move.headers["Location"]))["state"] == "succeeded"


async def test_one_operation_at_a_time(station: Bench) -> None:
    station.eyes.look_s = 0.3
    first = await station.post("/operations/look")
    document = refused(await station.post("/operations/look"), 409, "refused.busy")
    assert first.json()["id"] in document["detail"]
    assert (await station.client.get("/state")).json()["operation"] == first.json()["id"]
    await station.ended(first.headers["Location"])
    await station.succeeded("look")


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
        (["wait=99999999"], waiting.MAX_WAIT_S),
        (["wait=-1"], None),
        (["wait=1.5"], None),
        (["wait"], None),
        (["nowait=3"], None),
        ([], None),
    ],
)
def test_the_header_is_read_as_the_rfc_has_it(fields: list[str], wait_s: int | None) -> None:
    assert waiting.preferred_wait_s(fields) == wait_s


async def test_who_finds_no_place_to_wait_is_answered_at_once(
    station: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(waiting, "MAX_WAITING", 0)
    answer = await station.post("/operations/look", Prefer="wait=60")
    assert answer.status_code == 202
    assert "Preference-Applied" not in answer.headers
    await station.ended(answer.headers["Location"])


async def test_look_then_move_wants_a_calibration(station: Bench) -> None:
    await station.post("/enable")
    refused(await station.post("/operations/look-then-move"), 409, "refused.not_calibrated")
    refused(
        await station.post("/operations/look-then-move", {"method": "corrected"}),
        409,
        "refused.not_calibrated",
    )


async def test_move_by_offsets_and_to_a_pose(station: Bench) -> None:
    await station.post("/enable")
    start = (await station.client.get("/state")).json()["X_BT"]
    moved = await station.run("move", {"offset_tool_m": [0.05, 0.0, 0.0], "duration_s": 0.0})
    assert moved["result"]["X_BT"]["p_m"][1] == pytest.approx(
        start["p_m"][1] - 0.05, abs=1e-5
    )  # n is −y of B
    moved = await station.run("move", {"X_BT": start})
    assert moved["result"]["X_BT"]["p_m"] == pytest.approx(start["p_m"], abs=1e-6)
    assert moved["result"]["miss_mm"] < 0.01


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        ("move", {}),
        ("move", {"offset_base_m": [0, 0, 0], "offset_tool_m": [0, 0, 0]}),
        ("move", {"offset_base_m": [0, 0]}),
        ("move", {"offset_base_m": [0, 0, 100.0]}),
        ("move", {"X_BT": {"p_m": [3, 0, 1], "q_wxyz": [1, 1, 0, 0]}}),
        ("move", {"offset_base_m": [0, 0, 0], "speed": 3}),
        ("look", {"frames": 0}),
        ("look", {"frames": 10_000}),
        ("trajectory-matching", {"segments_m": [0.1]}),
        ("trajectory-matching", {"method": "magic"}),
        ("line-equation", {"points": 500}),
        ("look-then-move", {"tolerance_mm": -1.0}),
        ("orientation-adjustment", {"form": 7}),
        ("looking-and-moving", {"gain": 2.0}),
        ("looking-and-moving", {"settle_mm": -1.0}),
    ],
)
async def test_bad_bodies_are_named(station: Bench, kind: str, body: Any) -> None:
    document = refused(await station.post(f"/operations/{kind}", body), 422, "request.invalid")
    assert document["faults"][0]["at"][0] == "body"


@pytest.mark.parametrize("text", ["NaN", "Infinity", "1e999"])
async def test_numbers_that_are_none_are_refused(station: Bench, text: str) -> None:
    content = f'{{"offset_base_m": [0, 0, {text}]}}'
    headers = {"content-type": "application/json"}
    answer = await station.client.post("/operations/move", content=content, headers=headers)
    refused(answer, 422, "request.invalid")


async def test_broken_json_too_much_and_unknown_paths(station: Bench) -> None:
    headers = {"content-type": "application/json"}
    answer = await station.client.post("/operations/move", content="{", headers=headers)
    refused(answer, 422, "request.invalid")
    answer = await station.client.post("/operations/move", content=b"[" * 20_000, headers=headers)
    refused(answer, 413, "request.too_large")

    async def unannounced() -> AsyncIterator[bytes]:
        for _ in range(20):
            yield b"[" * 1000

    answer = await station.client.post("/operations/move", content=unannounced(), headers=headers)
    refused(answer, 413, "request.too_large")
    refused(await station.client.get("/nowhere"), 404, "request.not_found")
    refused(await station.client.get("/operations/none"), 404, "refused.unknown_operation")
    refused(await station.client.get("/operations/none/events"), 404, "refused.unknown_operation")
    refused(await station.client.delete("/operations"), 405, "request.method_not_allowed")
    unknown = refused(await station.client.post("/operations/lok"), 404, "refused.unknown_program")
    assert unknown["detail"] == "no program 'lok'; did you mean look?"


async def test_unreachable_targets_fail_with_the_controllers_reason(station: Bench) -> None:
    await station.post("/enable")
    moved = await station.run("move", {"offset_base_m": [5.0, 0.0, 0.0]})
    assert moved["state"] == "failed"
    assert moved["problem"]["cause"] == "refused.unreachable"
    assert moved["result"] is None
    assert station.controller.group is GroupState.STANDBY


async def test_a_symmetric_path_fails_and_the_arm_rests(station: Bench) -> None:
    await station.post("/enable")
    count = len(station.controller.requests)
    ended = await station.run("trajectory-matching", {"segments_m": [0.2] * 5})
    assert ended["problem"]["cause"] == "measurement.path_symmetric"
    assert {request.code for request in station.controller.requests[count:]} == {CommandCode.STOP}


async def test_an_object_out_of_view_fails_and_the_last_look_is_not_replaced(station: Bench) -> None:
    await station.run("look")
    before = (await station.client.get("/looks/latest")).json()
    station.rig.blind_object = True
    ended = await station.run("look")
    assert ended["problem"]["cause"] == "measurement.object_not_seen"
    assert (await station.client.get("/looks/latest")).json() == before


async def test_cancel_stops_the_arm_and_ends_once(station: Bench) -> None:
    await station.post("/enable")
    move = await station.post("/operations/move", {"offset_base_m": [-0.8, 0.5, 0.5]})
    location = move.headers["Location"]
    await until(lambda: station.controller.group is GroupState.MOVING)
    cancelled = await station.post(f"{location}/cancel")
    assert cancelled.json()["state"] == "cancelled"
    await until(lambda: station.controller.group is GroupState.STANDBY)
    q = station.rig.q.copy()
    await asyncio.sleep(0.05)
    assert np.array_equal(station.rig.q, q)
    refused(await station.post(f"{location}/cancel"), 409, "refused.already_ended")
    assert (await station.client.get(location)).json()["state"] == "cancelled"
    assert len(station.events("operation_ended")) == 1


async def test_cancel_racing_with_the_end_leaves_one_end_state(station: Bench) -> None:
    for delay in (0.0, 0.015, 0.02, 0.025, 0.03):
        answer = await station.post("/operations/look")
        await asyncio.sleep(delay)
        await station.post(f"{answer.headers['Location']}/cancel")
        final = await station.ended(answer.headers["Location"])
        assert final["state"] in ("cancelled", "succeeded")
    assert len(station.events("operation_ended")) == 5
    assert station.operations.current is None


async def test_stop_is_always_accepted_and_ends_the_operation(station: Bench) -> None:
    assert (await station.post("/stop")).json()["accepted"] is True  # disabled
    await station.post("/enable")
    assert (await station.post("/stop")).status_code == 200  # standing
    move = await station.post("/operations/move", {"offset_base_m": [-0.8, 0.5, 0.5]})
    await until(lambda: station.controller.group is GroupState.MOVING)
    assert (await station.post("/stop")).status_code == 200
    ended = await station.ended(move.headers["Location"])
    assert ended["state"] in ("cancelled", "failed")
    station.controller.break_down(FaultCode.ENCODER_JUMP)
    assert (await station.post("/stop")).status_code == 200  # in error


async def test_stop_while_looking_ends_the_operation_before_it_moves(station: Bench) -> None:
    await station.post("/enable")
    station.eyes.look_s = 0.5
    started = await station.post("/operations/orientation-adjustment")
    await asyncio.sleep(0.05)
    await station.post("/stop")
    assert (await station.ended(started.headers["Location"]))["state"] == "cancelled"
    assert station.rig.motions == 0


async def test_emergency_stop_latches_until_released_and_reset(station: Bench) -> None:
    await station.post("/enable")
    assert (await station.post("/emergency-stop")).json()["emergency_latched"] is True
    refused(await station.post("/enable"), 409, "refused.emergency_latched")
    refused(await station.post("/reset"), 409, "refused.emergency_latched")
    body = {"offset_base_m": [0.0, 0.1, 0.0]}
    refused(await station.post("/operations/move", body), 409, "refused.emergency_latched")
    assert (await station.post("/emergency-release")).json()["group_state"] == "error_stop"
    refused(await station.post("/operations/move", body), 409, "refused.error_latched")
    assert (await station.post("/reset")).json()["group_state"] == "disabled"
    await station.post("/enable")
    await station.succeeded("move", body)


async def test_a_fault_in_motion_fails_the_operation_by_name(station: Bench) -> None:
    await station.post("/enable")
    move = await station.post("/operations/move", {"offset_base_m": [-0.8, 0.5, 0.5]})
    await until(lambda: station.controller.group is GroupState.MOVING)
    station.controller.break_down(FaultCode.SUPPLY_PRESSURE_LOST)
    ended = await station.ended(move.headers["Location"])
    assert ended["problem"]["cause"] == "refused.fault_supply_pressure_lost"
    state = (await station.client.get("/state")).json()
    assert (state["group_state"], state["fault"]) == ("error_stop", "supply_pressure_lost")


async def test_the_same_idempotency_key_is_the_same_operation(station: Bench) -> None:
    await station.post("/enable")
    body = {"offset_base_m": [0.0, 0.1, 0.0]}
    first = await station.post("/operations/move", body, Idempotency_Key="k1")
    again = await station.post("/operations/move", body, Idempotency_Key="k1")
    assert first.json()["id"] == again.json()["id"]
    await station.ended(first.headers["Location"])
    later = await station.post("/operations/move", body, Idempotency_Key="k1")
    assert later.json()["state"] == "succeeded"
    other = {"offset_base_m": [0.0, 0.2, 0.0]}
    refused(await station.post("/operations/move", other, Idempotency_Key="k1"), 422, "refused.key_reused")
    assert len((await station.client.get("/operations")).json()) == 1


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


async def test_events_follow_an_operation_to_its_end(station: Bench) -> None:
    await station.post("/enable")
    started = await station.post("/operations/orientation-adjustment")
    answer = await station.client.get(f"{started.headers['Location']}/events")
    assert answer.headers["content-type"].startswith("text/event-stream")
    blocks = [block for block in answer.text.split("\n\n") if "data:" in block]
    names = [line[7:] for block in blocks for line in block.splitlines() if line.startswith("event: ")]
    data = [
        json.loads(line[6:]) for block in blocks for line in block.splitlines() if line.startswith("data: ")
    ]
    assert names[-1] == "ended"
    assert set(names[:-1]) == {"progress"}
    assert [d["progress"] for d in data[:-1]] == sorted(d["progress"] for d in data[:-1])
    assert data[-1]["state"] == "succeeded"


async def test_without_a_controller(station: Bench) -> None:
    await station.controller.stop()
    await asyncio.sleep(0.05)
    health = await station.client.get("/health")
    document = refused(health, 503, "link.degraded")
    assert document["controller"] is False
    assert document["camera"] is True
    for path in ("/state",):
        assert (await station.client.get(path)).status_code == 503
    assert refused(await station.post("/operations/local-track"), 503, "link.shutdown")
    assert (await station.post("/operations/look")).status_code == 202  # a camera is put into service alone
    assert (await station.post("/stop")).status_code == 503


async def test_without_a_camera(station: Bench) -> None:
    station.eyes.connected = False
    refused(await station.client.get("/health"), 503, "link.degraded")
    refused(await station.post("/operations/look"), 503, "link.camera_silent")
    await station.post("/enable")
    await station.succeeded("move", {"offset_base_m": [0.0, 0.05, 0.0]})


async def test_state_and_health_and_picture(station: Bench) -> None:
    assert (await station.client.get("/health")).json()["status"] == "ok"
    state = (await station.client.get("/state")).json()
    assert state["q_meas_deg"] == pytest.approx([0.0, 50.0, -75.0, 0.0, -25.0, 0.0])
    assert state["X_BT"]["p_m"] == pytest.approx([3.89355, 0.0, 1.00825], abs=1e-5)
    assert state["link"]["clock_uncertainty_ns"] > 0
    assert state["camera"]["connected"] is True
    picture = await station.client.get("/camera/latest.png")
    assert picture.headers["content-type"] == "image/png"
    assert picture.content.startswith(b"\x89PNG")


async def test_an_error_that_nobody_expected_is_a_problem_too(station: Bench) -> None:
    async def broken(frames: int | None = None) -> None:
        raise ZeroDivisionError("secret")

    station.eyes.look = broken  # type: ignore[assignment]
    ended = await station.run("look")
    assert ended["problem"]["cause"] == "internal"
    assert "secret" not in json.dumps(ended)
    assert "ZeroDivisionError" in station.events("operation_broke")[0]["error"]
    assert station.operations.current is None


async def test_openapi_describes_the_face(station: Bench) -> None:
    document = (await station.client.get("/openapi.json")).json()
    paths = document["paths"]
    for kind in (
        "look",
        "orientation-adjustment",
        "line-equation",
        "trajectory-matching",
        "look-then-move",
        "move",
    ):
        operation = paths[f"/operations/{kind}"]["post"]
        assert "202" in operation["responses"]
        assert "Location" in operation["responses"]["202"]["headers"]
    assert document["components"]["schemas"]["TrajectoryBody"]["properties"]["segments_m"]["examples"]
    assert "application/problem+json" in json.dumps(paths["/enable"])
    for command in ("enable", "disable", "stop", "reset", "emergency-stop", "emergency-release"):
        assert f"/{command}" in paths


async def test_events_are_recorded_and_a_full_disk_refuses_motion(tmp_path: Any) -> None:
    async with bench(record_dir=tmp_path) as made:
        await made.run("look")
        lines = [json.loads(line) for line in (tmp_path / "events.jsonl").read_text().splitlines()]
        assert {"link_connected", "operation_queued", "look", "operation_ended"} <= {
            line["event"] for line in lines
        }

        class Full:
            def write(self, text: str) -> int:
                raise OSError(28, "No space left on device")

            def close(self) -> None: ...

        made.station.log._file.close()  # type: ignore[union-attr]
        made.station.log._file = Full()  # type: ignore[assignment]
        await made.post("/enable")
        refused(
            await made.post("/operations/move", {"offset_base_m": [0, 0.1, 0]}),
            409,
            "refused.recording_failed",
        )
        assert (await made.post("/stop")).status_code == 200


@pytest.mark.realtime
async def test_home_is_where_the_arm_was_first_heard() -> None:
    """And, once the machine has begun anew, where it stands then."""
    async with bench() as made:
        await made.post("/enable")
        first = made.station.controller.home
        assert first is not None
        away = await made.run("move", {"offset_base_m": [0.0, 0.04, 0.02]})
        back = (await made.run("home"))["result"]
        assert back["X_BT_ref"]["p_m"] == pytest.approx(first[:3, 3], abs=1e-6)
        assert back["miss_mm"] < 2.0
        assert np.linalg.norm(np.subtract(away["result"]["X_BT"]["p_m"], first[:3, 3])) > 0.03
        await made.run("move", {"offset_base_m": [0.0, 0.04, 0.0]})
        made.station.begin_anew()
        await until(lambda: made.station.controller.home is not None)
        again = (await made.run("home"))["result"]["X_BT_ref"]["p_m"]
        assert np.subtract(again, first[:3, 3])[1] == pytest.approx(0.04, abs=3e-3)


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
