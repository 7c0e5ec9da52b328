"""What a program returns and what is read from the API's answer of it are the same."""

from unittest.mock import Mock, patch

import httpx
import numpy as np
import pytest

from protocol.errors import LinkLost
from testbed.demonstration.sequence import note_of
from testbed.realtime.rest_rig import RestRig, answered, look_of
from testbed.reporting.run_directory import warnings_in
from vision_pc.application.results import (
    JudgedLook,
    calibration_json,
    look_json,
    orientation_json,
    positioning_json,
)
from vision_pc.core.calibration.local_calibration import LocalCalibration, ResidualTable
from vision_pc.core.calibration.orientation import OrientationResult
from vision_pc.core.positioning.expected_end import expected_end
from vision_pc.core.positioning.look_then_move import Ended, LookVerdict, PositioningResult, Step
from vision_pc.core.se3 import transform
from vision_pc.core.types import Contradiction, Look, MisplacedMarker, StereoOffset

X = transform(np.diag([1.0, -1.0, -1.0]), np.array([0.1, -0.2, 1.3]))
LENGTHS_M = np.array([0.012, -0.0035, 0.4])
VERDICT = LookVerdict(LENGTHS_M, np.diag(LENGTHS_M**2) / 100, 0.005, 0.1, inside=False, certain=True)


def test_a_look() -> None:
    spread = np.diag(np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) * 1e-6)
    doubted = MisplacedMarker(2, np.array([-0.01, 0.0005]), np.array([0.001, 0.0012]))
    offset = StereoOffset(0.1, 0.2, 1, 1)
    look = Look(7, X, np.eye(4), X, 5, 1, 2, spread, 4.0 * spread, spread, spread, offset, doubted)
    read, verdict = look_of(look_json(JudgedLook(look, VERDICT)))
    assert (read.time_ns, read.frames, read.failed_tool, read.failed_object) == (7, 5, 1, 2)
    assert np.allclose((read.X_CM, read.X_CO, read.X_BT), (X, np.eye(4), X))
    assert np.allclose(read.cov_CM, look.cov_CM, rtol=1e-2)
    assert np.allclose(read.cov_CO, look.cov_CO, rtol=1e-2)
    assert np.isnan(read.frame_cov_CM).all()
    assert read.misplaced is not None
    assert str(read.misplaced) == str(doubted)
    assert "marker 2 is seen 10.0 mm from" in str(doubted)
    assert np.allclose(read.misplaced.std_m, doubted.std_m)
    assert read.offset is not None
    assert (read.offset.x_px, read.offset.y_px) == (0.1, 0.2)
    assert np.allclose(verdict.error_m, VERDICT.error_m)
    assert np.allclose(verdict.std_m, VERDICT.std_m)
    assert (verdict.inside, verdict.certain, verdict.tolerance_m) == (False, True, 0.005)


def test_programs_say_how_good_they_were() -> None:
    spread = np.array([[4e-6, -1e-6, 0.0], [-1e-6, 1e-6, 0.0], [0.0, 0.0, 9e-6]])
    step = Step(LENGTHS_M, X, expected_end(np.array([1e-3, 0.0, 0.0]), spread, 0.005, 4.0))
    result = PositioningResult((VERDICT, VERDICT), (step,), Ended.INPUT_LIMIT)
    note = note_of(positioning_json(result))
    assert note.startswith("step 12.0/-3.5/400.0 mm in the base, expected to end within 2.0/1.0/3.0 mm")
    assert note.endswith("found outside the tolerance, and so are the 95 % intervals")
    doubted = result._replace(contradiction=Contradiction("object", 0.01, 0.0, 1))
    assert "CONTRADICTED; the object was seen 10.0 mm" in note_of(positioning_json(doubted))
    assert note_of(positioning_json(result._replace(steps=()))) == "already at the aim: no step was made"
    turned = OrientationResult((np.radians(LENGTHS_M), np.zeros(3)), (np.eye(3),), (0.002,))
    assert note_of(orientation_json(turned)) == "Euler angles 0.0/-0.0/0.4° before, 0.0/0.0/0.0° after"
    table = ResidualTable(LENGTHS_M, 2.0 * LENGTHS_M)
    calibration = LocalCalibration(np.eye(3), None, np.eye(3), table, 9.0, "points/time", 90, 0.9, 0.75, 1.01)
    assert note_of(calibration_json(calibration)).endswith(
        "mean 12.0/-3.5/400.0 mm, greatest 24.0/-7.0/800.0 mm"
    )


