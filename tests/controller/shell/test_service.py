"""The process: ready line, motion through real sockets, clean end, flight dump."""

import asyncio
import contextlib
import json
import signal
import socket
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from controller.shell.scan_recorder import FILE, TOPICS
from foundation.configuration import configuration_hash
from foundation.recording.contents import contents
from nominal_arm.description import NominalArm
from protocol.client_session import ReferenceClient
from protocol.faults import CommandCode, FaultCode, GroupState, Reason
from protocol.pose import Pose
from protocol.reference_messages import (
    FLAG_PLANT_LINK_OK,
    FLAG_SETTLED,
    Acknowledgement,
    Command,
    ReferencePose,
    State,
)
from protocol.session_events import AcknowledgementReceived, StateReceived
from tests.controller.conftest import CONFIGS
from tests.controller.shell.plant_server import PlantServer, plant_server
from tests.support.patience import PATIENT

pytestmark = pytest.mark.realtime

READY_S = 60.0  # a first start compiles


class Controller:
    """The controller as a child process."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.ready: dict[str, Any] = {}

    @classmethod
    async def started(cls, *arguments: str) -> "Controller":
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "controller",
            "--config-dir",
            str(CONFIGS),
            "--set",
            "controller.fifo_priority=0",
            *arguments,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
        return cls(process)

    async def wait_ready(self) -> None:
        assert self.process.stdout is not None
        self.ready = json.loads(await asyncio.wait_for(self.process.stdout.readline(), READY_S))
        assert self.ready["event"] == "ready"

    async def ended(self, number: signal.Signals) -> tuple[int, list[dict[str, Any]]]:
        """Exit status after a signal, and log lines."""
        self.process.send_signal(number)
        _, stderr = await asyncio.wait_for(self.process.communicate(), READY_S)
        lines = [json.loads(line) for line in stderr.decode().splitlines()]
        assert self.process.returncode is not None
        return self.process.returncode, lines


class Client:
    """A vision PC: the client session on a real socket."""

    def __init__(self, arm: NominalArm, port: int) -> None:
        self.session = ReferenceClient(
            nonce=time.monotonic_ns(), arm_hash=configuration_hash(arm), state_period_ms=10
        )
        self.answers: dict[int, Acknowledgement] = {}
        self.state: State | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect(("127.0.0.1", port))
        self.session.connect(time.monotonic_ns())

    def close(self) -> None:
        self._socket.close()

    async def until(self, done: Callable[[], bool], timeout_s: float = 40.0) -> None:
        """Run the session until ``done``."""
        async with asyncio.timeout(timeout_s):
            while not done():
                self._turn()
                await asyncio.sleep(0.002)

    def _turn(self) -> None:
        now_ns = time.monotonic_ns()
        self.session.tick(now_ns)
        for data in self.session.outgoing(now_ns):
            self._socket.send(data)
        while True:
            try:
                data = self._socket.recv(4096)
            except (BlockingIOError, ConnectionRefusedError):
                return
            for event in self.session.receive(data, time.monotonic_ns()):
                if isinstance(event, AcknowledgementReceived):
                    self.answers[event.acknowledgement.command_id] = event.acknowledgement
                elif isinstance(event, StateReceived):
                    self.state = event.state

    async def ask(self, message: Command | ReferencePose) -> Acknowledgement:
        command_id = self.session.submit(message, time.monotonic_ns())
        await self.until(lambda: command_id in self.answers)
        return self.answers[command_id]

    async def command(self, code: CommandCode) -> Reason:
        return (await self.ask(Command(0, code))).reason

    async def connected(self) -> None:
        await self.until(lambda: self.session.connected and self.state is not None)

    async def enabled(self) -> None:
        """Enable the arm once the plant answers, and wait until it is held."""
        await self.until(lambda: self.state is not None and bool(self.state.flags & FLAG_PLANT_LINK_OK))
        assert await self.command(CommandCode.ENABLE) is Reason.ACCEPTED
        await self.reaches(GroupState.STANDBY)

    async def reaches(self, state: GroupState) -> None:
        await self.until(lambda: self.state is not None and self.state.group_state is state)


@pytest.fixture
async def server() -> AsyncIterator[PlantServer]:
    async with plant_server() as serving:
        yield serving


Start = Callable[..., Awaitable[Controller]]
Connect = Callable[[Controller], Awaitable[Client]]


@pytest.fixture
async def start() -> AsyncIterator[Start]:
    """Starts controllers; what a failed test leaves running is killed."""
    children: list[Controller] = []

    async def started(*arguments: str) -> Controller:
        children.append(await Controller.started(*arguments))
        return children[-1]

    yield started
    for child in children:
        if child.process.returncode is None:
            child.process.kill()
            await child.process.communicate()


@pytest.fixture
async def connect(arm: NominalArm) -> AsyncIterator[Connect]:
    """Connects clients, and closes their sockets in the end."""
    with contextlib.ExitStack() as sockets:

        async def connected(child: Controller) -> Client:
            client = Client(arm, child.ready["reference_link"]["port"])
            sockets.callback(client.close)
            await client.connected()
            return client

        yield connected


async def _lifting(child: Controller, connect: Connect) -> Client:
    """Its client, once the arm is on its way 0.4 m up and the lift's valve is open."""
    client = await connect(child)
    await client.enabled()
    assert client.state is not None
    here = client.state.X_BT
    goal = Pose((here.p_m[0], here.p_m[1], here.p_m[2] + 0.4), here.q_wxyz)
    assert (await client.ask(ReferencePose(0, goal, 0.0))).reason is Reason.ACCEPTED
    await client.until(lambda: client.state is not None and abs(client.state.valves[1]) > 0.02)
    return client


