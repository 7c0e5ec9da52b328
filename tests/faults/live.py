"""Vision's REST face over a real UDP link to a controller and a plant, all in one event loop.

The plant's and the controller's time are stepped a little faster than the clock on the wall; what is written
to the coupler's registers is kept, as everywhere in these tests.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from fastapi import FastAPI

from nominal_arm.dimensions import boom_dimensions
from plant_emulator.core.plant import Plant
from protocol.faults import GroupState
from protocol.process_image import decode_valves, encode_sensors
from testbed.lockstep.world import ControllerSide
from tests.faults.registers import SHUT, Registers
from tests.faults.rig import settings_of
from tests.support.log_lines import HeardLog
from tests.vision_pc.shell.loopback_controller import until
from vision_pc.application.application import VisionApplication
from vision_pc.application.link_arm import LinkArm
from vision_pc.core.types import StereoPair
from vision_pc.shell.camera_eyes import ProcessClock, open_eyes
from vision_pc.shell.cameras import CameraSource
from vision_pc.shell.link.udp_endpoint import UdpEndpoint
from vision_pc.shell.rest.api import create_app
from vision_pc.shell.rest.operations import Operations

_CYCLES_AT_ONCE = 2
_PAUSE_S = 0.004
# The link's own timeouts are tried elsewhere; here a busy machine shall not end a session.
_PATIENT = ("controller.reference_link.link_timeout_ms=5000", "controller.settled.time_ms=800")


class Machine(asyncio.DatagramProtocol):
    """Controller and plant behind one UDP port."""

    def __init__(self, *assignments: str) -> None:
        settings = settings_of(1, _PATIENT + assignments)
        self.registers = Registers(Plant(settings.plant, 1))
        self._side = ControllerSide(settings, 1)
        self._arrived: list[bytes] = []
        self._peer: Any = None
        self._transport: asyncio.DatagramTransport | None = None
        self._task: asyncio.Task[None] | None = None
        self.port = 0
        self.drives_another_arm = any(key.startswith("arm.") for key in assignments)
        self.motions: set[int] = set()

    async def start(self) -> None:
        loop = asyncio.get_running_loop()
        self._transport, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=("127.0.0.1", 0))
        self.port = self._transport.get_extra_info("sockname")[1]
        self._task = asyncio.create_task(self._run())

    async def stop(self) -> None:
        assert self._task is not None
        assert self._transport is not None
        self._task.cancel()
        await asyncio.wait([self._task])
        self._transport.close()

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._peer = addr
        self._arrived.append(data)

    def at_rest(self) -> bool:
        """Whether the newest image moves nothing and the spools are shut."""
        return np.abs(self.registers.spools[-1].opening).max() < 5 * SHUT

    async def _run(self) -> None:
        while True:
            for _ in range(_CYCLES_AT_ONCE):
                self._cycle()
            await asyncio.sleep(_PAUSE_S)

    def _cycle(self) -> None:
        self.registers.write(decode_valves(self._side.valve_words))
        words = encode_sensors(self.registers.read())
        datagrams, self._arrived = self._arrived, []
        now_ns = time.monotonic_ns()
        output, replies = self._side.cycle(words, datagrams, now_ns)
        if output.view.group_state is GroupState.MOVING:
            self.motions.add(output.view.motion_id)
        assert self._transport is not None
        for data in replies:
            if self._peer is not None:
                self._transport.sendto(data, self._peer)
        self.registers.advance(self._side.cycle_ns)


class ScriptedCamera(CameraSource):
    """A camera whose every picture is made by ``picture(frame_id)``, ten times a second."""

    picture: Callable[[int], np.ndarray] = staticmethod(
        lambda frame_id: np.full((720, 1280), frame_id % 251, np.uint8)
    )

    def _produce(self) -> None:
        self._is_there()
        frame_id = 0
        while not self._stop.wait(0.03):
            frame_id += 1
            left = self.picture(frame_id)
            self._deliver(StereoPair(left, left, time.monotonic_ns(), frame_id))


class LiveRig:
    """Everything a case wants, connected and enabled."""

    def __init__(self, client: httpx.AsyncClient, app: FastAPI, station: VisionApplication,
                 operations: Operations, machine: Machine, camera: ScriptedCamera,
                 log: HeardLog) -> None:  # fmt: skip
        self.client, self.app, self.station, self.operations = client, app, station, operations
        self.machine, self.camera, self.log = machine, camera, log
        self.registers = machine.registers

    def tool(self) -> np.ndarray:
        """The true tool in the world (3,)."""
        return np.array(self.registers.plant.truth().X_WT[:3, 3])

    async def post(self, path: str, body: Any = None, key: str | None = None) -> httpx.Response:
        """The answer to a POST."""
        headers = {} if key is None else {"Idempotency-Key": key}
        return await self.client.post(path, json=body, headers=headers)

    async def ended(self, location: str, limit_s: float = 30.0) -> dict[str, Any]:
        """The operation, ended."""
        deadline = time.monotonic() + limit_s
        while time.monotonic() < deadline:
            operation: dict[str, Any] = (await self.client.get(location)).json()
            if operation["state"] in ("succeeded", "failed", "cancelled"):
                return operation
            await asyncio.sleep(0.01)
        raise AssertionError(f"{location} did not end")

    async def rest(self) -> None:
        """The arm has come to rest."""
        await until(lambda: self.station.controller.state.group_state is GroupState.STANDBY, 20.0)
        await asyncio.sleep(0.3)


@asynccontextmanager
async def live(
    record_dir: Path | None = None, stream: Any = None, machine: Machine | None = None, any_arm: bool = False
) -> AsyncIterator[LiveRig]:
    """A rig, enabled if ``machine`` (default: one) accepts it; ``stream``: where vision's log lines go."""
    settings = settings_of(1, _PATIENT)
    machine = machine or Machine()
    await machine.start()
    log = HeardLog("vision_pc", stream)
    if record_dir is not None:
        log.record_in(record_dir)
    vision = settings.vision.model_copy(
        update={"link": settings.vision.link.model_copy(update={"port": machine.port, "any_arm": any_arm})}
    )
    endpoint = UdpEndpoint(vision.link, vision.link.expected_arm(settings.arm), log, ProcessClock())
    link = endpoint.link
    await endpoint.start()
    camera = ScriptedCamera(vision.camera)
    await camera.start()
    eyes, worker, _ = open_eyes(camera, link, vision, log)
    arm = LinkArm(link, vision.motion)
    boom = boom_dimensions(settings.arm)
    station = VisionApplication(arm, eyes, link, eyes, vision.programs, boom, log)
    operations = Operations(arm.halt, log)
    app = create_app(station, operations)
    transport = httpx.ASGITransport(app=app, raise_app_exceptions=False)
    try:
        refused = machine.drives_another_arm and not any_arm
        await until(lambda: refused or link.connected, 10.0)
        async with httpx.AsyncClient(transport=transport, base_url="http://vision", timeout=30.0) as client:
            assert refused or (await client.post("/enable")).status_code == 200
            yield LiveRig(client, app, station, operations, machine, camera, log)
    finally:
        await operations.close()
        await endpoint.close()
        await camera.close()
        worker.close()
        await machine.stop()
        log.close()
