"""The plant's end of the camera: starts the renderer process, hands it the poses at each capture instant."""

import asyncio
import contextlib
import json
import socket
from collections.abc import Sequence
from typing import Any

from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.camera_motion import CameraMotion, CameraView, Capture
from plant_emulator.core.camera.exposures import Exposures
from plant_emulator.core.faults.kinds import AnyFault
from plant_emulator.shell.child_process import ended, started
from plant_emulator.shell.renderer import encode_shot
from protocol.errors import LinkLost

_END_TIMEOUT_S = 1.0
_REPORT_BYTES = 65536


class CameraSender:
    """A renderer process and the socket to it. ``statistics`` is its latest report."""

    def __init__(self, scene: SceneConfig, listener: socket.socket, scheduling: str) -> None:
        """Start the process; it takes over ``listener``, which is closed here."""
        self.statistics: dict[str, Any] = {}
        self.poses_dropped = 0
        self.frames_lost = 0
        self.ended = asyncio.Event()
        self._ready = asyncio.Event()
        self._frame_id = 0
        self._exposures = Exposures(scene.camera, scene.seed)
        self._poses, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._poses.setblocking(False)
        self._process = started("plant_emulator.shell.renderer", scene, listener, theirs, scheduling)
        asyncio.get_running_loop().add_reader(self._poses.fileno(), self._report_arrived)

    @property
    def pid(self) -> int:
        """Process number of the renderer."""
        return self._process.pid

    async def wait_ready(self) -> None:
        """Return when the renderer can render. Raises LinkLost when it ended instead."""
        waits = [asyncio.ensure_future(event.wait()) for event in (self._ready, self.ended)]
        try:
            await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for wait in waits:
                wait.cancel()
        if self.ended.is_set():
            raise LinkLost("link.renderer_ended", f"the renderer ended with status {self._process.wait()}")

    def capture(
        self, view: CameraView, motion: CameraMotion, capture_ns: int, faults: Sequence[AnyFault]
    ) -> int:
        """Number of the frame that is to show ``view``, unless one of the plant's ``faults`` forbids it.

        It is dropped and counted when it is lost on purpose, and when the renderer hangs.
        """
        self._frame_id += 1
        shot = self._exposures.shot(Capture(self._frame_id, capture_ns, view, motion), faults)
        if not shot.delivered:
            self.frames_lost += 1
            return self._frame_id
        try:
            self._poses.send(encode_shot(shot))
        except OSError:
            self.poses_dropped += 1
        return self._frame_id

    async def stop(self) -> None:
        """End the renderer and wait for its last report."""
        with contextlib.suppress(OSError):
            self._poses.shutdown(socket.SHUT_WR)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_END_TIMEOUT_S):
                await self.ended.wait()
        asyncio.get_running_loop().remove_reader(self._poses.fileno())
        self._poses.close()
        await asyncio.to_thread(ended, self._process)

    def _report_arrived(self) -> None:
        try:
            data = self._poses.recv(_REPORT_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            asyncio.get_running_loop().remove_reader(self._poses.fileno())
            self.ended.set()
            return
        report = json.loads(data)
        if report.pop("event") == "ready":
            self._ready.set()
        self.statistics = report
