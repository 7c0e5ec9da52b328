"""The emulator's process: physics in real time, its fieldbus face, its camera, its recording."""

import asyncio
import json
import logging
import os
import signal
import time
from pathlib import Path
from typing import Any, NamedTuple

from plant_emulator.config.service import PlantSideConfig
from plant_emulator.core.camera.camera_motion import STILL, CameraView
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.faults.kinds import CouplerSilent
from plant_emulator.core.plant import Plant
from plant_emulator.shell.camera_sender import CameraSender
from plant_emulator.shell.coupler import Coupler
from plant_emulator.shell.fault_face import FaultFace
from plant_emulator.shell.integrator import Beat, Integrator
from plant_emulator.shell.machine import bound, resident_mb, scheduling
from plant_emulator.shell.recording import TruthRecorder
from protocol.errors import ConfigurationError
from protocol.process_image import ValveImage, encode_sensors

log = logging.getLogger(__name__)


class Options(NamedTuple):
    """What the command line adds to the configuration."""

    record_dir: Path | None
    statistics: Path | None


class PlantService:
    """One running emulator."""

    def __init__(self, config: PlantSideConfig, options: Options) -> None:
        self._config = config
        self._options = options
        service = config.service
        scene = Scene(config.scene)
        self._plant = Plant(config.plant, config.scene.seed, scene.mounts)
        self._face = FaultFace(self._plant, scene, service.fault_face.allowed)
        self._integrator = Integrator(self._plant, round(service.period_ms * 1e6), self._after_step)
        release_ns = round(service.writer_release_ms * 1e6)
        self._coupler = Coupler(
            self._sensor_words,
            self._write,
            release_ns,
            time.monotonic_ns,
            lambda: self._plant.faults.of_kind(CouplerSilent) is not None,
        )
        self._captures = Beat(round(1e9 / config.scene.camera.rate_hz))
        self._truths = Beat(round(1e9 / service.truth_hz))
        self._changes_told = 0
        self._words: list[int] | None = None
        self._status = -1
        self._recorder: TruthRecorder | None = None
        self._camera: CameraSender | None = None

    async def run(self) -> int:
        """Exit status, after serving until SIGTERM or SIGINT, or until the renderer fails.

        Raises ConfigurationError when a port is busy or the recording cannot be written.
        """
        stop = asyncio.Event()
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, stop.set)
        service = self._config.service
        with (
            bound(service.modbus, "plant_service.modbus") as modbus,
            bound(service.camera_stream, "plant_service.camera_stream") as stream,
            bound(service.fault_face, "plant_service.fault_face") as face,
        ):
            addresses = {"camera_stream": stream.getsockname(), "fault_face": face.getsockname()}
            self._recorder = self._open_recording()
            self._camera = CameraSender(self._config.scene, stream, service.renderer_scheduling)
            failed, figures = False, None
            try:
                self._warm_up()
                if await _first(self._camera.wait_ready(), stop.wait()):
                    addresses["modbus"] = await self._coupler.start(modbus)
                    self._face.start(face)
                    self._integrator.start()
                    obtained = scheduling(service.scheduling)
                    memory = self._memory()
                    self._say_ready(addresses, obtained)
                    failed = await _first(self._camera.ended.wait(), stop.wait())
                    figures = {
                        "scheduling": obtained,
                        "memory_at_start": memory,
                        "memory_at_end": self._memory(),
                    }
            finally:
                await self._shut_down()
        if figures is not None:
            self._write_statistics(figures)
        if failed:
            log.error("link.renderer_ended: the renderer ended by itself")
        return 1 if failed else 0

    def _warm_up(self) -> None:
        """Let everything compile before time begins to count."""
        self._plant.advance(round(self._config.service.period_ms * 1e6))
        self._plant.truth()
        self._sensor_words()

    def _after_step(self, deadline_ns: int) -> None:
        self._words = None
        self._tell_faults(deadline_ns)
        capture = self._captures.due(deadline_ns)
        record = self._recorder is not None and (capture or self._truths.due(deadline_ns))
        if not (capture or record):
            return
        truth = self._plant.truth()
        if capture and self._camera is not None:
            motion = self._plant.motion() if self._config.scene.camera.shows_motion else STILL
            view = CameraView(truth.X_WC, truth.X_WM)
            frame_id = self._camera.capture(view, motion, deadline_ns, self._plant.faults.in_force())
            if self._recorder is not None:
                self._recorder.capture(truth, deadline_ns, frame_id)
        elif record and self._recorder is not None:
            self._recorder.truth(truth, deadline_ns)

    def _write(self, image: ValveImage) -> None:
        self._plant.write(image)
        self._words = None  # what is read in the same exchange already echoes this image's cycle

    def _sensor_words(self) -> list[int]:
        """The newest input image; encoded once a step, so that reading it in pieces is consistent."""
        if self._words is None:
            image = self._plant.read()
            self._words = encode_sensors(image)
            if image.status != self._status:
                self._status = image.status
                self._event({"event": "status", "status": image.status})
        return self._words

    def _tell_faults(self, log_ns: int) -> None:
        changes = self._plant.faults.changes
        for change in changes[self._changes_told :]:
            log.info("%s", json.dumps({"event": "fault"} | change.as_dict()))
            if self._recorder is not None:
                self._recorder.fault(change, log_ns)
        self._changes_told = len(changes)

    def _event(self, fields: dict[str, Any]) -> None:
        log.info("%s", json.dumps(fields))
        if self._recorder is not None:
            self._recorder.event(fields, time.monotonic_ns(), self._plant.time_ns)

    def _open_recording(self) -> TruthRecorder | None:
        directory = self._options.record_dir
        if directory is None:
            return None
        run = {
            "plant": self._config.plant.model_dump(mode="json"),
            "scene": self._config.scene.model_dump(mode="json"),
            "plant_service": self._config.service.model_dump(mode="json"),
        }
        try:
            directory.mkdir(parents=True, exist_ok=True)
            return TruthRecorder(directory / "truth.mcap", run)
        except OSError as error:
            raise ConfigurationError(
                "configuration.recording", f"--record-dir {directory}: truth.mcap: {error.strerror}"
            ) from error

    def _say_ready(self, addresses: dict[str, tuple[str, int]], obtained: str) -> None:
        ready = {
            "event": "ready",
            "service": "plant_emulator",
            "pid": os.getpid(),
            **{name: {"host": host, "port": port} for name, (host, port) in addresses.items()},
            "faults_allowed": self._config.service.fault_face.allowed,
            "period_ms": self._config.service.period_ms,
            "scheduling": obtained,
            "renderer_scheduling": self._config.service.renderer_scheduling,
            "recording": None if self._recorder is None else str(self._recorder.path),
        }
        print(json.dumps(ready), flush=True)

    def _memory(self) -> dict[str, float]:
        assert self._camera is not None
        return {"plant_rss_mb": resident_mb(os.getpid()), "renderer_rss_mb": resident_mb(self._camera.pid)}

    def _write_statistics(self, figures: dict[str, Any]) -> None:
        if self._options.statistics is None:
            return
        assert self._camera is not None
        camera = {"captures_missed": self._captures.dropped, "poses_dropped": self._camera.poses_dropped}
        camera["frames_lost_on_purpose"] = self._camera.frames_lost
        figures = {
            "service": "plant_emulator",
            "period_ms": self._config.service.period_ms,
            "integrator": self._integrator.lateness.as_dict(),
            "simulated_s": self._plant.time_ns / 1e9,
            "coupler": self._coupler.statistics.as_dict(),
            "camera": self._camera.statistics | camera,
            "truth_records": 0 if self._recorder is None else self._recorder.written,
        } | figures
        self._options.statistics.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")

    async def _shut_down(self) -> None:
        self._integrator.stop()
        await self._face.stop()
        await self._coupler.stop()
        if self._camera is not None:
            await self._camera.stop()
        self._tell_faults(time.monotonic_ns())
        if self._recorder is not None:
            self._recorder.close()


async def _first(wanted: Any, other: Any) -> bool:
    """Whether ``wanted`` ends before ``other`` does; the loser is cancelled, an exception passed on."""
    first, second = asyncio.ensure_future(wanted), asyncio.ensure_future(other)
    try:
        await asyncio.wait((first, second), return_when=asyncio.FIRST_COMPLETED)
        if first.done():
            first.result()
        return first.done() and not second.done()
    finally:
        for task in (first, second):
            task.cancel()
        await asyncio.gather(first, second, return_exceptions=True)
