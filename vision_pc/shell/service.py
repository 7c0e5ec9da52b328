"""The vision PC's process: camera, link, application and REST API, from configuration to a clean end."""

import asyncio
import os
import socket
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

import cv2

from foundation.event_log import EventLog
from foundation.incidents import incidents_here
from foundation.live.feed import open_show
from foundation.periods import Limit, Tally
from foundation.rest.problems import RefusalLog
from foundation.rest.server import RestServer, service_socket
from foundation.rest.tokens import WARNING, access_without_token, without_token
from foundation.secret_source import bound_tcp, read_key
from foundation.self_watch import SelfWatch, StatisticsFile, resident_mb
from foundation.service_main import ServiceOptions, say_ready, when_asked_to_end
from nominal_arm.description import NominalArm
from nominal_arm.dimensions import dimensions, joint_ranges
from protocol.errors import ConfigurationError
from vision_pc.application.application import VisionApplication
from vision_pc.application.camera_eyes import CameraEyes
from vision_pc.application.hand_eye.guided_calibration import GuidedCalibration
from vision_pc.application.hand_eye.steps import SessionStore
from vision_pc.application.link_arm import LinkArm
from vision_pc.application.program import Program
from vision_pc.config.vision import VisionConfig
from vision_pc.shell.camera_eyes import MonotonicClock, open_eyes
from vision_pc.shell.cameras import open_camera
from vision_pc.shell.link.udp_endpoint import MachineWatch, UdpEndpoint
from vision_pc.shell.recording.opening import open_recording
from vision_pc.shell.recording.recorded_ports import record_programs
from vision_pc.shell.rest.api import STOPS, create_app
from vision_pc.shell.rest.console.routes import PUBLIC
from vision_pc.shell.rest.metrics import told
from vision_pc.shell.rest.operations import Operations
from vision_pc.shell.stops.door_process import DoorProcess

_NAME = "vision_pc"
_SWITCH_S = 0.0005  # a tenth of Python's own: for how long a busy thread keeps the loop waiting
_LIMITS = {
    "scans": Limit(1.0, "of the controller's scans were late"),
    "pictures": Limit(20.0, "of the pictures were skipped"),
}


