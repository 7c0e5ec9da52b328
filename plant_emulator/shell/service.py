"""The emulator's process: physics in real time, its fieldbus face, its camera, its recording."""

import asyncio
import functools
import socket
import time
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from pathlib import Path
from typing import Any

from foundation import clock
from foundation.event_log import EventLog
from foundation.live.feed import LiveFeed, open_show
from foundation.live.wire import Spread, exposition
from foundation.periods import take_fifo
from foundation.recording.beginning import recording_directory, session_entries
from foundation.recording.messages import RecordingThread
from foundation.recording.recorder import OpenSink
from foundation.secret_source import bound_tcp
from foundation.self_watch import DiskWatch, resident_mb
from foundation.service_main import ServiceOptions, on_termination, say_ready
from plant_emulator.config.service import Endpoint, PlantSideConfig
from plant_emulator.core.camera.exposures import STILL, CameraView
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.faults.kinds import CouplerSilent
from plant_emulator.core.plant import Plant
from plant_emulator.core.truth import PlantTruth
from plant_emulator.shell.camera_sender import CameraSender
from plant_emulator.shell.coupler import Coupler
from plant_emulator.shell.fault_desk import FaultDesk
from plant_emulator.shell.plant_metrics import METRICS
from plant_emulator.shell.scene_messages import drawing
from plant_emulator.shell.ticker import Integrator, SlowCycle, Ticker, TickerBody, greatest_pace
from plant_emulator.shell.truth_recorder import TruthRecorder
from protocol.process_image import ValveImage, acknowledge, encode_sensors

_NAME = "plant_emulator"
_ANSWERED_S = 0.2  # [D]


