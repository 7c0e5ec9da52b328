"""The vision PC's process: camera, link, application and REST API, from configuration to a clean end."""

import asyncio
import contextlib
import os
import socket
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import cv2

from foundation import clock
from foundation.event_log import EventLog
from foundation.incidents import incidents_here
from foundation.live.feed import open_show
from foundation.recording.beginning import session_entries
from foundation.recording.messages import RecordingThread
from foundation.recording.recorder import OpenSink
from foundation.rest.problems import RefusalLog
from foundation.rest.server import RestServer, service_socket
from foundation.rest.tokens import WARNING, access_without_token, without_token
from foundation.secret_source import bound_tcp, read_key
from foundation.self_watch import DiskWatch, resident_mb
from foundation.service_main import ServiceOptions, on_termination, say_ready
from nominal_arm.description import NominalArm
from nominal_arm.dimensions import dimensions, joint_ranges
from protocol.errors import ConfigurationError
from vision_pc.application.application import VisionApplication
from vision_pc.application.camera_eyes import CameraEyes
from vision_pc.application.hand_eye.guided_calibration import GuidedCalibration
from vision_pc.application.hand_eye.session_store import SessionStore
from vision_pc.application.link_arm import LinkArm
from vision_pc.application.program import Program
from vision_pc.config.vision import VisionConfig
from vision_pc.shell.camera_eyes import ProcessClock, open_eyes
from vision_pc.shell.cameras import CameraSource, open_camera
from vision_pc.shell.link.udp_endpoint import MachineWatch, UdpEndpoint
from vision_pc.shell.machine_clock import MachineClock
from vision_pc.shell.recording.vision_recorder import FILE, VisionRecorder
from vision_pc.shell.rest.api import STOPS, create_app
from vision_pc.shell.rest.console.routes import PUBLIC
from vision_pc.shell.rest.metrics import metrics_text
from vision_pc.shell.rest.operations import Operations
from vision_pc.shell.stops.door_process import DoorProcess

_NAME = "vision_pc"
_SEEN_S = 5.0
_SWITCH_S = 0.0005  # a tenth of Python's own: for how long a busy thread keeps the loop waiting


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
        self._metrics_text: Callable[[], str] = str
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
        self._show = open_show(_NAME, log, lambda: self._metrics_text())
        self._recorder: VisionRecorder | None = None
        directory, show = options.record_dir, self._show
        if directory is None and show is None:
            return
        made: OpenSink = RecordingThread if show is None else show.opened(directory is not None)
        run = {"arm": self._arm.model_dump(mode="json"), "vision": config.model_dump(mode="json")}
        path, session = (directory or Path()) / FILE, session_entries(_NAME)
        self._recorder = VisionRecorder(path, config, run, session, clock.now_ns, made)
        self._recorder.tell_failure(log.write)
        log.listener = self._recorder.event

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
        made = UdpEndpoint(settings, settings.expected_arm(arm), self._log, ProcessClock(), self._door)
        made.link.ranges = {} if settings.any_arm else joint_ranges(arm)
        return made

    async def _serve(self, listener: socket.socket) -> None:
        cv2.setNumThreads(1)  # one core is for the controller and the plant
        sys.setswitchinterval(_SWITCH_S)
        config, log = self._config, self._log
        if following := clock.followed():
            self._refuse_foreign()
            await following.join()
        machine = MachineClock()
        endpoint = self._endpoint()
        self._link = link = endpoint.link
        camera = open_camera(config.camera)
        self._opened = opened = open_eyes(camera, link, config, log)
        application = self._application(opened.eyes)
        MachineWatch(camera, link, application.begin_anew)
        watch = DiskWatch(log, log.record_dir)
        self._record_from(opened.eyes, application)
        operations = Operations(application.arm.halt, log)
        machine.at_work = partial(_at_work, application, operations)
        machine.on_held = self._door.hold_clock
        app = create_app(application, operations, self._programs, config.api.emulator_face, machine)
        server = RestServer(app)
        self._heed(operations, server, machine)
        await endpoint.start()
        await camera.start()
        beside = asyncio.create_task(watch.keep_looking())
        if following:
            await _seen(camera)
            following.ready()
        self._say_ready()
        try:
            await server.serve([listener])
        finally:
            beside.cancel()
            await operations.close()
            await endpoint.close()
            await camera.close()
            opened.close()
            await self._say_stopped()

    def _application(self, eyes: CameraEyes) -> VisionApplication:
        config, link, log, nominal = self._config, self._link, self._log, dimensions(self._arm)
        arm = LinkArm(link, config.motion)
        guided = GuidedCalibration(arm, eyes, link, config, nominal, log, self._sessions)
        made = VisionApplication(arm, eyes, link, eyes, config.programs, nominal.boom, log, guided)
        made.metrics, made.incidents = self._counters, incidents_here().newest
        made.links, self._metrics_text = nominal.links, partial(metrics_text, made)
        return made

    def _refuse_foreign(self) -> None:
        """Raises ConfigurationError where a part is somebody else's, which does not follow the plant."""
        camera, odometry = self._config.camera.source, self._config.odometry_feed.source
        for key, value, ours in (("camera", camera, "stream"), ("odometry_feed", odometry, "own")):
            if value != ours:
                why = f"vision.{key}.source = {value} goes by the wall, and so must all: --clock wall"
                raise ConfigurationError("configuration.foreign_clock", why)

    def _heed(self, operations: Operations, server: RestServer, machine: MachineClock) -> None:
        """End the operation after a stop of the door's; end the service when asked, or without a door."""
        ending: set[asyncio.Task[None]] = set()

        def end_operation() -> None:
            machine.stopped()
            ending.add(task := asyncio.create_task(operations.close()))
            task.add_done_callback(ending.discard)

        def leave() -> None:
            clock.current().leave()
            end_operation()  # the arm first, then open connections
            server.should_exit = True

        def door_gone() -> None:
            self._status = 1
            self._log.write("door_ended", "error", cause="internal", detail="the REST port's process")
            leave()

        self._door.stopped, self._door.gone = end_operation, door_gone
        on_termination(leave)

    def _record_from(self, eyes: CameraEyes, application: VisionApplication) -> None:
        if self._recorder is not None:
            eyes.recorded_by(self._recorder)
            self._recorder.listen_to(self._link)

    async def _say_stopped(self) -> None:
        self._log.write("stopped", statistics=self._gathered())
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
        )

    def _counters(self) -> dict[str, Any]:
        return self._gathered() | {"log_lines_dropped": self._log.dropped}

    def _gathered(self) -> dict[str, Any]:
        return {
            "time_ns": clock.now_ns(),
            "memory_mb": resident_mb(),
            "link": asdict(self._link.session.statistics),
            "camera": self._opened.eyes.status()._asdict(),
            "scheduling": self._opened.worker.scheduling,
            "rest_refused": dict(self._refusals.counts),
            "live_dropped": 0 if self._show is None else self._show.dropped,
            "recording": {} if self._recorder is None else self._recorder.counts(),
        }


def _at_work(application: VisionApplication, operations: Operations) -> bool:
    """Whether an operation runs, or controller, plant or camera are still to be there."""
    there = application.controller.hears_plant and application.camera.status().connected
    return operations.current is not None or not there


async def _seen(camera: CameraSource) -> None:
    """Return once the camera's connection stands, after _SEEN_S without one."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(_SEEN_S):
            await camera.there.wait()
