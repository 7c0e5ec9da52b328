"""Bad input of the eyes and of local calibration: one numbered test for each way in which it comes.

Every operation must fail with a cause that a program can read; the arm must then be at rest, and stay so, in
the plant's truth and in the controller's own state; and where a measurement failed, no number may be left
behind. They run in lockstep, on the pictures of the plant's camera, with the plant's own faults.
"""

from typing import Any

import numpy as np
import pytest

from plant_emulator.core.faults.kinds import CameraBlind, CameraFrozen, Fault, FramesDropped, MarkerCovered
from protocol.errors import LongreachError, RequestRefused
from protocol.faults import FaultCode, GroupState
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import LockstepRig
from testbed.reporting.console import bars
from tests.faults.rig import settings_of

pytestmark = pytest.mark.slow("pictures are drawn for calibrations")

MS = 1_000_000
HELD_M = 1e-3  # what leakage past shut valves, and the servo against it, move the tool within a second
TOOL = 0
ALL_MARKERS = (0, 1, 2, 3)

QUICK = (  # a short path and a slower camera: the same programs, a fifth of the pictures
    "scene.camera.rate_hz=5",
    "vision.look.frames=6",
    "vision.programs.trajectory.segments_m=[0.12, 0.05, 0.03]",
    "vision.programs.trajectory.placement=starts_here",
    "vision.programs.trajectory.dwell_s=0.1",
    "vision.programs.local_map.leg_m=0.08",
    "vision.programs.local_map.dwell_s=0.1",
)
MID_PATH_MS = 2_000  # after the path was asked for, of the six seconds that it takes


def station(*assignments: str) -> LockstepRig:
    """A station in simulated time, enabled and at rest."""
    rig = LockstepRig(settings_of(1, (*QUICK, *assignments)), 1, RunLog())
    rig.command("enable")
    pass_time(rig, 200 * MS)
    return rig


def pass_time(rig: LockstepRig, duration_ns: int) -> None:
    until_ns = rig.world.time_ns + duration_ns
    while rig.world.time_ns < until_ns:
        rig.world.clock.advance()


def operate(rig: LockstepRig, kind: str, **body: Any) -> Any:
    with bars(quiet=True) as shown, shown.step(kind) as bar:
        return rig.operate(kind, body, bar)


def broken(rig: LockstepRig, fault: Fault, after_ms: int = 0) -> LockstepRig:
    """The rig, with ``fault`` in force from ``after_ms`` on, for good."""
    rig.world.plant.inject(fault, start_ns=rig.world.time_ns + after_ms * MS)
    return rig


def fails(rig: LockstepRig, kind: str, cause: str, *, moved: bool, **body: Any) -> LongreachError:
    """How ``kind`` fails: with ``cause``, the arm at rest, and nothing recorded as a number.

    ``moved``: whether the arm was on its way before it failed.
    """
    began, seen = tool(rig), len(rig.world.truths)
    with pytest.raises(LongreachError) as caught:
        operate(rig, kind, **body)
    assert caught.value.cause == cause, str(caught.value)
    assert str(caught.value), "it says what happened"
    assert "\n" not in str(caught.value)
    assert_at_rest(rig)
    farthest = max(np.linalg.norm(truth.X_WT[:3, 3] - began) for truth in rig.world.truths[seen:])
    assert (farthest > 0.02) == moved
    assert (rig.link.state.motion_id != 0) == moved
    assert_no_numbers(rig, kind, cause)
    return caught.value


def assert_at_rest(rig: LockstepRig) -> None:
    """Asserts that the true tool stays where it is for a second, and that the controller says so."""
    pass_time(rig, 100 * MS)  # in which a stop is carried out
    motion, before = rig.link.state.motion_id, tool(rig)
    farthest = 0.0
    for _ in range(10):
        pass_time(rig, 100 * MS)
        farthest = max(farthest, float(np.linalg.norm(tool(rig) - before)))
    state = rig.link.state
    assert (state.group_state, state.fault) == (GroupState.STANDBY, FaultCode.NONE)
    assert state.motion_id == motion, "nothing new was begun"
    assert farthest < HELD_M


def assert_no_numbers(rig: LockstepRig, kind: str, cause: str) -> None:
    """Asserts that neither station nor log holds a result of what failed."""
    assert rig.application.calibration is None
    assert rig.application.track is None
    with pytest.raises(RequestRefused) as none_yet:
        rig.latest_look()
    assert none_yet.value.cause == "refused.no_look_yet"
    events = rig.world.log.events
    assert not [event for event in events if event["event"] in ("look", "operation_ended")]
    ended = [(event["kind"], event["cause"]) for event in events if event["event"] == "operation_failed"]
    assert ended == [(kind, cause)]


def tool(rig: LockstepRig) -> np.ndarray:
    """The true place of the tool, m in W."""
    return np.array(rig.world.plant.truth().X_WT[:3, 3])


def test_01_markers_never_seen() -> None:
    rig = station()
    for marker in ALL_MARKERS:
        broken(rig, MarkerCovered(marker_id=marker, share=1.0))
    error = fails(rig, "orientation-adjustment", "measurement.tool_not_seen", moved=False)
    assert "seen in 0 of 6 frames, at least 3" in str(error)


