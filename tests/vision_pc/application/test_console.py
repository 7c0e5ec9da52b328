"""What a console is shown: alarms from beginning to end, pixels of the overlay, the arm's line."""

import math
import re
from pathlib import Path

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
from vision_pc.application.console.overlay import PredictedEllipse, overlay
from vision_pc.application.console.overview import Overview, conditions, ellipse_of, glimpse, told_by
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


def test_overload_is_told_first_of_what_it_may_have_caused() -> None:
    assert advice("link.camera_silent", overloaded=True).startswith("This machine does not keep up")
    assert advice("refused.no_token", overloaded=True) == advice("refused.no_token")
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
async def test_what_is_wrong_is_found_in_a_glimpse() -> None:
    async with bench() as made:
        assert conditions(glimpse(made.station)) == {}
        made.station.overload = lambda: "3 % late"
        seen = glimpse(made.station)
        assert seen.state is not None
        broken = seen.state._replace(group_state=GroupState.ERROR_STOP, fault=FaultCode.OVERRUN, flags=0)
        silent = seen.camera._replace(trouble="link.camera_silent")
        wrong = conditions(seen._replace(state=broken, camera=silent, recording=False))
        assert {cause: condition.priority for cause, condition in wrong.items()} == {
            "fault.overrun": URGENT,
            "link.plant_silent": URGENT,
            "link.camera_silent": HIGH,
            "recording.unwritable": HIGH,
            "machine.overloaded": LOW,
        }
        lost = conditions(seen._replace(state=None, trouble=("link.silent", "no state")))
        assert lost["link.silent"] == Condition(URGENT, "no state")


@pytest.mark.realtime
async def test_what_became_of_the_services_is_an_alarm_once_and_stands_in_the_state() -> None:
    async with bench() as made:
        crash = ServiceIncident(
            90.0, "controller", "service.crashed", "controller crashed with signal SIGKILL"
        )
        made.station.incidents = lambda: (crash,)
        overview = Overview(made.station.links)
        for now_s in (100.0, 101.0):
            overview.note(now_s, glimpse(made.station))
        (row,) = overview.document(glimpse(made.station), None)["alarms"]
        assert (row["cause"], row["began_at"], row["detail"]) == (crash.cause, 90.0, crash.detail)
        assert "log" in row["advice"]
        assert (await made.client.get("/state")).json()["incidents"] == [crash._asdict()]


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
    told = PredictedEllipse((0.004, -0.001), 0.003, 0.001, math.radians(90.0))
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
    assert told_by("look-then-move", {"steps": [{"expected": told}]}) == told
    assert told_by("look-then-move", {"steps": [{"expected": {}}], "seen": told}) == told
    assert told_by("look-then-move", {"steps": []}) is None
    assert told_by("move", {"steps": [{"expected": told}]}) is None
    assert ellipse_of(None) is None
    assert ellipse_of(told) == PredictedEllipse((0.001, -0.002), 0.003, 0.001, pytest.approx(math.pi / 4))
