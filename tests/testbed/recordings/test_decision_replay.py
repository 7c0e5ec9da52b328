"""Programs run again over a recording: every reference the same, and what decides otherwise is found."""

import json
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foundation.recording.messages import event_bytes, fields_of
from protocol.errors import ConfigurationError, MeasurementFailed
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import VISION, LockstepRig
from testbed.lockstep.simulated_measurements import load_eye_model, simulated_sight
from testbed.recordings import command
from testbed.recordings.command import ReplayRequest
from testbed.recordings.comparison import OPERATION, REFERENCE
from testbed.recordings.decision_replay import DecisionReplay
from testbed.recordings.recorded_vision import recorded_vision
from testbed.reporting.console import bars
from testbed.scenarios.scenario import load_settings
from tests.support.paths import CONFIGS
from tests.testbed.recordings.editing import all_of, edited
from vision_pc.application.bodies import RequestBody
from vision_pc.application.program import Program
from vision_pc.application.programs import PROGRAMS
from vision_pc.core.buffers import digest
from vision_pc.core.ports import Arm, Eyes
from vision_pc.core.types import MisplacedMarker
from vision_pc.shell.recording import read_messages as reads
from vision_pc.shell.recording import vision_messages as own
from vision_pc.shell.recording import vision_recorder as topics


def moved(X_BT: Any, by: Any) -> Any:
    X = X_BT.copy()
    X[:3, 3] += by
    return X


async def ride(application: Any, body: Any, report: Any, extra_m: float = 0.0) -> dict[str, Any]:
    """Asks arm and eyes for everything that they can be asked for; moves by what it sees."""
    arm: Arm = application.arm
    eyes: Eyes = application.eyes
    look = await eyes.look(1)
    step = 0.01 * look.X_CO[:3, 3] + [extra_m, 0.0, 0.0]
    view = await arm.view()
    async with eyes.watch(markers=True, odometry=True) as watch:
        view = await arm.move_to(moved(view.X_BT, step), 0.6)
        sample = await watch.after(1, 1.0)
        assert sample is not None
        assert await watch.after(1000, 0.01) is None
        async with arm.streaming() as stream:
            for dated in (sample.time_ns, None):
                commanded = (await stream.view()).X_BT_cmd
                await stream.send(moved(commanded, 1e-4 * step), dated, np.full(6, 1e-6))
                await watch.after(len(watch.samples), 0.05)
    seen = watch.samples[-1]
    assert seen.X_CO is not None
    view = await arm.follow([moved(view.X_BT, 0.01 * seen.X_CO[:3, 3])], 0.6)
    return {"frames": watch.health.frames, "offset": watch.health.offset, "q": view.q_meas.tolist()}


async def break_off(application: Any, body: Any, report: Any) -> None:
    """Fails within a stream and a watch: the arm is stopped."""
    seeing = application.eyes.watch(markers=True, odometry=False)
    async with seeing, application.arm.streaming() as stream:
        await stream.send((await stream.view()).X_BT_cmd)
        raise MeasurementFailed("measurement.view_lost", "enough")


async def ask_controller(application: Any, body: Any, report: Any) -> int:
    """Reads what is not recorded."""
    await application.eyes.look(1)
    return int(application.controller.state.cycle)


def row(name: str, run: Any) -> Program[Any, Any]:
    return Program(name, name, run, lambda result: {"result": result}, RequestBody, needs=())


