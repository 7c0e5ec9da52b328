"""The REST face in process: what ends an operation, cancelled, stopped, failed, or without its links."""

import asyncio

import numpy as np
import pytest

from protocol.faults import FaultCode, GroupState
from protocol.reference_messages import State
from tests.vision_pc.shell.loopback_controller import until
from tests.vision_pc.shell.problems import refused
from tests.vision_pc.synthetic_station import Bench

pytestmark = pytest.mark.realtime


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


async def test_an_arm_that_breaks_down_as_it_is_enabled_was_not_enabled(
    station: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = station.station.controller

    async def broken_state() -> State:
        station.controller.break_down(FaultCode.OVERRUN)
        await until(lambda: link.state.group_state is GroupState.ERROR_STOP)
        return link.state

    monkeypatch.setattr(link, "next_state", broken_state)
    for _ in range(2):
        document = refused(await station.post("/enable"), 409, "refused.error_latched")
        assert document["detail"] == "enable refused: error latched by overrun"
        assert "reset and enable" in document["advice"]


async def test_without_a_controller(station: Bench) -> None:
    await station.controller.stop()
    await asyncio.sleep(0.05)
    health = await station.client.get("/health")
    document = refused(health, 503, "link.degraded")
    assert document["controller"] is False
    assert document["camera"] is True
    assert (await station.client.get("/state")).status_code == 503
    assert refused(await station.post("/operations/local-track"), 503, "link.shutdown")
    assert refused(await station.post("/operations/look"), 503, "link.shutdown")
    assert (await station.post("/stop")).status_code == 503


async def test_without_a_camera(station: Bench) -> None:
    station.eyes.connected = False
    refused(await station.client.get("/health"), 503, "link.degraded")
    refused(await station.post("/operations/look"), 503, "link.camera_silent")
    await station.post("/enable")
    await station.succeeded("move", {"offset_base_m": [0.0, 0.05, 0.0]})