def _ports(server: PlantServer, *settings: str) -> tuple[str, ...]:
    ports = (f"controller.plant_link.port={server.port}", "controller.reference_link.port=0")
    return ("--set", *ports, *PATIENT, *settings)


@pytest.mark.slow("a controller starts as a process")
async def test_a_motion_from_end_to_end_and_a_clean_exit(
    server: PlantServer, start: Start, connect: Connect, tmp_path: Path
) -> None:
    child = await start(*_ports(server), "--record-dir", str(tmp_path))
    await child.wait_ready()
    client = await connect(child)
    await client.enabled()
    assert client.state is not None
    here = client.state.X_BT
    goal = Pose((here.p_m[0] + 0.02, here.p_m[1] + 0.02, here.p_m[2] + 0.02), here.q_wxyz)
    answer = await client.ask(ReferencePose(0, goal, 0.0))
    assert answer.reason is Reason.ACCEPTED

    def arrived() -> bool:
        state = client.state
        assert state is not None
        return state.motion_id == answer.command_id and state.motion_done and bool(state.flags & FLAG_SETTLED)

    await client.until(arrived)
    assert client.state.X_BT.p_m == pytest.approx(goal.p_m, abs=2e-3)
    clock = client.session.clock
    assert clock is not None
    assert abs(clock.offset_ns) <= clock.uncertainty_ns < 1_000_000_000  # one machine, one clock
    status, lines = await child.ended(signal.SIGTERM)
    assert status == 0
    assert lines[-1]["event"] == "stopped"
    assert server.written[-1].control == 0
    assert server.written[-1].valves == (0.0,) * 6
    written = lines[-1]["statistics"]
    assert written["cycles"] > 100
    assert written["plant_exchanges"] > 100
    assert written["late_p999_us"] >= written["late_p50_us"] > 0
    assert written["rss_mb"] > 10.0
    assert written["scheduling"] in ("normal", "short_slice", "fifo")
    recorded = contents(tmp_path / FILE)
    assert (recorded.complete, recorded.damages) == (True, ())
    counted = {topic.name for channel, topic in recorded.topics.items() if recorded.counts.get(channel)}
    assert counted == {topic.name for topic in TOPICS}


@pytest.mark.slow("a controller starts as a process")
async def test_a_silent_client_stops_the_motion_and_the_flight_is_recorded(
    server: PlantServer, start: Start, connect: Connect, tmp_path: Path
) -> None:
    child = await start(*_ports(server), "--record-dir", str(tmp_path / "flights"))
    await child.wait_ready()
    client = await _lifting(child, connect)
    client.close()  # no BYE: the vision PC has died
    async with asyncio.timeout(READY_S):
        while server.written[-1].control != 0:  # noqa: ASYNC110 - the plant has no event to wait for
            await asyncio.sleep(0.05)
    second = await connect(child)
    assert second.state is not None
    assert second.state.fault is FaultCode.REFERENCE_LINK_LOST
    assert second.state.group_state is GroupState.ERROR_STOP
    assert await second.command(CommandCode.ENABLE) is Reason.ERROR_LATCHED
    assert await second.command(CommandCode.RESET) is Reason.ACCEPTED
    status, lines = await child.ended(signal.SIGINT)
    assert status == 0
    assert any(line["event"] == "fault" and line["cause"] == "REFERENCE_LINK_LOST" for line in lines)
    (flight,) = (tmp_path / "flights").glob("*.jsonl")
    scans = [json.loads(line) for line in flight.read_text().splitlines()]
    assert len(scans) > 10
    cycles = [entry["view"]["cycle"] for entry in scans]
    assert cycles == sorted(cycles)
    faults = [entry["view"]["fault"] for entry in scans]
    assert faults[0] == 0
    assert faults[-1] == FaultCode.REFERENCE_LINK_LOST


@pytest.mark.slow("a controller starts as a process")
async def test_sigterm_while_moving_ramps_down_and_centres(
    server: PlantServer, start: Start, connect: Connect
) -> None:
    child = await start(*_ports(server))
    await child.wait_ready()
    await _lifting(child, connect)
    before = len(server.written)
    status, _ = await child.ended(signal.SIGTERM)
    assert status == 0
    after = [image.valves[1] for image in server.written[before:]]
    assert len(after) > 20  # a ramp, not a slam
    assert max(abs(b - a) for a, b in pairwise(after)) < 0.03
    assert (server.written[-1].control, server.written[-1].valves) == (0, (0.0,) * 6)