class PlantService:
    """One running emulator."""

    def __init__(self, config: PlantSideConfig, options: ServiceOptions, log: EventLog) -> None:
        self._config = config
        self._record_dir = options.record_dir
        self._log = log
        service = config.service
        scene = Scene(config.scene)
        self._plant = Plant(config.plant, config.scene.seed, scene.mounts)
        self._termination = asyncio.Event()
        self._faults = FaultDesk(self._plant, scene, service.fault_face, log, self._end_soon)
        self._period_ns = round(service.period_ms * 1e6)
        self._integrator = Integrator(self._period_ns, lambda at_ns: self._step(self._period_ns, at_ns))
        self._clock = clock.GivenClock() if clock.clock_address() else None
        self._ticker: Ticker | None = None
        if self._clock is not None:
            clock.use(self._clock)
        release_ns = round(service.writer_release_ms * 1e6)
        self._coupler = Coupler(
            self._sensor_words,
            self._write,
            release_ns,
            clock.now_ns,
            self._is_silent,
            log.write_repeated,
            time.monotonic_ns,
        )
        self._captures = SlowCycle(round(1e9 / config.scene.camera.rate_hz))
        self._truths = SlowCycle(round(1e9 / service.truth_hz))
        self._changes_logged = 0
        self._words: list[int] | None = None
        self._truth: PlantTruth | None = None
        self._status = -1
        self._recorder: TruthRecorder | None = None
        self._show: LiveFeed | None = None
        self._camera: CameraSender | None = None
        self._scheduling = "normal"
        self._memory_at_end: dict[str, float] = {}

    async def run(self) -> int:
        """Exit status, after serving until SIGTERM, SIGINT or a restart is asked for, or the renderer fails.

        Raises ConfigurationError when a port is busy or the recording cannot be written.
        """
        stop = self._termination
        on_termination(stop.set)
        service = self._config.service
        with (
            closing(self._faults),
            _bound(service.modbus, "modbus") as modbus,
            _bound(service.camera_stream, "camera_stream") as stream,
            _bound(service.fault_face, "fault_face") as face,
            _bound_clock() as ticks,
            ExitStack() as shown,
        ):
            self._show = open_show(_NAME, self._log, self._metrics_text, service.fifo_priority)
            if self._show is not None:
                shown.callback(self._show.close)
            addresses = {"camera_stream": stream.getsockname(), "fault_face": face.getsockname()}
            self._recorder = self._open_recording()
            self._camera = CameraSender(self._config.scene, stream, ticks is not None)
            self._faults.start(face)
            failed = False
            try:
                self._warm_up()
                children_ready = asyncio.gather(self._camera.wait_ready(), self._faults.wait_ready())
                if await _first(children_ready, stop.wait()):
                    addresses["modbus"] = await self._coupler.start(modbus)
                    await self._let_time_pass(ticks, addresses)
                    failed = await self._serve(self._camera, addresses, stop)
            finally:
                await self._shut_down()
        if failed:
            why = {"cause": "link.renderer_ended", "detail": "the renderer ended by itself"}
            self._log.write("stopped", "error", statistics=self._gathered(), **why)
        else:
            self._log.write("stopped", simulated_ns=self._plant.time_ns, statistics=self._gathered())
        return 1 if failed else 0

    def _end_soon(self) -> None:
        """End in good order, once the API has told who asked for it."""
        asyncio.get_running_loop().call_later(_ANSWERED_S, self._termination.set)

    async def _serve(
        self, camera: CameraSender, addresses: dict[str, tuple[str, int]], stop: asyncio.Event
    ) -> bool:
        """Serve; return whether the renderer ended by itself before ``stop``."""
        self._scheduling = take_fifo(self._config.service.fifo_priority)
        self._say_ready(addresses)
        watch = DiskWatch(self._log, self._record_dir)
        beside = asyncio.create_task(watch.keep_looking())
        try:
            return await _first(camera.ended.wait(), stop.wait())
        finally:
            beside.cancel()
            self._memory_at_end = self._memory()

    def _warm_up(self) -> None:
        """Let everything compile before time begins to count."""
        self._plant.advance(round(self._config.service.period_ms * 1e6))
        self._plant.truth()
        self._sensor_words()

    async def _let_time_pass(
        self, bound: socket.socket | None, addresses: dict[str, tuple[str, int]]
    ) -> None:
        """By the wall, or as all parts answer that follow the plant's clock at ``bound``."""
        if bound is None or self._clock is None or self._camera is None:
            self._integrator.start()
            return
        addresses["clock"] = bound.getsockname()
        camera = self._camera
        body = TickerBody(camera.watched, self._tick, camera.published, self._termination.set)
        self._ticker = Ticker(self._clock, self._period_ns, greatest_pace(), body, self._log)
        await self._ticker.start(bound)

    def _tick(self, passed_ns: int) -> None:
        self._coupler.look_at_watchdog(clock.now_ns())
        self._step(passed_ns, clock.now_ns())

    def _is_silent(self) -> bool:
        """Whether the coupler leaves a request unanswered; who follows the plant's clock is told so."""
        silent = self._plant.faults.of_kind(CouplerSilent) is not None
        if silent and self._ticker is not None:
            self._ticker.leave_unanswered()
        return silent

    def _step(self, passed_ns: int, deadline_ns: int) -> None:
        self._plant.advance(passed_ns)
        self._words = None
        self._tell_status()
        self._tell_faults(deadline_ns)
        capture = self._captures.due(deadline_ns)
        record = self._recorder is not None and (capture or self._truths.due(deadline_ns))
        if not (capture or record):
            return
        self._truth = truth = self._plant.truth()
        if capture and self._camera is not None:
            motion = self._plant.motion() if self._config.scene.camera.shows_motion else None
            view = CameraView(truth.X_WC, truth.X_WM, truth.X_WO)
            faults = self._plant.faults.in_force()
            frame_id = self._camera.capture(view, STILL if motion is None else motion, deadline_ns, faults)
            if self._recorder is not None:
                self._recorder.capture(truth, deadline_ns, frame_id, self._plant.links(), motion)
        elif record and self._recorder is not None:
            self._recorder.truth(truth, deadline_ns, self._plant.links())

    def _write(self, image: ValveImage) -> None:
        self._plant.write(image)
        self._tell_status()
        if self._words is not None:  # what is read in the same exchange already echoes this image's cycle
            acknowledge(self._words, self._plant.echo_cycle, self._status)

    def _sensor_words(self) -> list[int]:
        """The newest input image; encoded once a step, so that reading it in pieces is consistent."""
        if self._words is None:
            self._words = encode_sensors(self._plant.read())
        return self._words

    def _tell_status(self) -> None:
        status = self._plant.status
        if status == self._status:
            return
        self._status = status
        self._log.write("status", status=status)
        if self._recorder is not None:
            fields = {"event": "status", "status": status}
            self._recorder.event(fields, clock.now_ns(), self._plant.time_ns)

    def _tell_faults(self, log_ns: int) -> None:
        changes = self._plant.faults.changes
        for change in changes[self._changes_logged :]:
            fields = change.as_dict()
            self._log.write("fault", simulated_ns=fields.pop("time_ns"), **fields)
            if self._recorder is not None:
                self._recorder.fault(change, log_ns)
        self._changes_logged = len(changes)

    def _open_recording(self) -> TruthRecorder | None:
        directory, show = recording_directory(self._record_dir), self._show
        if directory is None and show is None:
            return None
        run = {
            "plant": self._config.plant.model_dump(mode="json"),
            "scene": self._config.scene.model_dump(mode="json"),
            "plant_service": self._config.service.model_dump(mode="json"),
        }
        drawn = drawing(self._config.scene, self._plant.chain, clock.now_ns())
        fifo = self._config.service.fifo_priority
        made: OpenSink = functools.partial(RecordingThread, fifo_priority=fifo)
        if show is not None:
            made = show.opened(directory is not None, fifo)
        path = (directory or Path()) / "truth.mcap"
        recorder = TruthRecorder(path, run, drawn, session_entries(_NAME), made)
        recorder.tell_failure(self._log.write)
        return recorder

    def _say_ready(self, addresses: dict[str, tuple[str, int]]) -> None:
        say_ready(
            _NAME,
            **{name: {"host": host, "port": port} for name, (host, port) in addresses.items()},
            faults_allowed=self._config.service.fault_face.allowed,
            period_ms=self._config.service.period_ms,
            scheduling=self._scheduling,
            recording=None if self._record_dir is None else str(self._record_dir / "truth.mcap"),
        )

    def _memory(self) -> dict[str, float]:
        assert self._camera is not None
        return {
            "plant_rss_mb": resident_mb(),
            "renderer_rss_mb": resident_mb(self._camera.pid),
            "fault_api_rss_mb": resident_mb(self._faults.pid),
        }

    def _metrics_text(self) -> str:
        """Its text for Prometheus; asked for by the thread that feeds the live face."""
        spreads = (Spread("step_lateness_seconds", "How late steps began.", self._integrator.lateness),)
        values = self._gathered() | {"log_lines_dropped": self._log.dropped}
        if (truth := self._truth) is not None:
            values |= {"oil_temperature_degc": truth.oil_temperature_degc, "supply_pa": truth.supply}
        return exposition(_NAME, METRICS, values, spreads)

    def _gathered(self) -> dict[str, Any]:
        assert self._camera is not None
        camera = {"captures_missed": self._captures.dropped, "poses_dropped": self._camera.poses_dropped}
        camera["frames_lost_on_purpose"] = self._camera.frames_lost
        return {
            "period_ms": self._config.service.period_ms,
            "integrator": self._integrator.as_dict(),
            "simulated_s": self._plant.time_ns / 1e9,
            "coupler": dict(vars(self._coupler.statistics)),
            "camera": self._camera.statistics | camera,
            "truth_records": 0 if self._recorder is None else self._recorder.sink.written,
            "truths_dropped": 0 if self._recorder is None else self._recorder.sink.dropped,
            "live_dropped": 0 if self._show is None else self._show.dropped,
            "scheduling": self._scheduling,
            "memory": self._memory_at_end or self._memory(),
        }

    async def _shut_down(self) -> None:
        self._integrator.stop()
        if self._ticker is not None:
            await self._ticker.stop()
        await self._coupler.stop()
        ending = [self._faults.stop()] + ([] if self._camera is None else [self._camera.stop()])
        await asyncio.gather(*ending)
        self._tell_faults(clock.now_ns())
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


def _bound_clock() -> AbstractContextManager[socket.socket | None]:
    """The socket that the parts follow at, None where every part runs by the wall."""
    where = clock.clock_address()
    return nullcontext() if where is None else bound_tcp(*where, clock.CLOCK)


def _bound(endpoint: Endpoint, name: str) -> socket.socket:
    return bound_tcp(endpoint.host, endpoint.port, f"plant_service.{name}")
