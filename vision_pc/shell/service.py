"""The vision PC's process: camera, link, station and REST face, from configuration to a clean end."""

import asyncio
import contextlib
import errno
import json
import os
import signal
import socket
import time
from collections.abc import Generator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import uvicorn

from protocol.errors import ConfigurationError
from vision_pc.application.application import VisionApplication
from vision_pc.application.eyes import CameraEyes
from vision_pc.application.hand_eye.guided_calibration import GuidedCalibration
from vision_pc.application.hand_eye.store import SessionStore
from vision_pc.application.link_arm import LinkArm
from vision_pc.application.program import Program
from vision_pc.application.programs import PROGRAMS
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.config.vision import ApiSettings, VisionConfig
from vision_pc.shell.cameras import open_camera
from vision_pc.shell.event_log import EventLog
from vision_pc.shell.link.udp_endpoint import UdpEndpoint
from vision_pc.shell.monotonic_clock import MonotonicClock
from vision_pc.shell.rest.api import create_app
from vision_pc.shell.rest.operations import Operations

_STATISTICS_S = 10.0
_DRAIN_S = 1  # for answers under way at the end; the process must be gone within 2 s
_PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 1e6


class Options(NamedTuple):
    """What the command line adds to the configuration."""

    record_dir: Path | None
    statistics: Path | None


class _Server(uvicorn.Server):
    """Uvicorn that leaves the signals to the service."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        yield


class VisionService:
    """One running vision PC."""

    def __init__(
        self, config: VisionConfig, options: Options, programs: Sequence[Program[Any, Any]] = PROGRAMS
    ) -> None:
        """Binds the REST port. Raises ConfigurationError when it is busy, or the records unwritable."""
        self._config = config
        self._options = options
        self._programs = programs
        self.log = EventLog(options.record_dir)
        try:
            self._socket = bound(config.api)
        except ConfigurationError:
            self.log.close()
            raise

    async def run(self) -> None:
        """Serves until SIGTERM or SIGINT, then ends the running operation and says goodbye."""
        cv2.setNumThreads(1)  # one core is for the controller and the plant
        config, log = self._config, self.log
        endpoint = UdpEndpoint(config.link, log, MonotonicClock())
        link = endpoint.link
        camera = open_camera(config.camera)
        eyes = CameraEyes(camera, link, config, log)
        arm = LinkArm(link, config.motion)
        guided = GuidedCalibration(arm, eyes, link, config, log, SessionStore(config.sessions_dir))
        application = VisionApplication(arm, eyes, link, eyes, config.programs, log, guided)
        operations = Operations(arm.halt, log)
        server = _Server(
            uvicorn.Config(
                create_app(application, operations, self._programs),
                log_config=None,
                access_log=False,
                lifespan="off",
                timeout_graceful_shutdown=_DRAIN_S,
            )
        )

        leaving: list[asyncio.Task[None]] = []

        def leave() -> None:
            leaving.append(asyncio.create_task(operations.close()))  # the arm first, then open connections
            server.should_exit = True

        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, leave)
        await endpoint.start()
        await camera.start()
        figures = asyncio.create_task(self._write_figures(link, eyes))
        self._say_ready(eyes)
        try:
            await server.serve([self._socket])
        finally:
            figures.cancel()
            await operations.close()
            await endpoint.close()
            await camera.close()
            eyes.close()
            self._write_statistics(link, eyes)
            log.write("stopped")
            log.close()

    def _say_ready(self, eyes: CameraEyes) -> None:
        host, port = self._socket.getsockname()[:2]
        ready = {
            "event": "ready",
            "service": "vision_pc",
            "pid": os.getpid(),
            "rest": {"host": host, "port": port},
            "controller": {"host": self._config.link.host, "port": self._config.link.port},
            "camera": self._config.camera.source,
            "scheduling": eyes.scheduling,
        }
        print(json.dumps(ready), flush=True)

    async def _write_figures(self, link: ReferenceLink, eyes: CameraEyes) -> None:
        while True:
            await asyncio.sleep(_STATISTICS_S)
            self._write_statistics(link, eyes)

    def _write_statistics(self, link: ReferenceLink, eyes: CameraEyes) -> None:
        path = self._options.statistics
        if path is None:
            return
        figures: dict[str, Any] = {
            "time_ns": time.monotonic_ns(),
            "memory_mb": resident_mb(),
            "link": asdict(link.statistics),
            "camera": eyes.status()._asdict(),
            "scheduling": eyes.scheduling,
        }
        partial = path.with_name(path.name + ".part")
        try:
            partial.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
            partial.replace(path)
        except OSError as error:
            self.log.write(
                "statistics_failed", cause="statistics.unwritable", detail=f"{path}: {error.strerror}"
            )


def bound(api: ApiSettings) -> socket.socket:
    """A listening socket at the REST address. Raises ConfigurationError when it is busy or not ours."""
    where = f"REST at {api.host}:{api.port}"
    try:
        return socket.create_server((api.host, api.port), backlog=64)
    except OSError as error:
        busy = error.errno == errno.EADDRINUSE
        cause, why = ("port_busy", "address in use") if busy else ("bad_address", str(error))
        raise ConfigurationError(f"configuration.{cause}", f"{where}: {why}") from error


def resident_mb() -> float:
    """Resident memory of this process in MB."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * _PAGE_MB
