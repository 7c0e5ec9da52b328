"""What a console is shown: alarms from beginning to end, pixels of the overlay, the arm's line."""

import re
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import foundation.live
import foundation.rest
import protocol
import vision_pc
from foundation.configuration import load
from foundation.incidents import ServiceIncident
from nominal_arm.description import NominalArm
from nominal_arm.dimensions import dh_links, skeleton
from plant_emulator.shell import fault_api
from protocol.faults import FAULT_TEXTS, FaultCode, GroupState, Reason
from tests.support.paths import CONFIGS
from tests.vision_pc import synthetic
from tests.vision_pc.shell.loopback_controller import until
from tests.vision_pc.synthetic_station import CAMERA, TOOL_ID, bench, observed
from vision_pc.application.console.advice import advice
from vision_pc.application.console.alarms import (
    HIGH,
    LOW,
    OFF_DELAY_S,
    URGENT,
    AlarmList,
    Condition,
    alarm_json,
)
from vision_pc.application.console.overlay import overlay
from vision_pc.application.console.overview import Overview, conditions, lasting, predicted_by
from vision_pc.application.ports import Seen
from vision_pc.core.types import Look


def test_an_alarm_lasts_from_its_first_to_its_last_moment() -> None:
    alarms = AlarmList()
    alarms.update(10.0, {"link.camera_silent": Condition(HIGH, "no picture")})
    alarms.update(
        11.0,
        {"link.camera_silent": Condition(HIGH, "still none"), "fault.overrun": Condition(URGENT, "late")},
    )
    assert [(a.cause, a.began_s, a.ended_s) for a in alarms.rows] == [
        ("fault.overrun", 11.0, None),  # the urgent one first
        ("link.camera_silent", 10.0, None),
    ]
    assert alarms.rows[1].detail == "still none"
    late = {"fault.overrun": Condition(URGENT, "late")}
    alarms.update(12.0, late)
    alarms.update(12.0 + OFF_DELAY_S, late)
    assert [(a.cause, a.ended_s) for a in alarms.rows] == [
        ("fault.overrun", None),
        ("link.camera_silent", 12.0),
    ]
    alarms.update(20.0, {"link.camera_silent": Condition(HIGH, "again")} | late)
    assert [(a.cause, a.began_s, a.times) for a in alarms.rows] == [
        ("fault.overrun", 11.0, 1),
        ("link.camera_silent", 20.0, 2),  # a row a cause
    ]


def test_what_is_gone_for_a_moment_does_not_chatter() -> None:
    alarms = AlarmList()
    for tenth in range(100):
        silent = {"link.camera_silent": Condition(HIGH, "no picture")}
        alarms.update(0.1 * tenth, silent if tenth % 10 else {})
    assert [(a.cause, a.times, a.ended_s) for a in alarms.rows] == [("link.camera_silent", 1, None)]


def test_what_happened_is_kept_and_what_is_kept_is_bounded() -> None:
    alarms = AlarmList()
    for second in range(1000):
        alarms.happened(float(second), "measurement.object_not_seen", "look: not seen")
        alarms.happened(float(second), f"measurement.number_{second}", "another")
    assert len(alarms.rows) == 100
    newest = alarm_json(alarms.rows[1])
    assert (newest["began_at"], newest["ended_at"], newest["priority"]) == (999.0, 999.0, LOW)
    assert newest["count"] == 1000
    assert "markers" in newest["advice"]


def test_a_motion_that_a_fault_ended_has_the_faults_advice() -> None:
    assert advice("refused.fault_overrun") == advice("fault.overrun")


@pytest.mark.parametrize("fault", [fault for fault in FaultCode if fault is not FaultCode.NONE])
def test_every_fault_says_what_to_do(fault: FaultCode) -> None:
    assert FAULT_TEXTS[fault]
    assert advice(f"fault.{fault.name.lower()}") != advice("fault.another")