def test_what_events_ask_a_person_to_do_is_said_once() -> None:
    doubted = MisplacedMarker(2, np.array([-0.01, 0.0005]), np.array([0.001, 0.0012]))
    looked = {"event": "look", "misplaced_marker": {"id": 2, "detail": str(doubted)}}
    events = [
        looked,
        looked,
        {"event": "look", "misplaced_marker": None},
        {"event": "controller", "what": {"name": "parked", "cause": "VALVES_SHUT"}},
        {"event": "fault", "what": "text"},
    ]
    assert warnings_in(events) == [str(doubted)]


@pytest.mark.parametrize("url", [
    "http://127.0.0.1:99999", "http://127.0.0.1:0", "http://[::1", "http://h:x",
    "127.0.0.1:8000", "localhost:8000", "ftp://127.0.0.1", "http:///", "http://127.0.0.1?x", " http://127.0.0.1",
])  # fmt: skip
def test_an_address_that_is_none_is_asked_nothing(url: str) -> None:
    """A port of 99999 was port 34463, which got the token."""
    with pytest.raises(LinkLost, match=r"wanted http://HOST:PORT") as refused:
        RestRig(url, b"token")
    assert refused.value.cause == "link.rest"


@pytest.mark.parametrize(
    ("status", "content", "told"),
    [
        (200, b"<html>", "200 OK"),
        (200, b"[1]", "200 OK"),
        (200, b"[" * 100_000, "200 OK"),
        (200, b'{"a": "\xff', "200 OK"),
        (502, b"null", "502 Bad Gateway"),
        (500, b'["x"]', "500 Internal Server Error"),
        (301, b"", "301 Moved Permanently, which leads to https://other/"),
    ],
)
def test_an_answer_of_somebody_else_is_told_as_one(status: int, content: bytes, told: str) -> None:
    asked = httpx.Request("GET", "http://user:secret@host/state")
    location = {"location": "https://other/"} if status == 301 else {}
    with pytest.raises(LinkLost, match="something else than Longreach") as refused:
        answered(httpx.Response(status, content=content, headers=location, request=asked))
    assert refused.value.cause == f"rest.{status}"
    assert f"http://host/state: {told}" in str(refused.value)


def test_an_object_of_another_service_is_told_as_one() -> None:
    rig = RestRig("http://host")
    foreign = httpx.Response(200, content=b'{"status": "up"}', request=httpx.Request("GET", "http://host/x"))
    with patch.object(httpx.Client, "send", return_value=foreign):
        for ask in (rig.now_ns, rig.latest_look, lambda: rig.result("look", {}, Mock())):
            with pytest.raises(LinkLost, match=r"http://host/x: 200 OK with no '\w+' in it: something else"):
                ask()
    rig.close()


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (httpx.RemoteProtocolError("illegal request line"), "no whole answer in HTTP"),
        (httpx.ConnectError("[SSL: WRONG_VERSION_NUMBER] wrong (_ssl.c:1006)"), "are mixed up"),
        (httpx.ConnectError("[Errno 111] Connection refused"), "http://host/state: Connection refused;"),
    ],
)
def test_what_fails_below_an_answer_is_told_in_our_words(error: httpx.HTTPError, told: str) -> None:
    rig = RestRig("http://user:secret@host")
    with patch.object(httpx.Client, "send", side_effect=error), pytest.raises(LinkLost) as refused:
        rig.state()
    rig.close()
    assert told in str(refused.value)
    assert "secret" not in str(refused.value)
