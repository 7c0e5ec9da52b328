"""The renderer's own process: poses in by a local socket, pictures out by TCP, at the lowest priority.

A thread of the plant's process would hold its interpreter lock and make the physics late, so this is a
process. Started by ``camera_sender`` with the scene as JSON on stdin and two inherited sockets; it ends
when the plant's end of the pose socket closes, however the plant ended.
"""

import contextlib
import json
import signal
import socket
import struct
import sys
import time
from typing import cast

import cv2
import numpy as np
from pydantic import BaseModel

from foundation.event_log import process_log
from foundation.periods import Policy, take_policy
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.camera_motion import CameraMotion, CameraView, Capture
from plant_emulator.core.camera.exposures import Shot
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import StereoCamera
from plant_emulator.core.faults.kinds import CameraBlind, MarkerCovered
from plant_emulator.shell.frame_server import FrameServer, StereoFrame

_POSES = struct.Struct("<4Q46d")
_MESSAGE_BYTES = 1 << 16
_REPORT_NS = 1_000_000_000


class _Sights(BaseModel):
    """What hinders the camera's sight."""

    blind: CameraBlind | None
    covers: tuple[MarkerCovered, ...]


def encode_shot(shot: Shot) -> bytes:
    """The datagram that carries ``shot`` to the renderer: numbers, then what hinders its sight as JSON."""
    shown = shot.shown
    numbers = (*shown.view.X_WC.flat, *shown.view.X_WM.flat, *shown.motion.rates.flat, *shown.drift_px)
    poses = _POSES.pack(shot.frame_id, shot.capture_ns, shown.frame_id, shown.capture_ns, *numbers)
    return poses + _Sights(blind=shot.blind, covers=shot.covers).model_dump_json().encode()


def decode_shot(data: bytes) -> Shot:
    """The shot in a datagram; what is sent is to be delivered."""
    frame_id, capture_ns, shown_id, shown_ns, *numbers = _POSES.unpack_from(data)
    X_WC, X_WM = np.array(numbers[:32]).reshape(2, 4, 4)
    motion = CameraMotion(np.array(numbers[32:44]).reshape(2, 6))
    shown = Capture(shown_id, shown_ns, CameraView(X_WC, X_WM), motion, (numbers[44], numbers[45]))
    sights = _Sights.model_validate_json(data[_POSES.size :])
    return Shot(frame_id, capture_ns, shown, sights.blind, sights.covers, delivered=True)


class Renderer:
    """Renders the newest shot asked for, while anybody watches; older ones are skipped and counted."""

    def __init__(self, scene: SceneConfig, poses: socket.socket, server: FrameServer) -> None:
        self._camera = StereoCamera(scene.camera, Scene(scene), scene.seed)
        self._exposure_us = scene.camera.exposure_us
        self._poses = poses
        self._server = server
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
            if self._server.watched:
                self._render(shot)
            else:
                self._unwatched += 1
            if time.monotonic_ns() >= next_report:
                next_report = time.monotonic_ns() + _REPORT_NS
                self._report("running")
        self._report("ended")

    def _newest(self) -> Shot | None:
        """The newest shot waiting, after waiting for one; None when the plant has gone."""
        data = self._poses.recv(_MESSAGE_BYTES)
        while data:
            try:
                newer = self._poses.recv(_MESSAGE_BYTES, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return decode_shot(data)
            self._skipped += bool(newer)
            data = newer
        return None

    def _render(self, shot: Shot) -> None:
        begun = time.thread_time_ns()
        left, right = self._camera.take(shot)
        self._render_ns = [*self._render_ns[-999:], time.thread_time_ns() - begun]
        self._rendered += 1
        self._server.publish(StereoFrame(shot.frame_id, shot.capture_ns, self._exposure_us, left, right))

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
        with contextlib.suppress(OSError):
            self._poses.send(json.dumps(report).encode(), socket.MSG_DONTWAIT)


def main() -> int:
    """Exit status of the renderer process."""
    # A signal to the whole process group reaches the plant too, which then closes its end of the socket.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    listen_fd, pose_fd, scheduling = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    cv2.setNumThreads(1)
    with process_log("renderer"):
        _serve(listen_fd, pose_fd, cast(Policy, scheduling))
    return 0


def _serve(listen_fd: int, pose_fd: int, scheduling: Policy) -> None:
    scene = SceneConfig.model_validate_json(sys.stdin.buffer.read())
    with socket.socket(fileno=pose_fd) as poses:
        server = FrameServer(socket.socket(fileno=listen_fd))
        renderer = Renderer(scene, poses, server)
        server.start()
        try:
            renderer.warm_up()
            take_policy(scheduling)
            renderer.run()
        except ConnectionError:
            pass  # the plant was killed: its end of the socket went with it
        finally:
            server.stop()


if __name__ == "__main__":
    sys.exit(main())
