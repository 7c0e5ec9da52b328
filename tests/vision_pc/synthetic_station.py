"""A station for tests: the real controller link and socket arm over loopback, eyes on the synthetic arm."""

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from foundation.configuration import load
from nominal_arm.description import NominalArm
from nominal_arm.dimensions import dh_links
from protocol.errors import LinkLost, RequestRefused
from protocol.faults import GroupState
from protocol.reference_messages import (
    ANY_ARM,
    CAPABILITY_PATHS,
    CAPABILITY_STREAMING,
    CAPABILITY_VALVE_TRIALS,
)
from tests.support.log_lines import HeardLog
from tests.support.paths import CONFIGS
from tests.vision_pc.program_settings import BOOM, shipped
from tests.vision_pc.shell.loopback_controller import LoopbackController, until
from tests.vision_pc.synthetic import SyntheticRig, SyntheticWatch, draw
from vision_pc.application.application import VisionApplication
from vision_pc.application.link_arm import LinkArm
from vision_pc.application.ports import CameraStatus, Seen
from vision_pc.config.programs import ProgramSettings, TargetSettings
from vision_pc.config.vision import LinkSettings, MotionSettings, VisionConfig
from vision_pc.core.perception.intrinsics import calibration, distorted
from vision_pc.core.targets.keeper import KeptTarget, TargetKeeper
from vision_pc.core.targets.sighting import Click
from vision_pc.core.targets.target import Candidate, TargetObservation, TargetRefused
from vision_pc.core.types import FrameObservation, Look, MarkerObservation, StereoPair
from vision_pc.shell.camera_eyes import ProcessClock
from vision_pc.shell.link.udp_endpoint import UdpEndpoint
from vision_pc.shell.rest.api import create_app
from vision_pc.shell.rest.operations import Operations

CAMERA = calibration(load(VisionConfig, CONFIGS / "vision.yaml").camera)
TOOL_ID = 7
_SQUARE = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def observed(look: Look, frame: int) -> FrameObservation:
    """What a picture would show of a look: two markers of 10 cm, by their corners."""
    markers = []
    for number, X in ((TOOL_ID, look.X_CM), (TOOL_ID + 1, look.X_CO)):
        corners = (X @ np.array([[-s, t, 0, 20] for s, t in _SQUARE]).T / 20)[:3].T
        pixels = distorted(CAMERA.left, corners[:, :2] / corners[:, 2:])
        markers.append(MarkerObservation(number, 0.1, pixels, None, X, np.eye(6), 0.1, 99.0))
    known = (look.X_CM, np.eye(6), np.eye(6), look.X_CO, np.eye(6), np.eye(6))
    return FrameObservation(look.time_ns, frame, *known, tuple(markers), {}, None)


class SyntheticEyes:
    """Eyes and camera over the synthetic arm that the loopback controller moves."""

    def __init__(self, rig: SyntheticRig, controller: LoopbackController) -> None:
        self.rig, self.controller = rig, controller
        self.connected = True
        self.trouble: str | None = None
        self.age_ms: float | None = 10.0
        self.look_s = 0.02
        self.pictures = 0
        self.picture_s = 0.02
        self.behind_s = 0.0  # how late pictures come
        self.measured: Seen | None = None
        self.targets = TargetKeeper(TargetSettings())
        self.carries = False

    async def look(self, frames: int | None = None) -> Look:
        if self.controller.group is GroupState.MOVING:
            raise RequestRefused("refused.moving", "look: the arm is moving")
        await asyncio.sleep(self.look_s)
        return await self.rig.look(frames)

    @asynccontextmanager
    async def watch(self, *, markers: bool, odometry: bool) -> AsyncIterator[SyntheticWatch]:
        async with self.rig.watch(markers=markers, odometry=odometry) as watch:
            yield watch
            await asyncio.sleep(0.1)  # pictures at rest

    def status(self) -> CameraStatus:
        heard_at_s = 0.0 if self.age_ms is None else time.time() - 1e-3 * self.age_ms
        return CameraStatus(
            self.connected, self.age_ms, 1, 100.0, trouble=self.trouble, heard_at_s=heard_at_s
        )

    async def latest_png(self) -> bytes:
        return b"\x89PNG\r\n\x1a\n" + bytes(8)

    def seen(self) -> Seen | None:
        return self.measured

    async def observe(self) -> None:
        look = await self.rig.look(1)
        self.measured = Seen(observed(look, self.pictures), CAMERA, TOOL_ID)

    async def target_at(self, click: Click, frame_id: int | None) -> KeptTarget:
        if frame_id == 1:
            raise TargetRefused("target.frame_too_old", "target: picture 1 is no longer kept")
        if click.pixel[0] < 0.0:
            places = (Candidate((5.0, 6.0), np.array([0.1, 0.2, 1.0])),)
            raise TargetRefused("target.ambiguous", "target: places look alike", places)
        look, square = await self.rig.look(1), 10.0 * np.array(_SQUARE)
        seen = TargetObservation("hole", look.X_CO, 1e-6 * np.eye(6), np.eye(6), 0.9, square, 0.045)
        return self.targets.add(seen, 7, look.X_BT, None)

    async def detected_holes(self, diameter_mm: float | None) -> tuple[int, list[TargetObservation]]:
        kept = await self.target_at(Click(np.zeros(2)), None)
        self.targets.remove(kept.id)
        seen = TargetObservation("hole", kept.X_CO, kept.covariance, np.eye(6), 0.9, kept.outline, 0.045)
        return 8, [seen]

    async def pair_after(self, capture_ns: int) -> StereoPair:
        if not self.connected:
            raise LinkLost("link.camera_silent", "no picture")
        if self.trouble:
            raise LinkLost(self.trouble, "no picture")
        await asyncio.sleep(self.picture_s)
        self.pictures += 1
        picture = np.full((CAMERA.height, CAMERA.width), 60 + self.pictures % 60, dtype=np.uint8)
        captured_ns = time.monotonic_ns() - round(1e9 * self.behind_s)
        return StereoPair(picture, picture, captured_ns, self.pictures)


