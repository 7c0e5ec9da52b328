"""The renderer's own process: poses in by a local socket, pictures out by TCP, at the lowest priority.

A thread of the plant's process would hold its interpreter lock and make the physics late, so this is a
process. Started by ``camera_sender`` with the scene as JSON on stdin and two inherited sockets; it ends
when the plant's end of the pose socket closes, however the plant ended.
"""

import contextlib
import json
import os
import signal
import socket
import struct
import sys
import time
from typing import NamedTuple

import cv2
import numpy as np

from plant_emulator.core.camera_motion import Motion, View
from plant_emulator.core.scene import Scene
from plant_emulator.core.stereo_camera import StereoCamera
from plant_emulator.scene_config import SceneConfig
from plant_emulator.shell.frame_server import FrameServer, StereoFrame

_POSES = struct.Struct("<QQ44d")
_REPORT_NS = 1_000_000_000
_POLICIES = {"idle": os.SCHED_IDLE, "batch": os.SCHED_BATCH, "normal": os.SCHED_OTHER}


class Capture(NamedTuple):
    """One capture instant: where eye and tool marker are, and how they move."""

    frame_id: int
    capture_ns: int
    view: View
    motion: Motion


def encode_capture(capture: Capture) -> bytes:
    """The datagram that carries ``capture`` from the plant to the renderer."""
    numbers = (*capture.view.X_WC.flat, *capture.view.X_WM.flat, *capture.motion.rates.flat)
    return _POSES.pack(capture.frame_id, capture.capture_ns, *numbers)


def decode_capture(data: bytes) -> Capture:
    """The capture in a datagram."""
    frame_id, capture_ns, *numbers = _POSES.unpack(data)
    X_WC, X_WM = np.array(numbers[:32]).reshape(2, 4, 4)
    return Capture(frame_id, capture_ns, View(X_WC, X_WM), Motion(np.array(numbers[32:]).reshape(2, 6)))


class Renderer:
    """Renders the newest capture asked for, while anybody watches; older ones are skipped and counted."""

    def __init__(self, scene: SceneConfig, poses: socket.socket, server: FrameServer) -> None:
        self._camera = StereoCamera(scene.camera, Scene(scene), scene.seed)
        self._exposure_us = scene.camera.exposure_us
        self._poses = poses
        self._server = server
        self._rendered = 0
        self._skipped = 0
        self._unwatched = 0
        self._lost = 0
        self._render_ns: list[int] = []

    def warm_up(self) -> None:
        """Compile the painters, or load what was compiled before; the first frame must not wait for that."""
        self._camera.render(np.eye(4), np.eye(4), 0)

    def run(self) -> None:
        """Say that the renderer is ready, then serve until the plant closes its end."""
        self._report("ready")
        next_report = time.monotonic_ns() + _REPORT_NS
        while (capture := self._newest()) is not None:
            if not self._server.watched:
                self._unwatched += 1
            elif self._camera.delivers(capture.frame_id):
                self._render(capture)
            else:
                self._lost += 1
            if time.monotonic_ns() >= next_report:
                next_report = time.monotonic_ns() + _REPORT_NS
                self._report("running")
        self._report("ended")

    def _newest(self) -> Capture | None:
        """The newest capture waiting, after waiting for one; None when the plant has gone."""
        data = self._poses.recv(_POSES.size)
        while data:
            try:
                newer = self._poses.recv(_POSES.size, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return decode_capture(data)
            self._skipped += bool(newer)
            data = newer
        return None

    def _render(self, capture: Capture) -> None:
        begun = time.thread_time_ns()
        left, right = self._camera.render(*capture.view, capture.frame_id, capture.motion)
        self._render_ns = [*self._render_ns[-999:], time.thread_time_ns() - begun]
        self._rendered += 1
        self._server.publish(
            StereoFrame(capture.frame_id, capture.capture_ns, self._exposure_us, left, right)
        )

    def _report(self, event: str) -> None:
        times = np.array(self._render_ns or [0]) / 1e6
        report = {
            "event": event,
            "frames_rendered": self._rendered,
            "frames_skipped": self._skipped,
            "frames_unwatched": self._unwatched,
            "frames_lost_on_purpose": self._lost,
            "render_cpu_p50_ms": float(np.percentile(times, 50)),
            "render_cpu_p99_ms": float(np.percentile(times, 99)),
            **self._server.statistics(),
        }
        with contextlib.suppress(OSError):
            self._poses.send(json.dumps(report).encode(), socket.MSG_DONTWAIT)


def main() -> int:
    """Exit status of the renderer process."""
    # A signal to the whole process group reaches the plant too, which then closes its end of the socket.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    listen_fd, pose_fd, scheduling = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    cv2.setNumThreads(1)
    scene = SceneConfig.model_validate_json(sys.stdin.buffer.read())
    with socket.socket(fileno=pose_fd) as poses:
        server = FrameServer(socket.socket(fileno=listen_fd))
        renderer = Renderer(scene, poses, server)
        server.start()
        try:
            renderer.warm_up()
            os.sched_setscheduler(0, _POLICIES[scheduling], os.sched_param(0))
            renderer.run()
        except ConnectionError:
            pass  # the plant was killed: its end of the socket went with it
        finally:
            server.stop()
    return 0


if __name__ == "__main__":
    sys.exit(main())
