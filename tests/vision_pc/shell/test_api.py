"""The REST face in process: whole procedure and operations, over a simulated arm."""

import numpy as np
import pytest

from tests.vision_pc.shell.loopback_controller import until
from tests.vision_pc.shell.problems import refused
from tests.vision_pc.synthetic_station import Bench, bench

pytestmark = pytest.mark.realtime


@pytest.mark.slow("motions in real time")
async def test_the_whole_procedure_brings_the_tool_inside_5_mm(station: Bench) -> None:
    assert (await station.post("/enable")).json()["group_state"] == "standby"
    before = np.abs(station.rig.true_error(0.1)[:2]).max()
    await station.succeeded("orientation-adjustment")
    assert station.rig.true_orientation_error() < np.radians(0.3)
    matched = await station.succeeded("trajectory-matching")
    assert matched["result"]["rotation_std_deg"] < 2.0
    for _ in range(2):
        moved = await station.succeeded("look-then-move", {"method": "paper", "inputs": 1, "aim_mm": 0.0})
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


@pytest.mark.slow("motions in real time")
async def test_best_mode_needs_one_look(station: Bench) -> None:
    await station.post("/enable")
    await station.run("orientation-adjustment")
    await station.succeeded("local-track")
    moved = await station.succeeded("look-then-move")
    assert len(moved["result"]["looks"]) == 2  # one before, one for the verdict
    assert np.abs(station.rig.true_error(0.1)[:2]).max() < 0.005
    assert abs(moved["result"]["measured_miss_mm"]["x"]) < 5.0


async def test_one_operation_at_a_time(station: Bench) -> None:
    station.eyes.look_s = 0.3
    first = await station.post("/operations/look")
    document = refused(await station.post("/operations/look"), 409, "refused.busy")
    assert first.json()["id"] in document["detail"]
    assert (await station.client.get("/state")).json()["operation"] == first.json()["id"]
    await station.ended(first.headers["Location"])
    await station.succeeded("look")


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


async def test_what_moved_stays_in_doubt_until_a_person_says_that_it_stands(station: Bench) -> None:
    await station.post("/enable")
    await station.succeeded("look")
    station.rig.truth.X_BO[0, 3] += 0.02
    look = (await station.succeeded("look"))["result"]
    assert look["doubt"]["shift_mm"] == pytest.approx(20.0, abs=1.0)
    doubt = (await station.client.get("/state")).json()["doubt"]
    assert doubt == look["doubt"]
    assert "does it move?" in doubt["detail"]
    assert (await station.succeeded("look"))["result"]["doubt"] == doubt
    assert (await station.client.delete("/doubt")).json() == {"doubt": doubt}
    assert (await station.client.get("/state")).json()["doubt"] is None
    assert (await station.client.delete("/doubt")).json() == {"doubt": None}
    assert [event["event"] for event in station.events("doubt_raised") + station.events("doubt_ended")] == [
        "doubt_raised",
        "doubt_ended",
    ]