class Bench:
    """Everything a test of the REST face wants, over one synthetic arm."""

    def __init__(self, client: httpx.AsyncClient, station: VisionApplication, operations: Operations,
                 controller: LoopbackController, eyes: SyntheticEyes, log: HeardLog) -> None:  # fmt: skip
        self.client, self.station, self.operations = client, station, operations
        self.controller, self.eyes, self.rig, self.log = controller, eyes, eyes.rig, log

    async def post(self, path: str, body: Any = None, **headers: str) -> httpx.Response:
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        return await self.client.post(path, json=body, headers=named)

    async def run(self, kind: str, body: Any = None) -> dict[str, Any]:
        """The operation, ended; follows Location as a client would."""
        answer = await self.post(f"/operations/{kind}", body)
        assert answer.status_code == 202, answer.text
        return await self.ended(answer.headers["Location"])

    async def succeeded(self, kind: str, body: Any = None) -> dict[str, Any]:
        """As ``run``; one that did not succeed fails the test with its problem."""
        operation = await self.run(kind, body)
        assert operation["state"] == "succeeded", operation["problem"]
        return operation

    async def ended(self, location: str) -> dict[str, Any]:
        for _ in range(3000):
            operation: dict[str, Any] = (await self.client.get(location)).json()
            if operation["state"] in ("succeeded", "failed", "cancelled"):
                return operation
            await asyncio.sleep(0.01)
        raise AssertionError(f"{location} did not end")

    def silence(self) -> None:
        """Have the controller say nothing more, as if it had been killed; from any thread."""
        self.controller.muted = True

    def events(self, name: str) -> list[dict[str, Any]]:
        return self.log.lines(name)


def quick(settings: ProgramSettings) -> ProgramSettings:
    """``settings`` with short rests at corners: this camera is fast."""
    trajectory = settings.trajectory.model_copy(update={"dwell_s": 0.1})
    local_map = settings.local_map.model_copy(update={"dwell_s": 0.1})
    return settings.model_copy(update={"trajectory": trajectory, "local_map": local_map})


@asynccontextmanager
async def bench(
    seed: int = 0,
    record_dir: Path | None = None,
    link_timeout_ms: int = 30_000,  # one thread runs both ends, and this machine may be busy
    tries_valves: bool = False,
    **truth: Any,
) -> AsyncIterator[Bench]:
    """A bench with the controller connected and disabled; ``tries_valves``: what it says of itself."""
    rig = SyntheticRig(draw(np.random.default_rng(seed), **truth), seed, rate_hz=100.0)
    granted = CAPABILITY_PATHS | CAPABILITY_STREAMING | (CAPABILITY_VALVE_TRIALS if tries_valves else 0)
    controller = LoopbackController(rig, link_timeout_ms=link_timeout_ms, capabilities=granted)
    await controller.start()
    log = HeardLog("vision_pc")
    if record_dir is not None:
        log.record_in(record_dir)
    endpoint = UdpEndpoint(
        LinkSettings(port=controller.port, state_period_ms=10), ANY_ARM, log, ProcessClock()
    )
    link = endpoint.link
    arm = LinkArm(link, MotionSettings(settle_timeout_s=0.5, rest_s=0.01))
    eyes = SyntheticEyes(rig, controller)
    station = VisionApplication(arm, eyes, link, eyes, quick(shipped()), BOOM, log)
    station.links = dh_links(load(NominalArm, CONFIGS / "arm.yaml"))
    operations = Operations(arm.halt, log)
    transport = httpx.ASGITransport(app=create_app(station, operations), raise_app_exceptions=False)
    await endpoint.start()  # after the app, which takes longer to make than the link bears silence
    await until(lambda: link.connected)
    async with httpx.AsyncClient(transport=transport, base_url="http://vision") as client:
        yield Bench(client, station, operations, controller, eyes, log)
    await operations.close()
    await endpoint.close()
    await controller.stop()
    log.close()
