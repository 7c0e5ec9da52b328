"""Faults 31 to 34 and 37 to 40 of vision's side, judged at the plant's registers and its true tool."""

import asyncio
import contextlib
import io
import os
import socket
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foundation.rest.guard import ANYBODY_HERE
from foundation.rest.server import RestServer, door, service_socket
from plant_emulator.core.faults.kinds import MarkerCovered
from protocol.errors import MeasurementFailed, RequestRefused
from protocol.faults import GroupState
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.simulated_measurements import load_eye_model, simulated_sight
from testbed.reporting.console import bars
from tests.faults.live import LiveRig, live
from tests.faults.registers import Registers
from tests.faults.rig import settings_of
from tests.support.paths import CONFIGS
from tests.vision_pc.shell.loopback_controller import until

HELD_M = 2e-3
TOOL_MARKER = 0


def lockstep(*assignments: str) -> tuple[LockstepRig, Registers]:
    """A station in simulated time, enabled and held for a moment, its plant behind the coupler."""
    rig = LockstepRig(settings_of(1, assignments), 1, RunLog())
    registers = Registers(rig.world.plant)
    rig.world.plant = registers  # type: ignore[assignment]
    rig.command("enable")
    for _ in range(100):
        rig.world.clock.advance()
    return rig, registers


def assert_held(rig: LockstepRig, registers: Registers, before: np.ndarray) -> None:
    """Asserts that no motion was ever begun: the valves did no more than hold."""
    assert rig.link.state.motion_id == 0
    assert rig.link.state.group_state is GroupState.STANDBY
    assert max(np.abs(row.image.valves).max() for row in registers.written) < 0.02
    assert np.linalg.norm(registers.plant.truth().X_WT[:3, 3] - before) < HELD_M


def fails_without_motion(rig: LockstepRig, registers: Registers, kind: str, **body: Any) -> MeasurementFailed:
    """How an operation fails that must move nothing and record nothing."""
    before = registers.plant.truth().X_WT[:3, 3].copy()
    with bars(quiet=True) as shown, shown.step(kind) as bar, pytest.raises(MeasurementFailed) as caught:
        rig.operate(kind, body, bar)
    assert_held(rig, registers, before)
    with pytest.raises(RequestRefused) as none_yet:
        rig.latest_look()
    assert none_yet.value.cause == "refused.no_look_yet"
    return caught.value


def test_case_31_a_marker_lost_while_looking_fails_the_operation_and_no_error_is_recorded() -> None:
    rig, registers = lockstep("vision.look.frames=4")
    observe, seen = rig.eyes._sensor.observe, [0]

    def covered(frame: Any, previous: Any) -> Any:
        seen[0] += 1
        if seen[0] == 2:
            registers.plant.inject(MarkerCovered(marker_id=TOOL_MARKER, share=0.6))
        return observe(frame, previous)

    rig.eyes._sensor.observe = covered  # type: ignore[method-assign]
    error = fails_without_motion(rig, registers, "orientation-adjustment")
    assert seen[0] == 4
    assert error.cause == "measurement.tool_not_seen"
    assert "2 of 4" in str(error)


@pytest.mark.parametrize(
    ("assignment", "causes"),
    [
        ("vision.markers.tool.id=7", ("measurement.tool_not_seen",)),
        ("vision.markers.tool.size_m=0.13", ("measurement.tool_not_seen", "measurement.tool_wrong_size")),
    ],
)
def test_case_32_a_marker_of_the_wrong_id_or_size_is_refused(
    assignment: str, causes: tuple[str, ...]
) -> None:
    rig, registers = lockstep("vision.look.frames=3", assignment)
    assert fails_without_motion(rig, registers, "orientation-adjustment").cause in causes


@pytest.mark.slow("a whole trajectory in lockstep")
def test_case_34_an_ill_conditioned_calibration_fails_with_its_condition_and_nothing_is_built_on_it() -> None:
    quick = ("controller.settled.time_ms=200", "vision.programs.trajectory.dwell_s=0.3")
    settings = settings_of(1, (*quick, "vision.programs.trajectory.condition_limit=1.5"))
    model = load_eye_model(CONFIGS)
    rig = LockstepRig(settings, 1, RunLog(), lambda world: simulated_sight(world, model, 1))
    rig.command("enable")
    with bars(quiet=True) as shown, shown.step("matching") as bar:
        with pytest.raises(MeasurementFailed) as caught:
            rig.operate("trajectory-matching", {}, bar)
        assert caught.value.cause == "measurement.ill_conditioned"
        assert "condition" in str(caught.value)
        assert "limit 1.5" in str(caught.value)
        assert rig.application.calibration is None
        motion = rig.link.state.motion_id
        with pytest.raises(RequestRefused) as refused:
            rig.operate("look-then-move", {}, bar)
    assert refused.value.cause == "refused.not_calibrated"
    assert rig.link.state.motion_id == motion


@pytest.mark.realtime
async def test_case_33_a_frozen_camera_is_found_by_its_content_and_nothing_moves() -> None:
    async with live() as rig:
        await until(lambda: rig.camera.status().connected)
        frozen = np.zeros((720, 1280), np.uint8)
        rig.camera.picture = lambda frame_id: frozen  # type: ignore[method-assign]
        await until(lambda: rig.camera.status().trouble == "link.camera_frozen")
        before, motions = rig.tool(), len(rig.machine.motions)
        answer = await rig.post("/operations/orientation-adjustment")
        assert answer.status_code == 503
        assert answer.json()["cause"] == "link.camera_frozen"
        await asyncio.sleep(0.3)
        assert len(rig.machine.motions) == motions
        assert np.linalg.norm(rig.tool() - before) < HELD_M