def test_no_cause_that_the_api_answers_falls_through_to_its_area() -> None:
    packages = [vision_pc, foundation.rest, foundation.live, protocol]
    files = [file for package in packages for file in Path(package.__path__[0]).rglob("*.py")]
    files.append(Path(fault_api.__file__))
    written = "\n".join(file.read_text(encoding="utf-8") for file in files)
    causes = set(re.findall(r'"((?:measurement|target|refused|request|motion)\.[a-z_.]*[a-z])"', written))
    causes |= {f"refused.{reason.name.lower()}" for reason in Reason if reason is not Reason.ACCEPTED}
    of_commands = {cause for cause in causes if re.match(r"\w+\.(camera|intrinsics)\.", cause)}
    of_bytes = {"refused.not_encodable"}  # a defect of ours: a client that fills in its own message wrongly
    assert len(causes) > 170
    assert [
        c
        for c in sorted(causes - of_commands - of_bytes)
        if advice(c) == advice(f"{c.partition('.')[0]}.new")
    ] == []


@pytest.mark.realtime
async def test_what_is_wrong_is_found() -> None:
    async with bench() as made:
        rig = made.station
        assert conditions(rig) == {}
        state = rig.controller.state
        broken = state._replace(group_state=GroupState.ERROR_STOP, fault=FaultCode.OVERRUN, flags=0)
        silent = rig.camera.status()._replace(trouble="link.camera_silent")
        stub: Any = SimpleNamespace(
            incidents=rig.incidents,
            doubts=rig.doubts,
            log=SimpleNamespace(healthy=False),
            controller=SimpleNamespace(state=broken, heard_at_s=0.0),
            camera=SimpleNamespace(status=lambda: silent),
        )
        assert {cause: condition.priority for cause, condition in conditions(stub).items()} == {
            "fault.overrun": URGENT,
            "link.plant_silent": URGENT,
            "link.camera_silent": HIGH,
            "recording.unwritable": HIGH,
        }


@pytest.mark.realtime
async def test_what_became_of_the_services_is_an_alarm_once_and_stands_in_the_state() -> None:
    async with bench() as made:
        crash = ServiceIncident(
            90.0, "controller", "service.crashed", "controller crashed with signal SIGKILL"
        )
        made.station.incidents = lambda: (crash,)
        overview = Overview(made.station.links)
        for now_s in (100.0, 101.0):
            overview.note(now_s, made.station)
        (row,) = overview.document(made.station, None)["alarms"]
        assert (row["cause"], row["began_at"], row["detail"]) == (crash.cause, 90.0, crash.detail)
        assert "log" in row["advice"]
        assert (await made.client.get("/state")).json()["incidents"] == [crash._asdict()]


@pytest.mark.realtime
async def test_a_crash_stands_first_until_the_service_is_heard_again() -> None:
    async with bench(link_timeout_ms=400) as made:
        link, overview = made.station.controller, Overview(made.station.links)
        made.silence()
        crash = ServiceIncident(time.time(), "controller", "service.crashed", "controller crashed")
        made.station.incidents = lambda: (crash,)
        await until(lambda: not link.connected)
        overview.note(crash.at_s + 1.0, made.station)
        first, second = overview.document(made.station, None)["alarms"]
        assert (first["cause"], first["began_at"], first["ended_at"]) == (crash.cause, crash.at_s, None)
        assert second["cause"].startswith("link.")
        health = await made.client.get("/health")
        assert (health.status_code, health.json()["controller"]) == (503, False)
        assert health.json()["detail"].startswith("controller crashed; not answering: controller; link.")
        made.controller.muted = False
        await until(lambda: link.connected and not lasting(made.station))
        for later_s in (2.0, 9.0):
            overview.note(crash.at_s + later_s, made.station)
        rows = overview.document(made.station, None)["alarms"]
        assert {row["cause"]: row["ended_at"] is None for row in rows}[crash.cause] is False
        assert (await made.client.get("/health")).status_code == 200


@pytest.mark.realtime
async def test_a_crash_of_the_plant_is_over_with_its_first_picture() -> None:
    async with bench() as made:
        crash = ServiceIncident(time.time() - 5.0, "plant_emulator", "service.crashed", "plant crashed")
        own = ServiceIncident(time.time(), "vision_pc", "service.crashed", "vision crashed")
        made.station.incidents = lambda: (crash, own)
        for made.eyes.age_ms, expected in ((None, [crash]), (5100.0, [crash]), (3000.0, [])):
            assert lasting(made.station) == expected


