"""A recording in the operator's page: what was so then is shown, nothing can be asked; it moves as told."""

from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from controller.shell.scan_recorder import STATE, StateMessage
from foundation.recording.reading import RecordingUnreadable
from foundation.recording.recording_thread import DirectRecording
from protocol.errors import RequestRefused
from testbed.recordings.console.moments import Moments
from testbed.recordings.console.server import RecordedConsole, recorded_app
from testbed.recordings.console.shown_pictures import AS_KEPT, RENDERED, ShownPictures
from testbed.recordings.console.timeline import Series, Timeline
from testbed.recordings.console.transport import Transport
from testbed.recordings.recorded_vision import recorded_vision
from testbed.scenarios.settings import load_settings
from tests.support.paths import CONFIGS
from tests.testbed.lockstep.recorded_run import CONTROLLER_FILE, FILES, RecordedRun
from tests.testbed.recordings.editing import all_of, edited, kept
from vision_pc.shell.recording import vision_messages as own
from vision_pc.shell.recording.vision_recorder import OBSERVATION, VisionRecorder
from vision_pc.shell.rest.console.pictures import HEADER

S = 1_000_000_000


def timeline(run: RecordedRun, **changed: Any) -> Timeline:
    recording = recorded_vision(run.directory / FILES[2])
    return Timeline(recording._replace(**changed), run.directory / CONTROLLER_FILE)


class Clock:
    """A clock that a test sets."""

    now_ns = 5 * S

    def __call__(self) -> int:
        return self.now_ns


def test_a_playback_goes_on_pauses_jumps_and_ends() -> None:
    begun = Transport(10 * S, since_ns=100)
    assert begun.position_ns(5 * S) == 0
    going = begun.changed(1 * S, playing=True, speed=2.0)
    assert going.position_ns(3 * S) == 4 * S
    assert going.changed(3 * S, playing=False).position_ns(9 * S) == 4 * S
    moved = going.changed(3 * S, at_s=1.5)
    assert (moved.position_ns(3 * S), moved.jumps, moved.playing) == (1_500_000_000, 1, True)
    assert going.position_ns(60 * S) == 10 * S
    assert not going.plays(60 * S)
    again = going.changed(60 * S, playing=True)
    assert (again.position_ns(60 * S), again.jumps) == (0, 1)


@pytest.mark.parametrize(
    ("asked", "cause"),
    [({"at_s": 10.1}, "refused.beyond_recording"), ({"speed": 3.0}, "refused.speed")],
)
def test_what_no_playback_can_do_is_refused(asked: dict[str, float], cause: str) -> None:
    with pytest.raises(RequestRefused) as refused:
        Transport(10 * S).changed(0, None, **asked)
    assert refused.value.cause == cause


def test_the_newest_by_a_time() -> None:
    series: Series[str] = Series()
    for time_ns, item in ((5, "a"), (9, "b"), (8, "late")):
        series.add(time_ns, item)
    assert [series.newest(at) for at in (4, 5, 8, 9, 99)] == [None, "a", "a", "late", "late"]


def test_every_moment_shows_what_was_so_then(recorded: RecordedRun) -> None:
    of = timeline(recorded)
    assert not of.damages
    assert not of.without_states
    moments = Moments(of)
    looks = of.looks.times_ns
    assert moments.document(looks[0] - 1)["look"] is None
    for time_ns, look in zip(looks, recorded.looks, strict=True):
        shown = moments.document(time_ns)
        assert shown["look"]["time_ns"] == look.time_ns
        error = error_by_hand(look)
        assert shown["look"]["error_mm"] == pytest.approx(error, abs=1e-3)
        assert shown["looked_at"] == shown["time"]
    last = moments.document(of.last_ns)
    said = all_of(recorded.directory / FILES[2], OBSERVATION, own.ObservationMessage)[-1]
    assert last["overlay"]["frame_id"] == said.frame_id
    corners = [corner for marker in last["overlay"]["markers"] for corner in marker["corners"]]
    assert np.ravel(corners) == pytest.approx(said.corners_left_px, abs=0.06)


def error_by_hand(look: Any) -> dict[str, float]:
    """By hand: object minus tool in C, less the clearance along the camera's axis."""
    clearance_m = load_settings(CONFIGS, {}).vision.programs.positioning.clearance_m
    error = look.X_CO[:3, 3] - look.X_CM[:3, 3] - [0.0, 0.0, clearance_m]
    return dict(zip("xyz", 1e3 * error, strict=True))