def test_02_a_marker_seen_once_only() -> None:
    """Of a tool that nobody has drawn: with its outline, once with the marker is enough."""
    rig = broken(station(), MarkerCovered(marker_id=TOOL, share=0.6), after_ms=250)
    error = fails(rig, "look", "measurement.tool_not_seen", moved=False)
    assert "seen in 1 of 6 frames, at least 3" in str(error)


@pytest.mark.parametrize(
    ("told", "cause"),
    [
        ("vision.markers.tool.size_m=0.13", "measurement.tool_wrong_size"),
        (
            "vision.markers.object=[{id: 1, size_m: 0.15, x_m: -0.2, y_m: 0}, "
            "{id: 2, size_m: 0.15, x_m: 0.2, y_m: 0}, {id: 3, size_m: 0.15, x_m: 0, y_m: 0.2}]",
            "measurement.object_wrong_size",
        ),
    ],
)
def test_03_a_marker_of_the_wrong_size_is_found_by_stereo(told: str, cause: str) -> None:
    fails(station(told), "orientation-adjustment", cause, moved=False)


def test_04_markers_of_the_wrong_dictionary() -> None:
    rig = station("vision.markers.dictionary=DICT_4X4_1000")
    fails(rig, "orientation-adjustment", "measurement.tool_not_seen", moved=False)


def test_05_a_pose_that_may_be_flipped() -> None:
    """One distant marker, one eye, coarse corners: both planar poses explain what is seen."""
    rig = station(
        "scene.object_of_interest.position_m=[6.5, 0.3, 1.09]",
        "vision.markers.corner_std_px=0.5",
        "vision.markers.residual_limit_px=3.0",
    )
    for marker in (2, 3):
        broken(rig, MarkerCovered(marker_id=marker, share=1.0))
    observe = rig.eyes._sensor.observe
    rig.eyes._sensor.observe = lambda pair, previous: observe(  # type: ignore[method-assign]
        pair._replace(right=np.full_like(pair.right, 118)), previous
    )
    fails(rig, "orientation-adjustment", "measurement.object_ambiguous", moved=False)


@pytest.mark.parametrize("stamps", ["advance", "hold"])
def test_06_the_camera_freezes_mid_path(stamps: str) -> None:
    rig = broken(station(), CameraFrozen.model_validate({"stamps": stamps}), MID_PATH_MS)
    fails(rig, "trajectory-matching", "link.camera_frozen", moved=True)


def test_07_a_camera_that_froze_between_two_looks_is_not_looked_through() -> None:
    rig = broken(station(), CameraFrozen())
    fails(rig, "look", "link.camera_frozen", moved=False)


def test_08_the_camera_drops_all_frames_mid_path() -> None:
    rig = broken(station(), FramesDropped(), MID_PATH_MS)
    fails(rig, "trajectory-matching", "link.camera_silent", moved=True)


def test_09_the_camera_drops_half_the_frames_of_the_path() -> None:
    rig = broken(station("vision.programs.trajectory.minimum_samples=30"), FramesDropped(share=0.5))
    fails(rig, "trajectory-matching", "measurement.too_few_samples", moved=True)


def test_10_odometry_is_lost_when_the_lights_go_out_mid_path() -> None:
    rig = broken(station(), CameraBlind(grey=0), MID_PATH_MS)
    error = fails(rig, "trajectory-matching", "measurement.odometry_lost", moved=True)
    assert "limit 20%" in str(error)


def test_11_odometry_is_lost_on_the_local_track() -> None:
    rig = broken(station(), CameraBlind(grey=255), MID_PATH_MS)
    fails(rig, "local-track", "measurement.odometry_lost", moved=True)


@pytest.mark.parametrize(
    ("kind", "body", "cause"),
    [
        ("trajectory-matching", {"segments_m": [1.5, 1.0], "heading_deg": 90.0}, "refused.outside_workspace"),
        ("trajectory-matching", {"segments_m": [1.5, 1.5]}, "refused.unreachable"),
        (
            "trajectory-matching",
            {"segments_m": [1.5, 1.5], "placement": "ends_here"},
            "refused.unreachable",
        ),
        ("move", {"offset_base_m": [0.0, 0.0, -2.5]}, "refused.outside_workspace"),
    ],
)
def test_12_a_path_that_leaves_the_workspace(kind: str, body: dict[str, Any], cause: str) -> None:
    fails(station(), kind, cause, moved=False, **body)


@pytest.mark.parametrize(
    ("segments_m", "association", "cause"),
    [
        ([0.2, 0.2, 0.2, 0.2, 0.2], "time", "measurement.path_symmetric"),
        ([0.2, 0.2, 0.2, 0.2], "none", "measurement.path_symmetric"),
        ([0.3, 0.02], "time", "measurement.path_straight"),
    ],
)
def test_13_a_path_that_fixes_no_rotation(segments_m: list[float], association: str, cause: str) -> None:
    body = {"segments_m": segments_m, "association": association}
    fails(station(), "trajectory-matching", cause, moved=False, **body)