def a_look() -> Look:
    rig = synthetic.SyntheticRig(synthetic.draw(np.random.default_rng(3)), 3)
    X_CM, X_CO = np.eye(4), np.eye(4)
    X_CM[:3, 3], X_CO[:3, 3] = (0.02, -0.01, 0.8), (0.03, 0.05, 0.92)
    cov = 1e-8 * np.eye(6)
    return Look(0, X_CM, X_CO, synthetic.forward(rig.q), 1, 0, 0, cov, cov, cov, cov, None)


def pixel(point: np.ndarray) -> np.ndarray:
    """A pinhole's pixel, by hand."""
    K = CAMERA.left.K
    return np.array([K[0, 0] * point[0] / point[2] + K[0, 2], K[1, 1] * point[1] / point[2] + K[1, 2]])


def test_the_overlay_is_where_the_points_are() -> None:
    look = a_look()
    ellipse_mm = {"major": 3.0, "minor": 1.0, "angle_deg": 90.0}
    told = {"mean_mm": {"x": 4.0, "y": -1.0}, "ellipse_95_mm": ellipse_mm}
    drawn = overlay(Seen(observed(look, 5), CAMERA, TOOL_ID), 0.1, 0.005, told)
    aim = np.array([0.03, 0.05, 0.82])
    assert drawn["error_mm"] == pytest.approx([10.0, 60.0, 20.0])
    assert drawn["aim"]["at"] == pytest.approx(pixel(aim), abs=0.01)
    assert drawn["aim"]["square"][0] == pytest.approx(pixel(aim - [0.005, 0.005, 0.0]), abs=0.01)
    assert drawn["tool"]["origin"] == pytest.approx(pixel(look.X_CM[:3, 3]), abs=0.01)
    assert drawn["object"]["x"] == pytest.approx(pixel(look.X_CO[:3, 3] + [0.06, 0.0, 0.0]), abs=0.01)
    assert [marker["role"] for marker in drawn["markers"]] == ["tool", "object"]
    ellipse = np.array(drawn["aim"]["ellipse"])
    centre = pixel(aim - [0.004, -0.001, 0.0])  # the error is aim minus tool
    assert ellipse.mean(axis=0) == pytest.approx(centre, abs=0.02)
    scale = CAMERA.left.K[0, 0] / 0.82
    assert np.ptp(ellipse, axis=0) == pytest.approx([2 * 0.001 * scale, 2 * 0.003 * scale], rel=0.02)


def test_what_was_not_seen_is_not_drawn() -> None:
    unseen = observed(a_look(), 5)._replace(X_CO=None, missing_object="ambiguous")
    drawn = overlay(Seen(unseen, CAMERA, TOOL_ID), 0.1, 0.005, None)
    assert (drawn["aim"], drawn["object"], drawn["error_mm"]) == (None, None, None)
    assert drawn["missing"]["object"] == "ambiguous"
    behind = observed(a_look(), 5)._replace(X_CO=np.diag([1.0, 1.0, 1.0, 1.0]))
    assert overlay(Seen(behind, CAMERA, TOOL_ID), 0.1, 0.005, None)["object"] is None


def test_the_arms_line_ends_at_the_tool() -> None:
    links = dh_links(load(NominalArm, CONFIGS / "arm.yaml"))
    q = tuple(np.radians([20.0, 40.0, -60.0, 5.0, -20.0, 10.0]))
    points = skeleton(links, q)
    assert points.shape == (8, 3)
    expected = np.array([X[:3, 3] for X in synthetic.chain(np.array(q))])
    assert points == pytest.approx(expected, abs=1e-4)


def test_only_a_drive_tells_where_it_ends() -> None:
    told = {
        "mean_mm": {"x": 1.0, "y": -2.0},
        "ellipse_95_mm": {"major": 3.0, "minor": 1.0, "angle_deg": 45.0},
    }
    assert predicted_by("look-then-move", {"steps": [{"expected": told}]}) == told
    assert predicted_by("look-then-move", {"steps": [{"expected": {}}], "seen": told}) == told
    assert predicted_by("look-then-move", {"steps": []}) is None
    assert predicted_by("move", {"steps": [{"expected": told}]}) is None