def test_the_controller_s_states_stand_on_vision_s_clock(recorded: RecordedRun) -> None:
    of = timeline(recorded)
    states = all_of(recorded.directory / CONTROLLER_FILE, STATE, StateMessage)
    newest = of.state(of.last_ns)
    assert newest is not None
    assert newest.q_meas[1] == pytest.approx(states[-1].q_meas_lift_rad, abs=1e-4)
    assert abs(of.states.times_ns[-1] - of.last_ns) < S
    shown = Moments(of).document(of.last_ns)["state"]
    assert shown["group_state"] == "standby"
    assert shown["cycle"]["overruns"] is None, "not recorded, so not zero"
    assert len(Moments(of).document(of.last_ns)["skeleton"]) == 8


def test_pictures_kept_and_rendered_again_are_the_same(recorded: RecordedRun) -> None:
    truth = recorded.directory / FILES[0]
    as_kept, again = (
        ShownPictures(timeline(recorded), truth),
        ShownPictures(timeline(recorded, images="none"), truth),
    )
    assert (as_kept.source, again.source) == (AS_KEPT, RENDERED)
    of = timeline(recorded)
    assert as_kept.of(of.frames.times_ns[0] - 1) is None
    shown = [(as_kept.of(time_ns), again.of(time_ns)) for time_ns in of.images.times_ns[1:3]]
    for one, other in shown:
        assert one is not None
        assert one == other
    assert shown[0] != shown[1]


def test_without_truth_and_controller_it_says_so(recorded: RecordedRun, tmp_path: Path) -> None:
    alone = edited(recorded.directory / FILES[2], tmp_path / "vision.mcap", kept)
    of = Timeline(recorded_vision(alone)._replace(images="none"), tmp_path / "controller.mcap")
    assert "there is no" in of.without_states
    pictures = ShownPictures(of, tmp_path / "truth.mcap")
    assert pictures.source == f"none: there is no {tmp_path / 'truth.mcap'}"
    assert pictures.of(of.last_ns) is None
    assert Moments(of).document(of.last_ns)["state"] is None


def test_another_session_s_controller_is_not_shown(recorded: RecordedRun, tmp_path: Path) -> None:
    other = edited(recorded.directory / FILES[2], tmp_path / "vision.mcap", kept, {"id": "another"})
    of = Timeline(recorded_vision(other), recorded.directory / CONTROLLER_FILE)
    assert of.without_states.endswith("is of another session")
    assert not of.states.items


