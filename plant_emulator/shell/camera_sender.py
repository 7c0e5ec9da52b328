"""The plant's end of the camera: starts the renderer process, hands it the poses at each capture instant."""

import asyncio
import contextlib
import json
import pickle
import signal
import socket
import sys
import time
from collections import deque
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from foundation.child_process import ended, started
from foundation.event_log import process_log
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.exposures import CameraMotion, CameraView, Capture, Exposures, Shot
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import StereoCamera
from plant_emulator.core.faults.kinds import AnyFault
from plant_emulator.shell.frame_server import FrameServer, StereoFrame
from protocol.errors import LinkLost

_MESSAGE_BYTES = 1 << 16
_REPORT_NS = 1_000_000_000
EVERY = "every"
PICTURE_NS = 30_000_000
"""From the capture of a picture until it is there, in the plant's time: what rendering and the stream take on
a machine that keeps up [M]. Meanwhile the other core goes on."""


class Renderer:
    """Renders the newest shot asked for, while anybody watches; older ones are skipped and counted.

    ``every``: none is skipped, and what became of each is told: the plant's time waits for it.
    """

    def __init__(self, scene: SceneConfig, poses: socket.socket, server: FrameServer, every: bool) -> None:
        self._camera = StereoCamera(scene.camera, Scene(scene), scene.seed)
        self._exposure_us = scene.camera.exposure_us
        self._poses = poses
        self._server = server
        self._every = every
        self._rendered = 0
        self._skipped = 0
        self._unwatched = 0
        self._render_ns: list[int] = []

    def warm_up(self) -> None:
        """Compile the painters, or load what was compiled before; the first frame must not wait for that."""
        self._camera.render(np.eye(4), np.eye(4), 0)

    def run(self) -> None:
        """Say that the renderer is ready, then serve until the plant closes its end."""
        self._report("ready")
        next_report = time.monotonic_ns() + _REPORT_NS
        while (shot := self._newest()) is not None:
            if watched := self._server.watched:
                self._render(shot)
            else:
                self._unwatched += 1
            if self._every:
                _send(self._poses, event="picture", published=watched)
            if time.monotonic_ns() >= next_report:
                next_report = time.monotonic_ns() + _REPORT_NS
                self._report("running")
        self._report("ended")

    def _newest(self) -> Shot | None:
        """The newest shot waiting, after waiting for one; None when the plant has gone."""
        data = self._poses.recv(_MESSAGE_BYTES)
        while data and not self._every:
            try:
                newer = self._poses.recv(_MESSAGE_BYTES, socket.MSG_DONTWAIT)
            except BlockingIOError:
                break
            self._skipped += bool(newer)
            data = newer
        shot: Shot | None = pickle.loads(data) if data else None  # from the plant, which started this process
        return shot

    def _render(self, shot: Shot) -> None:
        begun = time.thread_time_ns()
        left, right = self._camera.take(shot)
        self._render_ns = [*self._render_ns[-999:], time.thread_time_ns() - begun]
        self._rendered += 1
        sent_ns = shot.capture_ns + PICTURE_NS if self._every else None
        frame = StereoFrame(shot.frame_id, shot.capture_ns, self._exposure_us, left, right, sent_ns)
        self._server.publish(frame)

    def _report(self, event: str) -> None:
        times = np.array(self._render_ns or [0]) / 1e6
        report = {
            "event": event,
            "frames_rendered": self._rendered,
            "frames_skipped": self._skipped,
            "frames_unwatched": self._unwatched,
            "render_cpu_p50_ms": float(np.percentile(times, 50)),
            "render_cpu_p99_ms": float(np.percentile(times, 99)),
            **self._server.statistics(),
        }
        _send(self._poses, **report)


def _send(poses: socket.socket, **report: Any) -> None:
    with contextlib.suppress(OSError):
        poses.send(json.dumps(report).encode(), socket.MSG_DONTWAIT)


def main() -> int:
    """Exit status of the renderer process."""
    # A signal to the whole process group reaches the plant too, which then closes its end of the socket.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    listen_fd, pose_fd, every = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    cv2.setNumThreads(1)
    with process_log("renderer"):
        _serve(listen_fd, pose_fd, every == EVERY)
    return 0


def _serve(listen_fd: int, pose_fd: int, every: bool) -> None:
    scene = SceneConfig.model_validate_json(sys.stdin.buffer.read())
    with socket.socket(fileno=pose_fd) as poses:
        server = FrameServer(socket.socket(fileno=listen_fd), lambda: _send(poses, event="watched"))
        renderer = Renderer(scene, poses, server, every)
        server.start()
        try:
            renderer.warm_up()
            renderer.run()
        except ConnectionError:
            pass  # the plant was killed: its end of the socket went with it
        finally:
            server.stop()


if __name__ == "__main__":
    sys.exit(main())


_END_TIMEOUT_S = 1.0
_WATCHED_WITHIN_S = 5.0
_REPORT_BYTES = 65536


class CameraSender:
    """A renderer process and the socket to it. ``statistics`` is its latest report.

    ``every``: each picture is awaited by ``published``, PICTURE_NS after its capture.
    """

    def __init__(self, scene: SceneConfig, listener: socket.socket, every: bool = False) -> None:
        """Start the process; it takes over ``listener``, which is closed here."""
        self.statistics: dict[str, Any] = {}
        self.poses_dropped = 0
        self.frames_lost = 0
        self.ended = asyncio.Event()
        self._ready = asyncio.Event()
        self._every = every
        self._due_ns: deque[int] = deque()
        self._published: asyncio.Queue[bool] = asyncio.Queue()
        self._watched = asyncio.Event()
        self._frame_id = 0
        self._exposures = Exposures(scene.camera, scene.seed)
        self._poses, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._poses.setblocking(False)
        with listener, theirs:
            inherited, given = (listener.fileno(), theirs.fileno()), scene.model_dump_json().encode()
            which = EVERY if every else "newest"
            self._process = started("plant_emulator.shell.camera_sender", given, inherited, which)
        asyncio.get_running_loop().add_reader(self._poses.fileno(), self._report_arrived)

    @property
    def pid(self) -> int:
        """Process number of the renderer."""
        return self._process.pid

    async def wait_ready(self) -> None:
        """Return when the renderer can render. Raises LinkLost when it ended instead."""
        await self._ready.wait()
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
        if not shot.delivered:  # nothing is due
            self.frames_lost += 1
            return self._frame_id
        try:
            self._poses.send(pickle.dumps(shot))
        except OSError:
            self.poses_dropped += 1
        else:
            if self._every:
                self._due_ns.append(capture_ns + PICTURE_NS)
        return self._frame_id

    async def watched(self) -> None:
        """Return once somebody has been served, after _WATCHED_WITHIN_S without anybody."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_WATCHED_WITHIN_S):
                await self._watched.wait()

    async def published(self, now_ns: int) -> bool:
        """Whether a picture was published that is due by ``now_ns``, once it was rendered."""
        if not self._due_ns or self._due_ns[0] > now_ns:
            return False
        self._due_ns.popleft()
        return await self._published.get()

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
            self._ready.set()
            self._published.put_nowait(False)
            return
        report = json.loads(data)
        event = report.pop("event")
        if event == "picture":
            self._published.put_nowait(report["published"])
            return
        if event == "watched":
            self._watched.set()
            return
        if event == "ready":
            self._ready.set()
        self.statistics = report
