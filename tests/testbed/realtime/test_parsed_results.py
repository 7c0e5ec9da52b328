"""What a program returns and what is read from the API's answer of it are the same."""

import numpy as np
import pytest

from protocol.errors import LinkLost
from testbed.demonstration.sequence import note_of
from testbed.realtime.rest_rig import RESULT_OF, look_of
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
from vision_pc.core.types import Look, MisplacedMarker, StereoOffset

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


def test_a_look_without_the_arms_pose_is_a_lost_link() -> None:
    unknown, spread = np.full((4, 4), np.nan), 1e-6 * np.eye(6)
    look = Look(7, X, np.eye(4), unknown, 5, 1, 2, spread, spread, spread, spread, None)
    told = look_json(JudgedLook(look, VERDICT))
    assert told["X_BT"] is None
    with pytest.raises(LinkLost) as lost:
        look_of(told)
    assert lost.value.cause == "link.not_connected"


def test_a_look_then_move() -> None:
    spread = np.array([[4e-6, -1e-6, 0.0], [-1e-6, 1e-6, 0.0], [0.0, 0.0, 9e-6]])
    step = Step(LENGTHS_M, X, expected_end(np.array([1e-3, 0.0, 0.0]), spread, 0.005, 4.0))
    result = PositioningResult((VERDICT, VERDICT), (step,), Ended.INPUT_LIMIT)
    read = RESULT_OF["look-then-move"](positioning_json(result))
    assert read.ended is Ended.INPUT_LIMIT
    assert (len(read.looks), len(read.steps)) == (2, 1)
    assert np.allclose(read.steps[0].p_lc, step.p_lc)
    assert np.allclose(read.steps[0].X_BT_ref, X)
    assert np.allclose(read.steps[0].expected.covariance, spread, atol=1e-9)
    assert read.steps[0].expected.freedom == 4.0
    assert abs(read.steps[0].expected.inside - step.expected.inside) < 1e-3
    assert np.allclose(read.final.error_m, VERDICT.error_m)
    assert (read.final.inside, read.final.certain, read.final.tolerance_m) == (False, True, 0.005)
    assert note_of(read) == note_of(result) != ""
    assert "CONTRADICTED" not in note_of(result)
    assert "CONTRADICTED" in note_of(result._replace(ended=Ended.CONTRADICTED))


def test_an_orientation_adjustment() -> None:
    result = OrientationResult((0.1 * LENGTHS_M, 0.01 * LENGTHS_M), (np.eye(3),), (0.002,))
    read = RESULT_OF["orientation-adjustment"](orientation_json(result))
    assert np.allclose(read.errors, result.errors, atol=1e-6)
    assert np.allclose(read.tool_shift_m, result.tool_shift_m)
    assert note_of(read) == note_of(result) != ""


def test_a_local_calibration() -> None:
    covariance = np.diag([1e-6, 2e-6, 4e-6])
    table = ResidualTable(LENGTHS_M, 2.0 * LENGTHS_M)
    result = LocalCalibration(np.eye(3), None, covariance, table, 9.0, "points/time", 90, 0.9, 0.75, 1.01)
    read = RESULT_OF["trajectory-matching"](calibration_json(result))
    assert np.isclose(read.rotation_std(), 2e-3)
    assert np.allclose(read.residuals.maximum_m, table.maximum_m)
    assert (read.R_TC, read.samples, read.method) == (None, 90, "points/time")
    assert note_of(read) == note_of(result) != ""


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