def test_a_cut_file_shows_all_but_the_pictures_in_it(recorded: RecordedRun, tmp_path: Path) -> None:
    whole = (recorded.directory / FILES[2]).read_bytes()
    (tmp_path / "vision.mcap").write_bytes(whole[: len(whole) * 3 // 4])
    of = Timeline(recorded_vision(tmp_path / "vision.mcap"), tmp_path / "controller.mcap")
    assert of.damages
    assert "recover" in ShownPictures(of, tmp_path / "truth.mcap").source
    assert ShownPictures(of, recorded.directory / FILES[0]).source == RENDERED


@pytest.fixture
def told(tmp_path: Path) -> Timeline:
    """Vision alone: an operation that succeeds, and one that fails."""
    clock = Clock()
    settings = load_settings(CONFIGS, {})
    run = {name: getattr(settings, name).model_dump(mode="json") for name in ("arm", "vision")}
    entries = {"id": "1", "service": "vision_pc"}
    path = tmp_path / "vision.mcap"
    ellipse = {"major": 2.0, "minor": 1.0, "angle_deg": 0.0}
    expected = {"ellipse_95_mm": ellipse, "mean_mm": {"x": 0.0, "y": 0.0}, "inside_probability": 0.9}
    problem = {"cause": "link.lost", "detail": "no word"}
    with closing(VisionRecorder(path, settings.vision, run, entries, clock, DirectRecording)) as recorder:
        for at_s, event, fields in (
            (1, "operation_queued", {"id": "a", "kind": "look-then-move"}),
            (3, "operation_ended", {"id": "a", "state": "succeeded", "result": {"seen": expected}}),
            (4, "operation_queued", {"id": "b", "kind": "move"}),
            (6, "operation_ended", {"id": "b", "state": "failed", "problem": problem}),
            (9, "stopped", {}),
        ):
            clock.now_ns = at_s * S
            recorder.event(event, "info", fields)
    return Timeline(recorded_vision(path), tmp_path / "none")


def test_operations_and_alarms_come_and_go_with_the_time(told: Timeline) -> None:
    moments = Moments(told)

    def at(seconds: float) -> Any:
        return moments.document(round(seconds * S))

    assert [each["state"] for each in at(2)["operations"]] == ["running"]
    assert at(2)["told"] is None
    assert at(3.5)["told"]["inside_probability"] == 0.9
    assert [each["state"] for each in at(5)["operations"]] == ["succeeded", "running"]
    assert at(5)["told"] is None, "the arm moves again"
    failed = at(7)
    assert failed["operations"][1]["cause"] == "link.lost"
    assert [(each["cause"], each["began_at"]) for each in failed["alarms"]] == [("link.lost", 5.0)]
    assert at(2)["alarms"] == []
    assert moments.result("a", 2 * S) is None
    assert moments.result("a", 3 * S) is not None


def test_an_empty_recording_is_named(tmp_path: Path) -> None:
    settings = load_settings(CONFIGS, {})
    run = {name: getattr(settings, name).model_dump(mode="json") for name in ("arm", "vision")}
    path = tmp_path / "vision.mcap"
    VisionRecorder(path, settings.vision, run, {"id": "1"}, Clock(), DirectRecording).close()
    with pytest.raises(RecordingUnreadable) as refused:
        Timeline(recorded_vision(path), tmp_path / "none")
    assert refused.value.cause == "recording.empty"


@pytest.fixture
def page(recorded: RecordedRun) -> tuple[httpx.AsyncClient, RecordedConsole, Clock]:
    clock, of = Clock(), timeline(recorded)
    console = RecordedConsole(of, ShownPictures(of, recorded.directory / FILES[0]), clock)
    through = httpx.ASGITransport(recorded_app(console))
    return httpx.AsyncClient(transport=through, base_url="http://127.0.0.1"), console, clock


async def test_the_page_says_that_it_is_recorded_and_moves_as_asked(
    page: tuple[httpx.AsyncClient, RecordedConsole, Clock],
) -> None:
    asked, console, clock = page
    async with asked:
        assert 'data-recorded="vision.mcap"' in (await asked.get("/")).text
        assert (await asked.get("/console/transport.js")).status_code == 200
        assert (await asked.get("/access")).json()["role"] == "look"
        length_s = (await asked.get("/recording")).json()["length_s"]
        standing = (await asked.post("/recording", json={"at_s": 0.1, "playing": True})).json()
        assert (standing["at_s"], standing["playing"], standing["jumps"]) == (0.1, True, 1)
        clock.now_ns += S // 5
        assert (await asked.get("/recording")).json()["at_s"] == pytest.approx(0.3)
        beyond = await asked.post("/recording", json={"at_s": length_s + 1.0})
        assert beyond.json()["cause"] == "refused.beyond_recording"
        assert (await asked.post("/recording", json={"faster": 1})).status_code == 422
    assert console.moments.seconds(console.time_ns) == 0.3


async def test_nothing_can_be_asked_of_an_arm(
    page: tuple[httpx.AsyncClient, RecordedConsole, Clock],
) -> None:
    async with page[0] as asked:
        for path in ("/stop", "/enable", "/operations/move", "/emergency-stop"):
            assert (await asked.post(path, json={})).status_code in (404, 405), path


async def test_both_streams_go_on_while_it_is_paused(
    page: tuple[httpx.AsyncClient, RecordedConsole, Clock],
) -> None:
    _, console, clock = page
    console.transport = console.transport.changed(clock.now_ns, at_s=1e-9 * console.transport.length_ns)
    state = console.state.follow()
    first, second = await anext(state), await anext(state)
    await state.aclose()
    assert b'"recorded":{"file":"vision.mcap"' in first
    assert first != second, "a page that hears nothing greys"
    pictures = console.pictures.follow()
    message = await anext(pictures)
    length, capture_ns, shown_ns, _, left = HEADER.unpack_from(message)
    assert length == len(message) - 4
    assert message[HEADER.size :][:2] == message[HEADER.size + left :][:2] == b"\xff\xd8"
    assert capture_ns <= shown_ns == console.time_ns
    clock.now_ns += S
    assert await anext(pictures) == message
    await pictures.aclose()