class VisionService:
    """One running vision PC."""

    def __init__(
        self,
        config: VisionConfig,
        arm: NominalArm,
        options: ServiceOptions,
        log: EventLog,
        programs: Sequence[Program[Any, Any]],
    ) -> None:
        """Read the tokens, bind the REST port, then try the directories. Raises ConfigurationError."""
        self._config = config
        self._log = log
        self._arm = arm
        self._programs = programs
        self._access = access_without_token(config.api, "vision.api", os.environ, STOPS, PUBLIC)
        self._socket = bound_tcp(config.api.host, config.api.port, "vision.api")
        self._told: Callable[[], str] = str
        self._status = 0
        self._sessions = SessionStore(config.sessions_dir)
        try:
            self._sessions.refuse_strangers()
            if options.record_dir is not None:
                log.record_in(options.record_dir)
            self._open_records(options)
        except ConfigurationError:
            self._socket.close()
            raise

    def _open_records(self, options: ServiceOptions) -> None:
        """Raises ConfigurationError."""
        config, log = self._config, self._log
        self._statistics = StatisticsFile(options.statistics, _NAME, log, self._gathered)
        self._show = open_show(_NAME, config.live, "vision.live", log, lambda: self._told())
        feed = None if self._show is None else self._show.feed
        self._recorder = open_recording(options.record_dir, config, self._arm, log, feed)

    async def run(self) -> int:
        """Serve until SIGTERM or SIGINT, then end the running operation and say goodbye.

        Raises ConfigurationError when the key of the link cannot be read.
        """
        with self._socket, service_socket() as (at, listener):
            key = read_key(self._config.link.link_key)
            self._refusals = RefusalLog(self._log)
            self._address = self._socket.getsockname()
            self._door = DoorProcess(self._socket, at, self._access, key, self._refusals)
            try:
                await self._serve(listener)
            finally:
                self._door.close()
        return self._status

    def _endpoint(self) -> UdpEndpoint:
        settings, arm = self._config.link, self._arm
        made = UdpEndpoint(settings, settings.expected_arm(arm), self._log, MonotonicClock(), self._door)
        made.link.ranges = {} if settings.any_arm else joint_ranges(arm)
        return made

    async def _serve(self, listener: socket.socket) -> None:
        cv2.setNumThreads(1)  # one core is for the controller and the plant
        sys.setswitchinterval(_SWITCH_S)
        config, log = self._config, self._log
        endpoint = self._endpoint()
        self._link = link = endpoint.link
        camera = open_camera(config.camera)
        self._opened = opened = open_eyes(camera, link, config, log)
        application = self._application(opened.eyes)
        MachineWatch(camera, link, application.begin_anew)
        watch = SelfWatch(log, _LIMITS, self._work, log.record_dir)
        application.overload = lambda: watch.overload
        self._record_from(opened.eyes, application)
        operations = Operations(application.arm.halt, log)
        face = config.api.emulator_face
        server = RestServer(create_app(application, operations, self._programs, emulator_face=face))
        self._heed(operations, server)
        await endpoint.start()
        await camera.start()
        beside = [asyncio.create_task(w) for w in (self._statistics.keep_writing(), watch.keep_looking())]
        self._say_ready()
        try:
            await server.serve([listener])
        finally:
            for task in beside:
                task.cancel()
            await operations.close()
            await endpoint.close()
            await camera.close()
            opened.close()
            self._statistics.write()
            await self._say_stopped()

    def _application(self, eyes: CameraEyes) -> VisionApplication:
        config, link, log, nominal = self._config, self._link, self._log, dimensions(self._arm)
        arm = LinkArm(link, config.motion)
        guided = GuidedCalibration(arm, eyes, link, config, nominal, log, self._sessions)
        made = VisionApplication(arm, eyes, link, eyes, config.programs, nominal.boom, log, guided)
        made.figures, made.incidents = self._counters, incidents_here().newest
        made.links, self._told = nominal.links, partial(told, made)
        return made

    def _heed(self, operations: Operations, server: RestServer) -> None:
        """End the operation after a stop of the door's; end the service when asked, or without a door."""
        ending: set[asyncio.Task[None]] = set()

        def end_operation() -> None:
            ending.add(task := asyncio.create_task(operations.close()))
            task.add_done_callback(ending.discard)

        def leave() -> None:
            end_operation()  # the arm first, then open connections
            server.should_exit = True

        def door_gone() -> None:
            self._status = 1
            self._log.write("door_ended", "error", cause="internal", detail="the REST port's process")
            leave()

        self._door.stopped, self._door.gone = end_operation, door_gone
        when_asked_to_end(leave)

    def _record_from(self, eyes: CameraEyes, application: VisionApplication) -> None:
        if self._recorder is not None:
            eyes.recorded_by(self._recorder)
            record_programs(application, self._recorder)
            self._recorder.listen_to(self._link)

    async def _say_stopped(self) -> None:
        self._log.write("stopped")
        if self._recorder is not None:
            await asyncio.to_thread(self._recorder.close)
        if self._show is not None:
            await asyncio.to_thread(self._show.close)

    def _say_ready(self) -> None:
        if without_token(os.environ):
            self._log.write("without_token", "warning", cause="configuration.no_token", detail=WARNING)
        host, port = self._address
        say_ready(
            _NAME,
            rest={"host": host, "port": port},
            controller={"host": self._config.link.host, "port": self._config.link.port},
            camera=self._config.camera.source,
            scheduling=self._opened.worker.scheduling,
            live=None if self._show is None else self._show.address,
        )

    def _work(self) -> dict[str, Tally]:
        pictures = self._opened.eyes.status()
        work = {"pictures": Tally(pictures.frames, pictures.dropped)}
        if self._link.connected:
            state = self._link.state
            work["scans"] = Tally(state.cycle, state.overruns)
        return work

    def _counters(self) -> dict[str, Any]:
        return self._gathered() | {"log_lines_dropped": self._log.dropped}

    def _gathered(self) -> dict[str, Any]:
        return {
            "time_ns": time.monotonic_ns(),
            "memory_mb": resident_mb(),
            "link": asdict(self._link.statistics),
            "camera": self._opened.eyes.status()._asdict(),
            "scheduling": self._opened.worker.scheduling,
            "rest_refused": dict(self._refusals.counts),
            "live_dropped": 0 if self._show is None else self._show.feed.dropped,
            "recording": {} if self._recorder is None else self._recorder.counts(),
        }