@pytest.mark.realtime
async def test_case_33_a_camera_that_falls_silent_is_found_by_its_age() -> None:
    async with live() as rig:
        await until(lambda: rig.camera.status().connected)
        await rig.camera.close()
        await until(lambda: rig.camera.status().trouble == "link.camera_silent", 10.0)
        answer = await rig.post("/operations/look")
        assert (answer.status_code, answer.json()["cause"]) == (503, "link.camera_silent")
        assert not rig.machine.motions


MOVE = {"offset_base_m": [0.0, 0.05, 0.0]}


@pytest.mark.slow("motions in real time")
@pytest.mark.realtime
async def test_case_37_a_post_repeated_with_one_key_is_one_motion() -> None:
    async with live() as rig:
        before = rig.tool()
        answers = await asyncio.gather(*(rig.post("/operations/move", MOVE, key="k") for _ in range(10)))
        assert len({answer.json()["id"] for answer in answers}) == 1
        assert {answer.status_code for answer in answers} == {202}
        await rig.ended(answers[0].headers["Location"])
        again = await rig.post("/operations/move", MOVE, key="k")
        assert again.json()["id"] == answers[0].json()["id"]
        await rig.rest()
        assert len(rig.machine.motions) == 1
        assert rig.tool()[1] - before[1] == pytest.approx(0.05, abs=0.008)
        other = await rig.post("/operations/move", {"offset_base_m": [0.0, 0.1, 0.0]}, key="k")
        assert (other.status_code, other.json()["cause"]) == (422, "refused.key_reused")


@pytest.mark.slow("many motions, each cancelled at another time")
@pytest.mark.realtime
async def test_case_38_a_cancel_that_races_with_completion_leaves_exactly_one_end_state() -> None:
    async with live() as rig:
        body = {"offset_base_m": [0.0, 0.01, 0.0], "duration_s": 1.0}
        began = asyncio.get_running_loop().time()
        await rig.ended((await rig.post("/operations/move", body)).headers["Location"])
        takes_s = asyncio.get_running_loop().time() - began
        states = set()
        for share in (0.0, 0.5, 0.97, 1.03):
            location = (await rig.post("/operations/move", body)).headers["Location"]
            await asyncio.sleep(share * takes_s)
            cancelled = await rig.post(f"{location}/cancel")
            final = await rig.ended(location)
            states.add(final["state"])
            assert cancelled.status_code == 409 or cancelled.json()["state"] == final["state"]
            await asyncio.sleep(0.2)
            await rig.rest()
            assert await rig.ended(location) == final
            assert rig.station.controller.state.group_state is GroupState.STANDBY
        assert states <= {"cancelled", "succeeded"}
        assert "cancelled" in states
        assert len(rig.log.lines("operation_ended")) == 5


class HangingPipe(io.TextIOBase):
    """A console that takes one line and then nothing more."""

    def __init__(self) -> None:
        self.released = threading.Event()

    def write(self, text: str) -> int:
        self.released.wait()
        return len(text)


@pytest.mark.slow("motions in real time")
@pytest.mark.realtime
async def test_case_39_hanging_consoles_are_left_behind_and_the_motion_goes_on() -> None:
    pipe = HangingPipe()
    async with live(stream=pipe) as rig, served(rig) as port:
        listeners = [hanging_listener(port, "/operations") for _ in range(5)]
        for _ in range(3000):  # more lines than the log holds
            rig.log.write("noise")
        before = rig.tool()
        started = await rig.post("/operations/move", MOVE)
        listeners += [hanging_listener(port, "/events") for _ in range(5)]
        ended = await rig.ended(started.headers["Location"])
        assert ended["state"] == "succeeded", ended["problem"]
        assert rig.tool()[1] - before[1] == pytest.approx(0.05, abs=0.008)
        cycles = [row.image.controller_cycle for row in rig.registers.written]
        assert cycles == list(range(cycles[0], cycles[0] + len(cycles))), "no scan waited for a console"
        for listener in listeners:
            listener.close()
        pipe.released.set()


def hanging_listener(port: int, path: str) -> socket.socket:
    """A browser that asks and never reads."""
    sock = socket.create_connection(("127.0.0.1", port))
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
    sock.sendall(f"GET {path} HTTP/1.1\r\nhost: localhost\r\n\r\n".encode())
    return sock


@contextlib.asynccontextmanager
async def served(rig: LiveRig) -> Any:
    """The port of the rig's REST face on a real socket."""
    server = RestServer(rig.app)
    with socket.create_server(("127.0.0.1", 0)) as listening, service_socket() as (at, behind):
        task = asyncio.create_task(server.serve([behind]))
        async with door(listening, at, ANYBODY_HERE, None):
            yield listening.getsockname()[1]
        server.should_exit = True
        await task


def full_disk(directory: Path) -> Path:
    """A record directory on which nothing can be written any more."""
    directory.mkdir()
    (directory / "events.jsonl").symlink_to("/dev/full")
    return directory


@pytest.mark.realtime
@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
async def test_case_40_on_a_full_disk_no_motion_begins_and_the_alarm_is_seen(tmp_path: Path) -> None:
    async with live(record_dir=full_disk(tmp_path / "records")) as rig:
        before = rig.tool()
        rig.log.write("something")
        answer = await rig.post("/operations/move", MOVE)
        assert (answer.status_code, answer.json()["cause"]) == (409, "refused.recording_failed")
        health = await rig.client.get("/health")
        assert (health.status_code, health.json()["recording"]) == (503, False)
        assert not rig.machine.motions
        assert np.linalg.norm(rig.tool() - before) < HELD_M
        assert (await rig.post("/stop")).status_code == 200