MOVE = next(program for program in PROGRAMS if program.name == "move")
ROWS = (row("ride", ride), row("break-off", break_off), row("ask", ask_controller), MOVE)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ride, one that fails, one that cannot be run again, and a motion that is refused."""
    directory = tmp_path_factory.mktemp("decided")
    sight = partial(simulated_sight, model=load_eye_model(CONFIGS), seed=5)
    settled_soon = {"vision": {"motion": {"settle_timeout_s": 0.3, "rest_s": 0.05, "still_mrad": 9.0}}}
    rig = LockstepRig(load_settings(CONFIGS, settled_soon), 5, RunLog(), sight, ROWS)
    with closing(rig.record_in(directory, "decided")), bars() as shown, shown.step("all") as bar:
        rig.command("enable")
        rig.operate("ride", {}, bar)
        for kind, body in (("break-off", {}), ("move", {"offset_base_m": [0.0, 0.0, 9.0]})):
            with pytest.raises(Exception, match=r"enough|refused"):
                rig.operate(kind, body, bar)
        rig.operate("ask", {}, bar)
    return directory / VISION


def replay(path: Path, rows: tuple[Program[Any, Any], ...] = ROWS) -> DecisionReplay:
    made = DecisionReplay(recorded_vision(path), rows)
    made.run()
    return made


def request(path: Path, **given: Any) -> ReplayRequest:
    return ReplayRequest(path, None, [], None, None)._replace(**given)


def test_every_reference_and_every_end_comes_out_as_recorded(path: Path) -> None:
    replayed = replay(path)
    compared = replayed.comparison
    assert compared.first is None
    assert compared.exact
    assert compared.alike == compared.of == {OPERATION: 3, REFERENCE: 12}
    assert replayed.not_run == {"ask: controller.state is not recorded": 1}
    assert replayed.commands == 0


def test_what_is_read_comes_back_to_the_last_bit(path: Path) -> None:
    looks = all_of(path, topics.LOOK, own.LookMessage)
    assert [digest(reads.look_of_message(said)) for said in looks] == [said.digest for said in looks]
    assert len(looks) == 2
    doubt = MisplacedMarker(7, np.array([0.01, -0.002]), np.array([1e-3, 2e-3]))
    doubted = reads.look_of_message(looks[0])._replace(misplaced=doubt)
    written = own.LookMessage.FromString(own.look_bytes(own.CombinedLook(doubted, (1, 2))))
    assert digest(reads.look_of_message(written)) == digest(doubted)


def test_another_measurement_shows_in_the_first_reference_that_rests_on_it(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def change(topic: str, count: int, data: bytes) -> bytes:
        if (topic, count) != (topics.LOOK, 0):
            return data
        said = own.LookMessage.FromString(data)
        said.X_CO[7] = np.nextafter(said.X_CO[7], 9.0) + 1e-12
        return bytes(said.SerializeToString())

    changed = edited(path, tmp_path / "vision.mcap", change)
    first = replay(changed).comparison.first
    assert first is not None
    assert (first.kind, first.field) == (REFERENCE, "p_m[1]")
    assert first.replayed - first.recorded == pytest.approx(1e-14, rel=0.1)
    assert f"{first.kind} {first.number} (sent at 72" in first.in_words()
    assert repr(first.recorded) in first.in_words()
    monkeypatch.setattr(command, "DecisionReplay", partial(DecisionReplay, programs=ROWS))
    assert not command.run_replay(request(changed, decisions=True))
    assert "first difference: " in capsys.readouterr().out


def test_a_program_that_decides_otherwise_is_found(path: Path) -> None:
    further = row("ride", partial(ride, extra_m=1e-6))
    compared = replay(path, (further, *ROWS[1:])).comparison
    assert compared.first is not None
    assert (compared.first.kind, compared.first.field) == (REFERENCE, "p_m[0]")
    assert compared.of[REFERENCE] == 12
    assert compared.alike[OPERATION] == 3  # what it went on to see is what was recorded

    async def asks_more(application: Any, body: Any, report: Any) -> Any:
        await application.arm.view()
        return await ride(application, body, report)

    compared = replay(path, (row("ride", asks_more), *ROWS[1:])).comparison
    assert compared.first is not None
    assert compared.first[3:] == ("asks for", "eyes.look", "arm.view")
    assert (compared.of[OPERATION], compared.alike[OPERATION]) == (3, 2)

    async def ends(application: Any, body: Any, report: Any) -> None:
        await application.eyes.look(1)

    compared = replay(path, (row("ride", ends), *ROWS[1:])).comparison
    assert compared.first is not None
    assert compared.first[3:] == ("asks for", "arm.view", "nothing more")


def test_another_result_is_found_by_its_name(path: Path, tmp_path: Path) -> None:
    def change(topic: str, count: int, data: bytes) -> bytes:
        said = fields_of(data) if topic == topics.EVENT else {}
        if said.get("event") != "operation_ended" or said["kind"] != "ride":
            return data
        said["result"]["result"]["frames"] += 1
        return event_bytes(said)

    compared = replay(edited(path, tmp_path / "vision.mcap", change)).comparison
    assert compared.first is not None
    assert (compared.first.kind, compared.first.field) == (OPERATION, "result.result.frames")
    assert compared.alike[REFERENCE] == compared.of[REFERENCE] == 12


def test_a_reference_that_was_never_recorded_is_missed(path: Path, tmp_path: Path) -> None:
    def change(topic: str, count: int, data: bytes) -> bytes | None:
        return None if (topic, count) == (topics.REFERENCE, 1) else data

    compared = replay(edited(path, tmp_path / "vision.mcap", change)).comparison
    assert compared.first is not None
    assert compared.first[3:] == ("kind", None, "ReferencePose")


def test_a_cancelled_operation_is_cancelled_again_where_it_was(path: Path, tmp_path: Path) -> None:
    """The ride after its look, and the arm was stopped; what came after is as it was."""
    told = calls(path)
    rides = [place for place, call in enumerate(told) if call == "watch.begin"][1]
    cancelled = {1: ("arm.view", "CancelledError"), 2: ("arm.halt", None)}
    sent = replay(path).comparison.of[REFERENCE]

    def change(topic: str, count: int, data: bytes) -> bytes | None:
        if topic == topics.READ and 0 < count < rides:
            call, error = cancelled.get(count, (None, None))
            return (
                None if call is None else bytes(reads.ReadMessage(call=call, error=error).SerializeToString())
            )
        if topic == topics.REFERENCE and 0 < count < 7:
            return None
        if topic == topics.EVENT and fields_of(data).get("kind") == "ride" and "result" in fields_of(data):
            return event_bytes(fields_of(data) | {"state": "cancelled", "result": None})
        return data

    compared = replay(edited(path, tmp_path / "vision.mcap", change)).comparison
    assert compared.first is None
    assert compared.of == {OPERATION: 3, REFERENCE: sent - 6}


def test_commands_of_others_are_no_decisions(path: Path, tmp_path: Path) -> None:
    """A stop by hand while the first motion was under way."""
    stop = own.ReferenceMessage(number=99, kind="Command", command="STOP").SerializeToString()

    def change(topic: str, count: int, data: bytes) -> bytes | None:
        return stop if (topic, count) == (topics.REFERENCE, 1) else data

    replayed = replay(edited(path, tmp_path / "vision.mcap", change))
    assert replayed.commands == 1
    assert replayed.comparison.first is not None
    assert replayed.comparison.first[3:] == ("kind", None, "ReferencePose")


def test_a_recording_that_was_cut_off_is_replayed_as_far_as_it_goes(path: Path, tmp_path: Path) -> None:
    """Here: while the first motion was under way."""
    cut: list[str] = []

    def change(topic: str, count: int, data: bytes) -> bytes | None:
        if (topic, count) == (topics.READ, 3):
            cut.append(topic)
        return None if cut else data

    compared = replay(edited(path, tmp_path / "vision.mcap", change)).comparison
    assert compared.first is None
    assert compared.of == compared.alike == {REFERENCE: 1}


def test_what_cannot_be_run_again_is_named(path: Path) -> None:
    assert replay(path, ()).not_run == {
        f"{name}: no program of this version": 1 for name in ("ride", "break-off", "move", "ask")
    }
    with pytest.raises(ConfigurationError, match="--decisions measures nothing"):
        command.run_replay(request(path, settings=["vision.look.frames=5"], decisions=True))


def test_without_pictures_the_programs_alone_are_replayed(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = tmp_path / "figures.json"
    assert command.run_replay(request(path, json_file=figures))
    told = json.loads(figures.read_text())
    assert set(told) == {"decisions", "damages"}
    assert told["decisions"]["of"] == told["decisions"]["alike"] == {OPERATION: 1, REFERENCE: 2}
    assert "not run again, 1: ride: no program of this version" in capsys.readouterr().out


def calls(path: Path) -> list[str]:
    """What was read, in order."""
    return [said.call for said in all_of(path, topics.READ, reads.ReadMessage)]
